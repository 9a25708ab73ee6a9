"""Cores, memory, processor and package versions of this machine."""

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

from boresight.scenarios.reading import installed_memory_bytes

PACKAGES = (
    "boresight", "numpy", "scipy", "opencv-python-headless", "mitsuba", "drjit", "trimesh", "pandas", "pyarrow",
    "matplotlib", "joblib", "pydantic", "astropy", "numba",
)  # fmt: skip


_sharing: ContextVar[int] = ContextVar("_sharing", default=1)


def cores() -> int:
    """Return the number of cores that this process may use: its share, if it shares them."""
    every = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, every // _sharing.get())


@contextmanager
def sharing_cores(among: int) -> Iterator[None]:
    """Limit this process to its share of the cores inside the context, for ``among`` concurrent processes."""
    token = _sharing.set(among)
    try:
        yield
    finally:
        _sharing.reset(token)


def memory_gib() -> float:
    """Installed memory, GiB."""
    return installed_memory_bytes() / 2**30


@lru_cache(maxsize=1)
def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def package_versions() -> dict[str, str]:
    """Version of each package that results depend on; 'missing' if it is not installed."""
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
