"""Number of worker processes, and the threads of each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import cv2
from threadpoolctl import threadpool_limits

from boresight.campaign.machine import cores
from boresight.renderers.mitsuba3 import limit_threads
from boresight.renderers.mitsuba3.variant import CUDA, gpu_names


def workers(asked: int | None, variant: str) -> int:
    """Return the number of worker processes: as requested, or by default one for each GPU or each core."""
    if asked is not None:
        return asked
    return max(1, len(gpu_names())) if variant == CUDA else cores()


def use_threads(jobs: int) -> None:
    """Limit the threads of this worker to cores / jobs, as more threads than cores are much slower.

    BLAS gets one thread: matrices are small here, and OpenBLAS's threads spin while they wait, which made landmark
    recognition ten times slower on a busy machine.
    """
    _share_cores(max(1, cores() // max(1, jobs)))
    # Not kept in a cache: `one_blas_thread` may have ended since, or another library with a BLAS been loaded.
    threadpool_limits(limits=1, user_api="blas")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Give matrices one thread, and afterwards as many as before.

    BLAS adds up the parts of long vectors and large matrices that its threads worked out, so that the last bits of a
    product depend on how many there are.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _share_cores(threads: int) -> None:
    limit_threads(threads)
    cv2.setNumThreads(threads)
