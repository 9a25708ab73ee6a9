"""Search for a libLLVM that works with Dr.Jit, before Dr.Jit is imported.

Dr.Jit selects a libLLVM when it is imported, and with LLVM 14 to 16 it later aborts the process at its first real
kernel. The library is therefore chosen here, without importing Dr.Jit, and passed on in ``DRJIT_LIBLLVM_PATH``.
The candidates, in order: the path that the user set, the ``karellen-llvm-core`` wheel, and the system's libraries,
newest first. Each is loaded in a subprocess that reports its version, as two LLVMs in one process conflict.

``BORESIGHT_HIDE_LLVM=1`` hides all of them, to test rendering without LLVM on any machine.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

MINIMUM_MAJOR = 17
PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
HIDE_VARIABLE = "BORESIGHT_HIDE_LLVM"
WHEEL = "karellen-llvm-core"

_SYSTEM_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)
_PROBE = """
import ctypes, sys
for path in sys.argv[2:]:
    ctypes.CDLL(path)
library = ctypes.CDLL(sys.argv[1])
numbers = [ctypes.c_uint() for _ in range(3)]
if not hasattr(library, "LLVMGetVersion"):
    sys.exit("LLVM 15 or older, as it cannot tell its version: too old for Dr.Jit")
library.LLVMGetVersion(*[ctypes.byref(n) for n in numbers])
print(".".join(str(n.value) for n in numbers))
"""


@dataclass(frozen=True, slots=True)
class LlvmLibrary:
    """A usable libLLVM: its file, its version, and the libraries to load before it."""

    path: Path
    version: str
    preload: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class RejectedLibrary:
    """A libLLVM that cannot be used, and the reason."""

    path: Path
    reason: str


@dataclass(frozen=True, slots=True)
class LlvmSearch:
    """Result of a search: the library to use, if any, and those rejected before it."""

    found: LlvmLibrary | None
    rejected: tuple[RejectedLibrary, ...] = ()


def find_llvm() -> LlvmSearch:
    """Search for the first usable libLLVM, without loading any into this process."""
    if os.environ.get(HIDE_VARIABLE, "0") not in ("", "0"):
        return LlvmSearch(None)
    rejected: list[RejectedLibrary] = []
    for path, preload in _candidates():
        version, reason = _probe(path, preload)
        if not reason:
            return LlvmSearch(LlvmLibrary(path, version, preload), tuple(rejected))
        rejected.append(RejectedLibrary(path, reason))
    return LlvmSearch(None, tuple(rejected))


def use_llvm(library: LlvmLibrary) -> None:
    """Make Dr.Jit, not yet imported, load this library, also in child processes."""
    for path in library.preload:
        ctypes.CDLL(str(path))
    os.environ[PATH_VARIABLE] = str(library.path)


def _candidates() -> Iterator[tuple[Path, tuple[Path, ...]]]:
    user = os.environ.get(PATH_VARIABLE)
    wheel = _wheel_files()
    if user:
        # A parent process may have set the wheel's library, which needs the libraries loaded before it here too.
        yield next((item for item in wheel if item[0] == Path(user)), (Path(user), ()))
    yield from (item for item in wheel if item[0] != Path(user or ""))
    yield from ((path, ()) for path in _system_files() if str(path) != user)


def _wheel_files() -> list[tuple[Path, tuple[Path, ...]]]:
    """Return the wheel's libLLVM with the C++ runtime libraries that it was built against."""
    try:
        files = importlib.metadata.distribution(WHEEL).files or []
    except importlib.metadata.PackageNotFoundError:
        return []
    paths = [Path(str(file.locate())).resolve() for file in files if re.match(r"lib(LLVM|unwind|c\+\+)", file.name)]
    runtime = [
        next((path for path in paths if path.name.startswith(f"{name}.so.1") and path.is_file()), None)
        # In the order in which they depend on each other.
        for name in ("libunwind", "libc++abi", "libc++")
    ]
    preload = tuple(path for path in runtime if path is not None)
    return [(path, preload) for path in dict.fromkeys(paths) if re.match(r"libLLVM\.(so\.|dylib)", path.name)]


def _system_files() -> list[Path]:
    """Return the system's libLLVM files without duplicates, newest first by the version in their names."""
    patterns = [f"{folder.lstrip('/')}/libLLVM{tail}" for folder in _SYSTEM_FOLDERS for tail in ("*.so*", "*.dylib")]
    found = {path.resolve() for pattern in patterns for path in Path("/").glob(pattern)}
    return sorted(found, key=lambda path: (_version_in_name(path), str(path)), reverse=True)


def _version_in_name(path: Path) -> tuple[int, ...]:
    numbers = re.search(r"(\d+(?:\.\d+)*)", path.name)
    return tuple(int(n) for n in numbers[1].split(".")) if numbers else (0,)


def _probe(path: Path, preload: tuple[Path, ...]) -> tuple[str, str]:
    """Load a library in a subprocess; return its version, and why it cannot be used ('' if it can)."""
    if not path.is_file():
        return "", "no such file"
    command = [sys.executable, "-I", "-S", "-c", _PROBE, str(path), *map(str, preload)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)  # noqa: S603
    except (OSError, subprocess.TimeoutExpired) as error:
        return "", f"could not be tried: {error}"
    version = done.stdout.strip()
    if done.returncode != 0 or not version:
        last_line = (done.stderr.strip().splitlines() or [f"loading it ended with code {done.returncode}"])[-1]
        return "", last_line
    if int(version.split(".")[0]) < MINIMUM_MAJOR:
        return version, f"LLVM {version} is too old: Dr.Jit needs {MINIMUM_MAJOR} or newer"
    return version, ""
