"""Blocks of a campaign on a Dask cluster, with results in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from boresight.campaign.imaging.image_store import store_is_on
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.request import Cluster
from boresight.campaign.store.folder import Block
from boresight.campaign.trial.kind import Records
from boresight.scenarios.errors import BoresightError

try:
    from distributed import Client, Future, LocalCluster
    from distributed.scheduler import KilledWorker

    from boresight.campaign.runs.dask.bundle import AssetServer, bundle_of
    from boresight.campaign.runs.dask.work import run_block_there
except ImportError as error:
    raise BoresightError(
        f'--backend dask: {error.name} is not installed: pip install -e ".[dask]", here and where the workers are'
    ) from error

_PATIENCE_S = 30.0
# In flight for each thread of the workers that there are when the run begins: workers that come later find work too.
_AHEAD = 4


def blocks_in_order(
    cluster: Cluster, campaign: ResolvedCampaign, run: Path, blocks: Iterable[Block], limit_s: float | None
) -> Iterator[Records]:
    """Yield the records of each block, in order, holding only what is in flight.

    Raises
    ------
    BoresightError
        If there is no such scheduler, no worker comes, or the cluster gives a block up.
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
