"""Reader of digital shape kernels of SPICE (DSK): one segment of type 2, a set of triangular plates, km.

CSPICE is not used: it aborts the process at a damaged file. The layout is that of NAIF's DAS and DSK Required Reading.
A DAS file has records of 1024 bytes: the file record, reserved and comment records, and directories, each followed by
clusters of records of characters, doubles or integers. The clusters of a type, one after the other, are its words.

=================== ==========================================================================================
integer 2           number (from 1) of the first integer of the first segment's descriptor; -1: no segment
descriptor          eight integers: previous and next descriptor (-1: none), and of the segment's integers, doubles
                    and characters how many words of the file are before them, and their number
doubles             of a segment: 24 of its description, the fourth of which is its type; of type 2 then 10 of
                    bounds and voxels, and the vertices
integers            of type 2: number of vertices, of plates, 8 of voxels, and the plates, vertices from 1
=================== ==========================================================================================
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.readers.source import RawShape, ShapeFile

Number = TypeVar("Number", np.float64, np.int64)

DSK_HEAD = b"DAS/DSK "
_RECORD = 1024
_ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}
_CHARACTERS, _DOUBLES, _INTEGERS = range(3)
_NONE = -1
_TYPE_2 = 2
_BEFORE_VERTICES, _BEFORE_PLATES, _TYPE_AT = 34, 10, 3


def read_dsk(source: ShapeFile) -> RawShape:
    """Read the plates of a DSK file; its coordinates are km by definition.

    Raise BoresightError if the file is damaged or cut, or does not hold one segment of type 2.
    """
    order = _ORDERS.get(source.data[84:92])
    if not source.data.startswith(DSK_HEAD) or order is None or len(source.data) < _RECORD:
        raise source.fault("not a DSK file: it must start with DAS/DSK and name a byte order, LTL-IEEE or BIG-IEEE")
    doubles, integers = _words(source, order)
    if len(integers) < 2 or integers[1] == _NONE:
        raise source.fault("the DSK file has no segment; give a file with one")
    _, after, *parts = _part(source, integers, int(integers[1]) - 1, 8).tolist()
    if after != _NONE:
        raise source.fault("the DSK file has several segments; give a file with one: one body, one surface")
    integers, doubles = _part(source, integers, *parts[:2]), _part(source, doubles, *parts[2:4])
    kind = doubles[_TYPE_AT] if len(doubles) > _TYPE_AT else np.nan
    if kind != _TYPE_2:
        raise source.fault(f"the DSK segment is of type {kind:g}; only type {_TYPE_2}, triangular plates, is read")
    n_vertices, n_plates = _part(source, integers, 0, 2).tolist()
    vertices = _part(source, doubles, _BEFORE_VERTICES, 3 * n_vertices).reshape(-1, 3)
    plates = _part(source, integers, _BEFORE_PLATES, 3 * n_plates).reshape(-1, 3)
    shape = source.shape(vertices, plates - 1)
    return RawShape(shape.vertices, shape.faces, unit="km")


def _part(source: ShapeFile, words: NDArray[Number], begin: int, size: int) -> NDArray[Number]:
    """Return ``size`` words after the first ``begin``."""
    if not (begin >= 0 and size >= 0 and begin + size <= len(words)):
        raise source.fault(f"the DSK file leads to words {begin + 1} to {begin + size} of {len(words)}; is it damaged?")
    return words[begin : begin + size]


def _words(source: ShapeFile, order: str) -> tuple[FloatArray, IndexArray]:
    """Join the clusters of a type: the doubles and the integers of the file."""
    parts: tuple[list[bytes], ...] = ([], [], [])
    last = np.zeros(3, dtype=np.int64)
    for at, directory in _directories(source, order):
        first = at + 1
        for kind, size in _clusters(source, directory):
            end = first + size - 1
            if end * _RECORD > len(source.data):
                records = len(source.data) // _RECORD
                raise source.fault(f"its directory announces {end} records, the file has {records}; is it cut?")
            parts[kind].append(source.data[_RECORD * (first - 1) : _RECORD * end])
            first = end + 1
        # Lowest and highest number of characters, of doubles and of integers.
        last = np.maximum(last, directory[3:8:2])
    doubles = np.frombuffer(b"".join(parts[_DOUBLES]), dtype=f"{order}f8")[: last[_DOUBLES]]
    integers = np.frombuffer(b"".join(parts[_INTEGERS]), dtype=f"{order}i4")[: last[_INTEGERS]]
    return doubles.astype(np.float64), integers.astype(np.int64)


def _directories(source: ShapeFile, order: str) -> Iterator[tuple[int, IndexArray]]:
    """Yield number (from 1) and content (256,) of the linked directory records; each lies behind the one before."""
    # Reserved records, their characters, comment records, their characters.
    reserved, _, comments, _ = struct.unpack_from(f"{order}4i", source.data, 68)
    at, before = 2 + reserved + comments, 1
    while at != 0:
        content = source.data[_RECORD * (at - 1) : _RECORD * at] if at > before else b""
        if len(content) < _RECORD:
            raise source.fault(f"its directory of records leads to record {at}, not in the file; is it cut?")
        directory = np.frombuffer(content, dtype=f"{order}i4").astype(np.int64)
        yield at, directory
        at, before = int(directory[1]), at


def _clusters(source: ShapeFile, directory: IndexArray) -> Iterator[tuple[int, int]]:
    """Yield type and number of records of each cluster of a directory.

    The directory names the type of its first cluster. The size of a later one is positive if its type is the next one
    in the cycle of characters, doubles and integers, and negative if it is the one before.
    """
    kind, sizes = int(directory[8]) - 1, directory[9:].tolist()
    if sizes[0] and kind not in (_CHARACTERS, _DOUBLES, _INTEGERS):
        raise source.fault(f"its directory has a cluster of type {kind + 1}; DAS files know 1 to 3")
    for index, size in enumerate(sizes):
        if size == 0:
            return
        if index:
            kind = (kind + (1 if size > 0 else -1)) % 3
        yield kind, abs(size)
