"""Tables of numbers that a scenario names: CSV and Parquet files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file
from boresight.scenarios.limits import LARGEST_NUMBER

Table = Mapping[str, Sequence[object]]
"""Values of each column by its name; texts where the file is CSV."""


def read_table(file: str, folders: Sequence[Path]) -> Table:
    """Read a CSV file with a header and comments after #, or a Parquet file, from ``folders`` or the data folder.

    Raises
    ------
    BoresightError, OSError, ValueError
        If it is missing, not readable, or of lines of unlike length.
    """
    path = find_data_file(file, folders, "tables", "table")
    if path.suffix == ".parquet":
        import pyarrow as pa  # 0.1 s, which most commands do without
        from pyarrow import parquet

        try:
            return {str(name): values for name, values in parquet.read_table(path).to_pydict().items()}
        except (pa.ArrowException, KeyError, TypeError) as error:
            raise ValueError(f"not readable as Parquet: {error}") from None
    with path.open(encoding="utf-8", newline="") as stream:
        lines = (line.partition("#")[0] for line in stream)
        try:
            header, *rows = [
                [word.strip() or "nan" for word in row] for row in csv.reader(lines) if any(map(str.strip, row))
            ]
        except (csv.Error, ValueError):  # no line but comments is a ValueError of the unpacking
            raise ValueError("not readable as a CSV file with a header") from None
    for number, row in enumerate(rows):
        if len(row) != len(header):
            raise ValueError(f"row {number} (from 0) has {len(row)} values, not {len(header)} as the header")
    return dict(zip(header, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(header, ())


def columns_of(table: Table, names: Sequence[str]) -> FloatArray:
    """Return columns of a table, (n, len(names)).

    Raises
    ------
    ValueError, TypeError
        If a column is missing, or a value is no number of any use.
    """
    absent = [name for name in names if name not in table]
    if absent:
        raise ValueError(f"no column {absent[0]}; it has {', '.join(table)}")
    try:
        values = np.array([table[name] for name in names], dtype=np.float64).T
    except OverflowError:
        raise ValueError(f"a number in {', '.join(names)} is too large") from None
    if values.ndim != 2:
        raise ValueError(f"{', '.join(names)} are not numbers")
    usable = (np.abs(values) <= LARGEST_NUMBER).all(axis=1)  # False for NaN
    if not usable.all():
        row = int(np.argmin(usable))
        raise ValueError(f"row {row} (from 0) of {', '.join(names)} is not all numbers up to {LARGEST_NUMBER:g}")
    return values
