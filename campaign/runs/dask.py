"""Runs on a Dask cluster whose workers share no file system with the machine that started the run.

Files that blocks of trials need are collected here, held by the scheduler by their content hash, and fetched by
workers, which compute blocks as a local worker does. Nothing here may change a row.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import shutil
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path, PurePath
from typing import cast

from boresight.campaign.imaging.image_store import store_is_on, store_switched
from boresight.campaign.imaging.real_images import image_files
from boresight.campaign.machine import cores
from boresight.campaign.pool.workers import in_order
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import Losses, run_block
from boresight.campaign.runs.manifest import Cluster
from boresight.campaign.store import Block
from boresight.campaign.trial.kind import Records, WorkerContext, kind_named
from boresight.scenarios.cache import default_cache
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_spec

try:
    from distributed import Client, Future, LocalCluster, Scheduler, get_worker
    from distributed.diagnostics.plugin import SchedulerPlugin
    from distributed.protocol.serialize import to_serialize
    from distributed.scheduler import KilledWorker
    from distributed.utils import sync
except ImportError as error:
    raise BoresightError(
        f'--backend dask: {error.name} is not installed: pip install -e ".[dask]", here and where the workers are'
    ) from error

CAMPAIGN, DATA, RUN = "campaign.pickle", "data", "run"

Fetch = Callable[[str], bytes]
_KIND, _FILE, _HANDLER = "assets", "content", "boresight_asset"

_PATIENCE_S = 30.0
# In flight for each thread of the workers that there are when the run begins: workers that come later find work too.
_AHEAD = 4
# Scenes, meshes and estimators belong to a process and are used by one block at a time, however many threads there are.
_ALONE = threading.Lock()


def blocks_in_order(
    cluster: Cluster, campaign: ResolvedCampaign, run: Path, blocks: Iterable[Block], limit_s: float | None
) -> Iterator[Records]:
    """Yield the records of each block, in order, holding only what is in flight.

    Raise BoresightError if there is no such scheduler, no worker comes, or the cluster gives a block up.
    """
    bundle = bundle_of(campaign, run)
    with _opened(cluster) as client:
        client.register_plugin(AssetServer(bundle))
        most, in_flight = _AHEAD * max(2, sum(client.nthreads().values())), deque[Future]()
        try:
            for block in blocks:
                if len(in_flight) == most:
                    yield in_flight.popleft().result()
                call = (bundle.digest, block, store_is_on(), limit_s)
                in_flight.append(client.submit(run_block_there, *call, pure=False))
            while in_flight:
                yield in_flight.popleft().result()
        except KilledWorker as error:
            raise BoresightError(
                f"the cluster gave a block up: {error.task} was under way on {error.allowed_failures + 1} workers that"
                " died, most likely because memory ran out; the same command continues the run"
            ) from error


@contextmanager
def _opened(cluster: Cluster) -> Iterator[Client]:
    """Connect, and wait for a first worker."""
    own = None
    if cluster.local:
        own = LocalCluster(n_workers=cluster.local, threads_per_worker=1, dashboard_address=None, processes=True)
    try:
        try:
            client = Client(own or cluster.scheduler, timeout=_PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise BoresightError(
                f"--scheduler {cluster.scheduler}: no scheduler answers there ({type(error).__name__}): give the"
                " address that dask scheduler prints, such as tcp://10.0.0.1:8786"
            ) from error
        with client:
            try:
                client.wait_for_workers(1, timeout=_PATIENCE_S)
            except TimeoutError as error:
                raise BoresightError(
                    f"--scheduler {cluster.scheduler}: no worker came within {_PATIENCE_S:.0f} s: start some with"
                    f" dask worker {cluster.scheduler}"
                ) from error
            yield client
    finally:
        if own is not None:
            own.close()


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

    Raise BoresightError if what was fetched is not what its hash says.
    """

    def build(folder: Path) -> None:
        content = fetch(sha256)
        if hashlib.sha256(content).hexdigest() != sha256:
            raise BoresightError(f"asset {sha256[:12]} came damaged: start the run again")
        (folder / _FILE).write_bytes(content)

    return default_cache().folder(_KIND, sha256, build) / _FILE


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Files by SHA-256, and an index that maps relative paths to SHA-256 and is one of them.

    ``digest`` is the SHA-256 of the index; ``assets`` maps SHA-256 to content.
    """

    digest: str
    assets: Mapping[str, bytes]


def bundle_of(campaign: ResolvedCampaign, run: Path) -> Bundle:
    """Gather the campaign, the data that its scenarios read, and the products of its run folder.

    Raise BoresightError if a file is named by an absolute path, which means nothing on another machine.
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
    bodies = (*spec.bodies, onboard_spec(spec).body)
    for name in dict.fromkeys(name for body in bodies for name in body.files):
        yield _portable(name, scenario), find_data_file(name, dirs, "shapes", "body")
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


def run_block_there(bundle: str, block: Block, images_kept: bool, limit_s: float | None) -> Records:
    """Run every trial of a block with the bundle of that digest, which the scheduler holds.

    ``images_kept`` says whether rendered images go to the store of this worker's machine. With a limit of a method's
    time the block runs in a process of its own, which can be ended where the method does not stop, while the worker
    stays.
    """
    with _ALONE, store_switched(images_kept):
        this = get_worker()
        campaign, folder = opened(bundle, from_scheduler, Path(this.local_directory))
        workers = max(1, cores() // max(1, this.state.nthreads))
        context = WorkerContext(folder / RUN, workers, keep_images=False, limit_s=limit_s)
        if limit_s is None:
            return run_block(campaign, block, context)
        again = kind_named(campaign.spec.experiment).process_blocks()
        calls: list[tuple[object, ...]] = [(campaign, block, context, {})]
        # All of it is taken, as what is broken off costs the process.
        (found,) = in_order(1, run_block, calls, apart=True, renew_after=again, after_death=Losses().after)
        return found


@lru_cache(maxsize=1)
def opened(bundle: str, fetch: Fetch, below: Path) -> tuple[ResolvedCampaign, Path]:
    """Lay out a bundle in a folder of this process, and read the campaign so that it finds its data there.

    The folder lies below that of the worker, which Dask removes with it, or later where the worker was killed.
    """
    folder = Path(tempfile.mkdtemp(prefix="boresight-", dir=below))
    index = json.loads(asset_file(bundle, fetch).read_bytes())
    for name, sha256 in index.items():
        target = folder / name
        if not target.resolve().is_relative_to(folder.resolve()):
            raise ValueError(f"{name} leads out of the bundle")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(asset_file(sha256, fetch), target)
    campaign = cast("ResolvedCampaign", pickle.loads((folder / CAMPAIGN).read_bytes()))  # noqa: S301  who sends it may run code here anyway
    scenarios = tuple(replace(scenario, search_dirs=(folder / DATA,)) for scenario in campaign.scenarios)
    # The digest was worked out where the data are; it comes along and stays what it is.
    there = replace(campaign, scenarios=scenarios)
    there.__dict__["digest"] = campaign.digest
    return there, folder
