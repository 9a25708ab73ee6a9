"""Common parts of the shape readers: file content, tables of numbers, and errors with file and line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import LARGEST_NUMBER, number_in, read_bytes


class RawShape(NamedTuple):
    """Vertices (V, 3), body frame in the unit of the file, and faces (F, 3), from 0, before any check of the mesh.

    ``unit`` is the one that the format prescribes, None if it prescribes none.
    """

    vertices: FloatArray
    faces: IndexArray
    unit: Literal["km"] | None = None


class ShapeFile:
    """The content of a shape file, and errors that name its path."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        self.data = data

    @classmethod
    def open(cls, path: Path) -> ShapeFile:
        """Read the whole file; raise `BoresightError` if it is missing, unreadable or empty."""
        data = read_bytes(path)
        if not data.strip():
            raise cls(path, data).fault("the shape file is empty; give a file with vertices and faces")
        return cls(path, data)

    def lines(self) -> list[str]:
        """Decode the file as UTF-8 lines; line n of the file is item n - 1."""
        if b"\0" in self.data:
            raise self.fault("a text format was expected, but the file is binary; check body.format")
        try:
            return self.data.decode("utf-8").splitlines()
        except UnicodeDecodeError as error:
            line = self.data.count(b"\n", 0, error.start) + 1
            raise self.fault("a text format was expected, but this is not text; check body.format", line) from error

    def filled(self, lines: Sequence[str]) -> list[int]:
        """Return the indices (from 0) of the lines that are not blank; raise an error if there are none."""
        rows = [i for i, line in enumerate(lines) if line.strip()]
        if not rows:
            raise self.fault("the shape file is empty; give a file with vertices and faces")
        return rows

    def fault(self, what: str, line: int | None = None) -> BoresightError:
        """Return an error about this file, with the line number (from 1) if given."""
        place = f"{self.path}:{line}" if line else str(self.path)
        return BoresightError(f"{place}: {what}")

    def table(self, lines: Sequence[str], rows: Sequence[int], columns: tuple[int, ...]) -> FloatArray:
        """Parse the given columns of the given lines (both from 0) to (len(rows), len(columns)) finite numbers.

        Raise BoresightError with the first line in which a column is missing, not a number or not finite.
        """
        if not rows:
            return np.empty((0, len(columns)))
        try:
            # comments=None: a # in a table is an error, not the end of a line.
            values = np.loadtxt((lines[i] for i in rows), usecols=columns, comments=None, ndmin=2)
        except ValueError as error:
            raise self._first_bad(lines, rows, columns) from error
        if len(values) != len(rows) or not (np.abs(values) <= LARGEST_NUMBER).all():
            raise self._first_bad(lines, rows, columns)
        return values

    def _first_bad(self, lines: Sequence[str], rows: Iterable[int], columns: tuple[int, ...]) -> BoresightError:
        for i in rows:
            words = lines[i].split()
            if len(words) <= max(columns):
                return self.fault(f"expected {max(columns) + 1} columns, found {len(words)}; is the file cut?", i + 1)
            for column in columns:
                if not abs(number_in(words[column])) <= LARGEST_NUMBER:
                    return self.fault(f"{words[column][:40]!r} is not a finite number of any use", i + 1)
        return self.fault("the table cannot be read as numbers; check body.format")

    def shape(self, vertices: FloatArray, faces: FloatArray | IndexArray) -> RawShape:
        """Check that there are faces, finite vertices and valid indices (from 0), and return the shape."""
        if not len(vertices) or not len(faces):
            raise self.fault(f"{len(vertices)} vertices and {len(faces)} faces; a shape needs both")
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise self.fault(f"vertices have {vertices.shape[-1]} coordinates, not 3")
        useful = (np.abs(vertices) <= LARGEST_NUMBER).all(axis=1)
        if not useful.all():
            first = int(np.argmin(useful))
            raise self.fault(f"vertex {first + 1} is not finite, or far too large: {vertices[first].tolist()}")
        # Indices come as floating-point numbers from tables: they must be whole.
        bad = (faces < 0) | (faces >= len(vertices)) | (faces != np.floor(faces))
        if bad.any():
            first = int(np.flatnonzero(bad.any(axis=1))[0])
            raise self.fault(
                f"face {first + 1} of {len(faces)} names a vertex that does not exist"
                f" (index {faces[first][bad[first]][0]:g} from 0, {len(vertices)} vertices)"
            )
        return RawShape(np.asarray(vertices, dtype=np.float64), faces.astype(np.int64))
