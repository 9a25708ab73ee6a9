"""Blocks of a campaign on a Dask cluster, with results in order, through joblib's Dask backend."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from boresight.campaign.imaging.image_store import store_is_on
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.request import Cluster
from boresight.campaign.store.folder import Block
from boresight.campaign.trial.kind import Records
from boresight.scenarios.errors import BoresightError

try:
    from distributed import Client, LocalCluster
    from distributed.scheduler import KilledWorker
    from joblib import Parallel, delayed
    from joblib._dask import DaskDistributedBackend

    from boresight.campaign.runs.dask.bundle import AssetServer, bundle_of
    from boresight.campaign.runs.dask.work import run_block_there
except ImportError as error:
    raise BoresightError(
        f'--backend dask: {error.name} is not installed: pip install -e ".[dask]", here and where the workers are'
    ) from error

_PATIENCE_S = 30.0
# In flight for each worker that there is when the run begins: some that come later find work too.
_AHEAD = 4


class _FailedTask:
    """Result of a task that the cluster gave up, with its error."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


class ClusterBackend(DaskDistributedBackend):  # type: ignore[misc]
    """joblib's Dask backend, which also returns failures of the cluster; without them a run would wait for ever."""

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Count the cores of the workers, and two where they have one: joblib would then work here, and not there."""
        return max(2, int(super().effective_n_jobs(n_jobs)))

    async def _collect(self) -> None:
        """Hand every result on as it comes, and every failure: joblib 1.6 drops the latter."""
        while self._continue:
            async for future, result in self.waiting_futures:
                waiting = self._results.pop(future)
                callback = self._callbacks.pop(future)
                if future.status == "error":
                    result = _FailedTask(result[1])
                waiting.set_result(result)
                callback(result)
            await asyncio.sleep(0.01)

    def retrieve_result_callback(self, out: Any) -> Any:
        """Return a result, or raise what became of it."""
        if isinstance(out, _FailedTask):
            raise out.error
        return super().retrieve_result_callback(out)


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
        backend = ClusterBackend(client=client, pure=False)
        parallel = Parallel(
            backend=backend, return_as="generator", pre_dispatch=f"{_AHEAD}*n_jobs", batch_size=1, n_jobs=-1
        )
        results = parallel(delayed(run_block_there)(bundle.digest, block, store_is_on(), limit_s) for block in blocks)
        try:
            yield from results
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
