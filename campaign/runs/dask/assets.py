"""Assets by content hash: the scheduler holds them, workers ask for those that their cache has not."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

from distributed import Scheduler, get_worker
from distributed.diagnostics.plugin import SchedulerPlugin
from distributed.protocol.serialize import to_serialize
from distributed.utils import sync

from campaign.runs.dask.bundle import Bundle
from scenarios.cache import default_cache
from scenarios.errors import BoresightError

Fetch = Callable[[str], bytes]
_KIND, _FILE, _HANDLER = "assets", "content", "boresight_asset"


class AssetServer(SchedulerPlugin):  # type: ignore[misc]  # Dask has no types
    """Answers a worker's request for an asset; a worker may come late, or come back after it was killed."""

    name = "boresight-assets"
    idempotent = False

    def __init__(self, bundle: Bundle) -> None:
        self._assets: Mapping[str, bytes] = dict(bundle.assets)

    async def start(self, scheduler: Scheduler) -> None:
        """Add the assets to those that the scheduler holds for other runs, and open the way to them."""
        held = scheduler.extensions.setdefault(_HANDLER, {})
        held.update(self._assets)

        async def give(sha256: str) -> object:
            return to_serialize(held[sha256]) if sha256 in held else None

        scheduler.handlers[_HANDLER] = give


def from_scheduler(sha256: str) -> bytes:
    """Fetch an asset from the scheduler of the worker that this is."""
    worker = get_worker()
    found = sync(worker.loop, getattr(worker.scheduler, _HANDLER), sha256=sha256)
    if found is None:
        raise BoresightError(f"the scheduler has no asset {sha256[:12]}: start the run again")
    return bytes(found)


def asset_file(sha256: str, fetch: Fetch) -> Path:
    """Return the file of an asset in this machine's cache, fetched first where it is not there.

    Raises
    ------
    BoresightError
        If what was fetched is not what its hash says.
    """

    def build(folder: Path) -> None:
        content = fetch(sha256)
        if hashlib.sha256(content).hexdigest() != sha256:
            raise BoresightError(f"asset {sha256[:12]} came damaged: start the run again")
        (folder / _FILE).write_bytes(content)

    return default_cache().folder(_KIND, sha256, build) / _FILE
