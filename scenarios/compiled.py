"""Compilation of numerical kernels by Numba, with the machine code cached on disk.

Arithmetic is strict: no fused or reordered operations, one thread. A kernel gives the same bits on every processor of
an architecture.
"""

from __future__ import annotations

import ast
import contextlib
import fcntl
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Self, TypeVar, cast

import numba
from numba.core.compiler_lock import global_compiler_lock

from boresight.scenarios.cache import default_cache

_Kernel = TypeVar("_Kernel", bound=Callable[..., object])


def compiler(folder: Path) -> tuple[Callable[[_Kernel], _Kernel], Callable[[_Kernel], _Kernel]]:
    """Return two decorators for kernels whose sources, with those of all functions that they call, are in ``folder``.

    The first is for kernels that Python calls. The second is for those that only kernels call: they have no code that
    takes arguments from Python, which takes 0.1 s to compile for a named tuple of 24 arrays.

    A function is compiled at its first call. The machine code is cached in $NUMBA_CACHE_DIR or in boresight's cache: of
    several processes one compiles, and the others wait and read. If the cache cannot be written, each process compiles.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    place = (Path(chosen) if chosen else default_cache().root / "kernels") / source_key(folder)

    def decorate(function: _Kernel, inner: bool) -> _Kernel:
        # Numba reads both when a function is decorated; other users of Numba keep theirs.
        before = numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES
        numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = str(place), f"{__name__}.{Locator.__name__}"
        # error_model: division by zero gives inf or NaN as in NumPy. Without fastmath nothing is reordered or fused.
        # nogil: other threads of Python go on meanwhile. No compiled code calls a kernel by a pointer.
        options = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True, "no_cpython_wrapper": inner}
        try:
            dispatcher = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # the folder cannot be written
            dispatcher = numba.njit(**options)(function)
        finally:
            numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = before
        dispatcher.compile = _one_at_a_time(dispatcher, place / "lock", inner)
        return cast("_Kernel", dispatcher)

    return lambda function: decorate(function, False), lambda function: decorate(function, True)


def _one_at_a_time(dispatcher: numba.core.dispatcher.Dispatcher, lock: Path, inner: bool) -> Callable[[object], object]:
    """Let one process at a time compile or read kernels; each reads what another has compiled before."""
    compile_kernel = dispatcher.compile

    def compile_alone(signature: object) -> object:
        if global_compiler_lock.is_locked():  # a kernel calls another
            compiled = compile_kernel(signature)
            if inner:
                dispatcher._clear()  # a call from Python comes here again, in place of crashing
            return compiled
        if inner:
            raise TypeError(f"{dispatcher.__name__} is called by kernels only")
        with global_compiler_lock, contextlib.ExitStack() as held:
            with contextlib.suppress(OSError):  # the folder cannot be written any more, or knows no locks
                fcntl.flock(held.enter_context(lock.open("a")), fcntl.LOCK_EX)
            return compile_kernel(signature)

    return compile_alone


def source_key(folder: Path) -> str:
    """Return a digest of what the machine code of a folder's kernels depends on: the syntax of its sources.

    Comments, docstrings and functions without a decorator, which no kernel can call, do not count. Numba alone would
    compile again after any change of the file of a kernel, and would not see one of a kernel that it calls.
    """
    trees = (_compilable(ast.parse(path.read_bytes())) for path in sorted(folder.glob("*.py")))
    return hashlib.sha256("\0".join(map(ast.dump, trees)).encode()).hexdigest()[:16]


def _compilable(module: ast.Module) -> ast.Module:
    """Remove from a module what its kernels cannot use: functions without a decorator that make no constant either."""
    others = [node for node in module.body if not isinstance(node, ast.FunctionDef)]
    named = {node.id for one in others for node in ast.walk(one) if isinstance(node, ast.Name)}
    module.body = [
        node
        for node in module.body
        if not isinstance(node, ast.FunctionDef) or node.decorator_list or node.name in named
    ]
    for node in ast.walk(module):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [one for one in node.body if not _is_docstring(one)]
    return module


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


class Locator:
    """Gives Numba the cache folder, whose name identifies the sources in place of a time stamp."""

    def __init__(self, place: str, file: str) -> None:
        self._place, self._py_file = place, file  # Numba names the file in a warning

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> Self | None:
        """Return the locator of a function that is being decorated; None if the folder cannot be written."""
        del function
        locator = cls(numba.config.CACHE_DIR, file)
        try:
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator if os.access(locator.get_cache_path(), os.W_OK) else None

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._place

    def ensure_cache_path(self) -> None:
        """Create the folder."""
        Path(self._place).mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Return nothing."""
        return ""

    get_disambiguator = get_source_stamp
