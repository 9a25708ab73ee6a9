"""joblib's Dask backend, with failures of the cluster handed on: without that a run would wait for ever."""

from __future__ import annotations

import asyncio
from typing import Any

from joblib._dask import DaskDistributedBackend


class _Lost:
    """Stands for the result of a task that the cluster gave up."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


class ClusterBackend(DaskDistributedBackend):  # type: ignore[misc]
    """Spreads calls over the workers of a Dask client."""

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
                    result = _Lost(result[1])
                waiting.set_result(result)
                callback(result)
            await asyncio.sleep(0.01)

    def retrieve_result_callback(self, out: Any) -> Any:
        """Return a result, or raise what became of it."""
        if isinstance(out, _Lost):
            raise out.error
        return super().retrieve_result_callback(out)
