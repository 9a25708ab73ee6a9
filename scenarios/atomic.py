"""Write files atomically: after a crash or power failure a file is either complete or absent."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable
from pathlib import Path

from boresight.scenarios.errors import BoresightError


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Write a temporary file in the folder of ``path`` by ``write(temporary)``, flush it to the disk, then rename it.

    Raise BoresightError if the disk is full or the folder cannot be written; the temporary file is removed.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        make_folder(path.parent)
        write(temporary)
        _flush(temporary)
        # The content is on the disk before the name is, and the name before the function returns.
        temporary.replace(path)
        _flush(path.parent)
    except OSError as error:
        raise BoresightError(explain_write_error(path, error)) from error
    finally:
        # A failed clean-up must not hide the fault above; the name marks the file as no result.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def make_folder(folder: Path) -> None:
    """Make a folder and flush its entry in the parent folder, so that it survives a power failure."""
    if folder.is_dir():
        return
    if folder.parent != folder:
        make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    _flush(folder.parent)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def explain_write_error(path: Path | str, error: OSError) -> str:
    """Return one line that states why a file could not be written, and what to do."""
    advice = {
        errno.ENOSPC: "the disk is full: free some space and run the same command again, it will continue",
        errno.EDQUOT: "the disk quota is used up: free some space and run the same command again, it will continue",
        errno.EFBIG: "the file size limit was hit (ulimit -f): raise it and run the same command again",
        errno.EACCES: "no permission to write there: choose another folder with --out",
        errno.EPERM: "no permission to write there: choose another folder with --out",
        errno.EROFS: "the folder is read-only: choose another one with --out",
        errno.ENOTDIR: "a part of that path is a file: choose another folder with --out",
        errno.EEXIST: "a part of that path is a file: choose another folder with --out",
    }.get(error.errno or 0, error.strerror or str(error))
    return f"{path}: could not be written: {advice}"
