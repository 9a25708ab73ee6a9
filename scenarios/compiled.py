"""How kernels are compiled, and where their machine code is kept.

Strict arithmetic in the order in which it is written, without fused or reordered operations and on one thread: a kernel
gives the same bits on every processor of an architecture.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

from scenarios.cache import default_cache

_Kernel = TypeVar("_Kernel", bound=Callable[..., object])


def compiler(*folders: Path) -> Callable[[_Kernel], _Kernel]:
    """Return the decorator of kernels whose sources, and those of what they call, lie in ``folders``.

    It compiles a function when it is first called; the machine code is kept between processes if it can be. It lies in
    $NUMBA_CACHE_DIR, else in boresight's cache; where that cannot be written, where numba finds a place.
    """
    place = _folder(folders)

    def kernel(function: _Kernel) -> _Kernel:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(place)
        try:
            return cast("_Kernel", numba.njit(cache=True, error_model="numpy")(function))
        except RuntimeError:  # no folder can be written
            return cast("_Kernel", numba.njit(error_model="numpy")(function))
        finally:
            numba.config.CACHE_DIR = before

    return kernel


def _folder(folders: tuple[Path, ...]) -> Path:
    """Name a folder for this state of all kernels: numba notices a change of a file, not of what it calls in others."""
    sources = sorted(source for folder in folders for source in folder.glob("*.py"))
    content = hashlib.sha256(b"\0".join(source.read_bytes() for source in sources)).hexdigest()
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    root = Path(chosen) if chosen else default_cache().root / "kernels"
    return root / content[:16]
