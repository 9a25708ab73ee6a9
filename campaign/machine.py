"""What this machine offers, and how a worker takes its share of it."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import cv2
from threadpoolctl import threadpool_limits

from renderers.mitsuba3 import limit_threads
from renderers.mitsuba3.variant import CUDA, gpu_names
from scenarios.limits import installed_memory_bytes

PACKAGES = (
    "boresight", "numpy", "scipy", "opencv-python-headless", "mitsuba", "drjit", "trimesh", "pandas", "pyarrow",
    "matplotlib", "joblib", "pydantic", "astropy", "numba",
)  # fmt: skip


_sharing: ContextVar[int] = ContextVar("_sharing", default=1)


def cores() -> int:
    """Return how many cores this process may use: its part, where it shares them."""
    every = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, every // _sharing.get())


@contextmanager
def sharing_cores(among: int) -> Iterator[None]:
    """Leave this process its part of the cores, for so many that work side by side."""
    token = _sharing.set(among)
    try:
        yield
    finally:
        _sharing.reset(token)


def workers(asked: int | None, variant: str) -> int:
    """Return how many worker processes there are to be: as many as asked for, or one for each GPU or else each core."""
    if asked is not None:
        return asked
    return max(1, len(gpu_names())) if variant == CUDA else cores()


def memory_gib() -> float:
    """Return the installed memory."""
    return installed_memory_bytes() / 2**30


def use_threads(jobs: int) -> None:
    """Give this worker cores / jobs threads: two workers with two threads each on two cores are far slower.

    Matrices get one thread. They are small here, and the threads of OpenBLAS wait for each other at full load: on a
    busy machine that made recognition ten times slower.
    """
    _limit_to(max(1, cores() // max(1, jobs)))


@lru_cache(maxsize=1)
def _limit_to(threads: int) -> None:
    limit_threads(threads)
    cv2.setNumThreads(threads)
    threadpool_limits(limits=1, user_api="blas")


def load() -> float:
    """Return how many processes wanted a core in the last minute, on average; 0 where the system does not tell."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else 0.0


@lru_cache(maxsize=1)
def processor() -> str:
    """Return the processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def package_versions() -> dict[str, str]:
    """Return the version of each package that a result rests on; 'missing' where it is not installed."""
    return {name: _version(name) for name in PACKAGES}


@lru_cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def describe() -> dict[str, object]:
    """Describe the machine for a manifest."""
    return {
        "system": platform.platform(),
        "python": sys.version.split()[0],
        "processor": processor(),
        "cores": cores(),
        "memory_gib": round(memory_gib(), 1),
    }
