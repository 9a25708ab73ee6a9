"""Compilation of numerical kernels by Numba, with the machine code cached on disk.

Arithmetic is strict: no fused or reordered operations, one thread. A kernel gives the same bits on every processor of
an architecture.
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
    """Return a decorator for kernels; ``folders`` hold their sources and those of the functions that they call.

    A function is compiled at its first call. The machine code is cached in $NUMBA_CACHE_DIR or in boresight's cache; if
    that cannot be written, in a folder that Numba chooses.
    """
    place = _folder(folders)

    def kernel(function: _Kernel) -> _Kernel:
        # Numba reads the folder when a function is decorated; other users of Numba keep theirs.
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(place)
        try:
            # error_model: division by zero gives inf or NaN as in NumPy. Without fastmath nothing is reordered or
            # fused.
            return cast("_Kernel", numba.njit(cache=True, error_model="numpy")(function))
        except RuntimeError:  # no folder can be written
            return cast("_Kernel", numba.njit(error_model="numpy")(function))
        finally:
            numba.config.CACHE_DIR = before

    return kernel


def _folder(folders: tuple[Path, ...]) -> Path:
    """Return a folder keyed by all sources: Numba detects changes of a file, but not of functions that it calls."""
    sources = sorted(source for folder in folders for source in folder.glob("*.py"))
    content = hashlib.sha256(b"\0".join(source.read_bytes() for source in sources)).hexdigest()
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    root = Path(chosen) if chosen else default_cache().root / "kernels"
    return root / content[:16]
