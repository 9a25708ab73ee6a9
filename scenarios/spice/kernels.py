"""SPICE kernels: loading under a lock, checks of binary kernels, and constants of instruments in the kernel pool."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import spiceypy
from numpy.typing import NDArray
from spiceypy.utils.exceptions import NotFoundError, SpiceyError

from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import LARGEST_NUMBER

SPICE_ERRORS = (SpiceyError, NotFoundError)
# CSPICE has one kernel pool in a process and is not thread-safe.
_POOL = threading.Lock()

# Layout of binary kernels (NAIF's DAF Required Reading): records of 128 doubles. The file record holds the counts of
# doubles and integers in a summary, ND and NI, the first summary record, and the byte order.
_RECORD, _WORD = 1024, 8
_COUNTS = {b"DAF/SPK ": (2, 6), b"DAF/CK  ": (2, 6), b"DAF/PCK ": (2, 5)}
_ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}


def check_binary(path: Path) -> None:
    """Check that counts and pointers of a binary kernel stay within the file and do not loop; ignore text kernels.

    Raise OSError or ValueError if they do not, or the kernel is of a type that is not supported.
    """
    records, words = path.stat().st_size // _RECORD, path.stat().st_size // _WORD
    with path.open("rb") as file:
        head = file.read(_RECORD)
        if head[:4] not in (b"DAF/", b"DAS/", b"NAIF"):
            return
        counts, order = _COUNTS.get(head[:8]), _ORDERS.get(head[88:96])
        if counts is None or order is None or len(head) < _RECORD:
            raise ValueError("it is binary, but no SPK, CK or PCK of numbers in an order of today")
        if struct.unpack_from(f"{order}2i", head, 8) != counts:
            raise ValueError(f"its summaries are not of {counts[0]} doubles and {counts[1]} integers")
        for summaries in _summary_records(file, struct.unpack_from(f"{order}i", head, 76)[0], records, order):
            for begin, end in _arrays(summaries, order, counts):
                if not 1 <= begin <= end <= words:
                    raise ValueError(f"an array from {begin} to {end} does not lie in its {words} numbers")


def _summary_records(file: BinaryIO, record: int, records: int, order: str) -> Iterator[bytes]:
    """Yield the linked summary records up to the last."""
    seen: set[float] = set()
    number: float = record
    while number != 0.0:
        if number in seen or not 2 <= number <= records or number != int(number):
            raise ValueError(f"its list of arrays leads to record {number:g}, out of the file or round in it")
        seen.add(number)
        file.seek(_RECORD * (int(number) - 1))
        content = file.read(_RECORD)
        yield content
        # The first word of a summary record is the number of the next one, 0 in the last.
        (number,) = struct.unpack_from(f"{order}d", content)


def _arrays(summaries: bytes, order: str, counts: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield first and last word of each array in a summary record: the last two integers of its summary."""
    doubles, integers = counts
    # Two integers are packed in a double.
    size = doubles + (integers + 1) // 2
    # Control words: next record, previous record, number of summaries.
    _, _, number = struct.unpack_from(f"{order}3d", summaries)
    if not (0 <= number <= (_RECORD // _WORD - 3) // size and number == int(number)):
        raise ValueError(f"a record of its list of arrays cannot have {number:g} of them")
    for index in range(int(number)):
        place = _WORD * (3 + index * size + doubles) + 4 * (integers - 2)
        yield struct.unpack_from(f"{order}2i", summaries, place)


def find_kernels(names: Sequence[str], folders: Sequence[Path], key: str) -> list[Path]:
    """Find kernels in ``folders``, then in the data folder; ``key`` names them in messages, see `find_data_file`."""
    return [find_data_file(name, folders, "spice", key) for name in names]


@contextmanager
def loaded_kernels(paths: Sequence[Path]) -> Iterator[None]:
    """Load kernels in the given order, later ones overriding earlier ones, and unload them on exit.

    Meanwhile the kernel pool is locked for other threads; other processes have pools of their own. Errors of SPICE
    inside the context become a `BoresightError` of one line. Raise BoresightError if a kernel is missing or invalid, or
    SPICE signals an error inside the context.
    """
    with _POOL:
        done: list[Path] = []
        try:
            for path in paths:
                _load(path)
                done.append(path)
            yield
        except SPICE_ERRORS as error:
            raise BoresightError(f"SPICE: {spice_message(error)}") from error
        finally:
            for path in reversed(done):
                spiceypy.unload(str(path))


def _load(path: Path) -> None:
    if not path.is_file():
        raise BoresightError(f"{path}: no such kernel")
    if path.suffix.lower() == ".tm":
        raise BoresightError(
            f"{path}: name the kernels themselves instead of this meta-kernel, whose paths start where a program runs"
        )
    try:
        check_binary(path)
    except (OSError, ValueError) as error:
        raise BoresightError(f"{path}: not a kernel that SPICE reads: {error}") from error
    try:
        spiceypy.furnsh(str(path))
    except SpiceyError as error:
        raise BoresightError(f"{path}: not a kernel that SPICE reads: {spice_message(error)}") from error


def spice_message(error: Exception) -> str:
    """Return the message of a SPICE error as one line."""
    parts = (getattr(error, "short", ""), getattr(error, "long", ""))
    said = " ".join(" ".join(str(part).split()) for part in parts if part)
    return said or " ".join(str(error).split())


@dataclass(frozen=True, slots=True)
class Constants:
    """Constants of an instrument in the kernel pool, by its NAIF identifier."""

    kernel_id: int

    def has(self, name: str) -> bool:
        """Return whether a loaded kernel has ``INS<id>_<name>``."""
        return bool(spiceypy.expool(f"INS{self.kernel_id}_{name}"))

    def numbers(self, name: str, count: int) -> NDArray[np.float64]:
        """Return the ``count`` numbers under ``INS<id>_<name>``.

        Raise BoresightError if no loaded kernel has them, their number differs, or one of them is too large.
        """
        key = f"INS{self.kernel_id}_{name}"
        try:
            values = np.array(spiceypy.gdpool(key, 0, 100), dtype=np.float64)
        except SPICE_ERRORS as error:
            raise BoresightError(f"{key}: not in the kernels: name the instrument kernel and its addendum") from error
        if len(values) != count or not (np.abs(values) <= LARGEST_NUMBER).all():
            said = "one number" if count == 1 else f"{count} numbers"
            raise BoresightError(f"{key}: {values.tolist()} is not {said} of any use: check the instrument kernel")
        return values

    def number(self, name: str) -> float:
        """Return the one number under ``INS<id>_<name>``."""
        return float(self.numbers(name, 1)[0])

    def above_zero(self, name: str) -> float:
        """Return the one number under ``INS<id>_<name>``, which must be above 0; raise BoresightError if it is not."""
        value = self.number(name)
        if not value > 0.0:
            raise BoresightError(f"INS{self.kernel_id}_{name}: {value:g} is not above 0: check the instrument kernel")
        return value
