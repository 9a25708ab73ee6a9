"""Files that blocks of a campaign need, by content hash: collected here, held by the scheduler, fetched by workers."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from distributed import Scheduler, get_worker
from distributed.diagnostics.plugin import SchedulerPlugin
from distributed.protocol.serialize import to_serialize
from distributed.utils import sync

from boresight.campaign.imaging.real_images import image_files
from boresight.campaign.resolved import ResolvedCampaign
from boresight.scenarios.bodies import EMBEDDED
from boresight.scenarios.cache import default_cache
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_spec

CAMPAIGN, DATA, RUN = "campaign.pickle", "data", "run"

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


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Files by SHA-256, and an index that names them.

    Parameters
    ----------
    digest
        SHA-256 of the index.
    assets
        SHA-256 to content: every file, and the index, which maps relative paths to SHA-256.
    """

    digest: str
    assets: Mapping[str, bytes]


def bundle_of(campaign: ResolvedCampaign, run: Path) -> Bundle:
    """Gather the campaign, the data that its scenarios read, and the products of its run folder.

    Raises
    ------
    BoresightError
        If a file is named by an absolute path, which means nothing on another machine.
    """
    _ = campaign.digest  # worked out here once: where the bundle is opened it holds for both
    contents = {CAMPAIGN: pickle.dumps(campaign, protocol=5)}
    for scenario in campaign.scenarios:
        contents |= {f"{DATA}/{name}": path.read_bytes() for name, path in _data(scenario)}
    for path in sorted((run / "products").rglob("*")):
        if path.is_file():
            contents[f"{RUN}/products/{path.relative_to(run / 'products').as_posix()}"] = path.read_bytes()
    index = {name: hashlib.sha256(content).hexdigest() for name, content in sorted(contents.items())}
    written = json.dumps(index, sort_keys=True).encode()
    digest = hashlib.sha256(written).hexdigest()
    return Bundle(digest, {**{index[name]: content for name, content in contents.items()}, digest: written})


def _data(scenario: LoadedScenario) -> Iterator[tuple[str, Path]]:
    """Yield the files of a scenario as it names them, and where they are here."""
    spec, dirs = scenario.spec, scenario.search_dirs
    for shape in dict.fromkeys((spec.body.shape, onboard_spec(spec).body.shape)):
        if shape not in EMBEDDED:
            yield _portable(shape, scenario), find_data_file(shape, dirs, "shapes", "body.shape")
    for name, path in image_files(scenario):
        yield _portable(name, scenario), path


def _portable(name: str, scenario: LoadedScenario) -> str:
    """Return a name that means the same in another folder."""
    parts = PurePath(name).parts
    if PurePath(name).is_absolute() or ".." in parts:
        raise BoresightError(
            f"{scenario.path}: {name}: means nothing on another machine: name it relative to the scenario's file or to"
            " BORESIGHT_DATA to run on a cluster"
        )
    return PurePath(name).as_posix()
