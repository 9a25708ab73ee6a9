"""Limits of valid input files, and robust reading of JSON files and NumPy archives within them."""

from __future__ import annotations

import json
import os
import tokenize
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from boresight.scenarios.errors import BoresightError, one_line, printable

# Checked before numbers overflow and before memory is allocated.
LARGEST_NUMBER = 1e30
"""Largest accepted magnitude of a number in a file; squares and cubes of it are still finite."""
MOST_PIXELS = 1 << 26
"""Largest image: 8192 x 8192, the largest camera of a scenario."""

_MOST_BYTES = 1 << 28
MOST_FOLD = 64
"""Largest accepted ratio of the uncompressed to the compressed size of a file."""


def may_unfold(stored_bytes: int, unfolded_bytes: int) -> bool:
    """Return whether the uncompressed size is plausible for the stored size (decompression bombs are not)."""
    return unfolded_bytes <= max(_MOST_BYTES, MOST_FOLD * stored_bytes)


def installed_memory_bytes() -> int:
    """Return the installed memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


Model = TypeVar("Model", bound=BaseModel)

# np.load documents ValueError and OSError only; damaged headers and members raise the others too.
_ARCHIVE_FAULTS = (
    ArithmeticError, EOFError, LookupError, MemoryError, NotImplementedError, OSError, RecursionError, RuntimeError,
    SyntaxError, TypeError, ValueError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip

CONTENT_FAULTS = (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError, BoresightError)
"""Exceptions raised when valid arrays and headers are inconsistent with each other."""


def number_in(text: object) -> float:
    """Return the number that a text is; NaN if it is none."""
    try:
        return float(str(text))
    except ValueError:
        return float("nan")


def read_bytes(path: Path) -> bytes:
    """Read a whole file; raise BoresightError if it is missing or cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise BoresightError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_json(path: Path, what: str) -> Any:
    """Read a JSON file; ``what`` is its expected content, for the error message.

    Raise FileNotFoundError if it does not exist, BoresightError if it cannot be read or is not JSON.
    """
    try:
        return plain_json(path)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise BoresightError(f"{path}: cannot be read as {what}: {one_line(error)}") from error


def plain_json(path: Path) -> Any:
    """Read a JSON file and raise plain exceptions for the caller to explain.

    Raise OSError or ValueError if it cannot be read or is no JSON.
    """
    if path.exists() and not path.is_file():
        raise ValueError("it is a folder, a device or a pipe")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error


def held_to(model: type[Model], plain: object) -> Model:
    """Validate the content of a file against a model.

    Raise ValueError if it does not fit; the message is one line about the first fault.
    """
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ValueError(printable(f"{place}: {first['msg']}" if place else first["msg"])) from error


def unreadable(path: Path, what: str, error: Exception) -> BoresightError:
    """Return the error for an unreadable manifest or table without checksums, with the first sentence of the cause."""
    gist = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    gist = gist.splitlines()[0].partition(". ")[0].strip(" .:") if gist else type(error).__name__
    return BoresightError(
        f"{path}: not readable as {what} ({gist}): damaged, or not written by boresight; run the campaign again, into"
        " another folder (--out)"
    )


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays of a NumPy archive without unpickling any object.

    Raise ValueError if the file is missing, is not an archive, or declares implausibly many numbers. The caller adds
    the context.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        size = path.stat().st_size
        names = [member.filename for member in members]
        if len(set(names)) < len(names) or not may_unfold(size, sum(member.file_size for member in members)):
            raise ValueError("an array is there twice, or much more is packed in it than a sound file holds")
        # The user can do nothing about NumPy's warnings on headers.
        with warnings.catch_warnings(action="ignore"), np.load(path, allow_pickle=False) as stored:
            return {name: _sound(stored[name]) for name in stored.files}
    except _ARCHIVE_FAULTS as error:
        raise ValueError(one_line(error) or type(error).__name__) from error


def _sound(array: object) -> NDArray[Any]:
    """Raise an error for a member that is not a numeric array; NumPy returns other members as bytes."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise ValueError("a member is no array of numbers")
    return array
