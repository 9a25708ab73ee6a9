"""The frame of binary kernels (SPK, CK, PCK): a library in C follows its counts and pointers without a look at them.

A DAF (double precision array file) is made of records of 1024 bytes. The first says how many doubles and integers a
summary has, and which record begins the list of summaries; each of these names the next one and tells of its arrays,
with the addresses (in doubles, from 1) at which they begin and end. See NAIF's "DAF Required Reading".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_RECORD, _WORD = 1024, 8
_COUNTS = {b"DAF/SPK ": (2, 6), b"DAF/CK  ": (2, 6), b"DAF/PCK ": (2, 5)}
_ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}


def check_binary(path: Path) -> None:
    """Refuse a binary kernel whose counts and pointers lead out of the file or round in it; texts are left alone.

    Raises
    ------
    OSError, ValueError
        If it is one, or of a kind that boresight has no use for.
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
    """Walk the list of summary records to its end."""
    seen: set[float] = set()
    number: float = record
    while number != 0.0:
        if number in seen or not 2 <= number <= records or number != int(number):
            raise ValueError(f"its list of arrays leads to record {number:g}, out of the file or round in it")
        seen.add(number)
        file.seek(_RECORD * (int(number) - 1))
        content = file.read(_RECORD)
        yield content
        (number,) = struct.unpack_from(f"{order}d", content)


def _arrays(summaries: bytes, order: str, counts: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield where each array of a record of summaries begins and ends: the last two integers of its summary."""
    doubles, integers = counts
    size = doubles + (integers + 1) // 2
    _, _, number = struct.unpack_from(f"{order}3d", summaries)
    if not (0 <= number <= (_RECORD // _WORD - 3) // size and number == int(number)):
        raise ValueError(f"a record of its list of arrays cannot have {number:g} of them")
    for index in range(int(number)):
        place = _WORD * (3 + index * size + doubles) + 4 * (integers - 2)
        yield struct.unpack_from(f"{order}2i", summaries, place)
