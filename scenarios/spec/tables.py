"""Tables of numbers that a scenario names: CSV, Parquet and MATLAB files, and ephemerides of the CCSDS."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file
from boresight.scenarios.limits import LARGEST_NUMBER
from boresight.scenarios.spec.matlab import read_matlab

REF_FRAME = "ref_frame"
"""Column of the name of the frame that states of an ephemeris message are in."""

_OEM_SECTIONS = {"META_START": "META_STOP", "COVARIANCE_START": "COVARIANCE_STOP"}
_OEM_STATE = ("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s")
_OEM_SAME = ("OBJECT_NAME", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM")

Table = Mapping[str, Sequence[object] | FloatArray]
"""Values of each column by its name; texts where the file is CSV."""


def read_table(file: str, folders: Sequence[Path]) -> Table:
    """Read a CSV file with a header and comments after #, Parquet, OEM or SONIC's MATLAB file.

    It is looked for in ``folders`` and the data folder. Raise BoresightError, OSError or ValueError if it is missing,
    not readable, or of lines of unlike length.
    """
    path = find_data_file(file, folders, "tables", "table")
    if path.suffix == ".parquet":
        import pyarrow as pa  # 0.1 s, which most commands do without
        from pyarrow import parquet

        try:
            return {str(name): values for name, values in parquet.read_table(path).to_pydict().items()}
        except (pa.ArrowException, KeyError, TypeError) as error:
            raise ValueError(f"not readable as Parquet: {error}") from None
    if path.suffix == ".mat":
        return read_matlab(path)
    with path.open(encoding="utf-8", newline="") as stream:
        if path.suffix.lower() == ".oem":
            return _ephemeris(stream)
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


def _ephemeris(lines: Iterable[str]) -> Table:
    """Read an Orbit Ephemeris Message (CCSDS 502.0-B-3) in keyword = value notation.

    Its segments are joined to one, and the first state of a segment is left out if the last of the one before has its
    epoch. Epochs are s after the first, without leap seconds between them. Accelerations and covariances are not read.
    """
    meta: dict[str, str] = {}
    epochs, rows = list[tuple[datetime, float]](), list[list[float]]()
    until, begins = "", False
    for number, line in enumerate(map(str.strip, lines), start=1):
        key, equals, value = (part.strip() for part in line.partition("="))
        if number == 1 and key != "CCSDS_OEM_VERS":
            raise ValueError("no Orbit Ephemeris Message as text: its first line is not CCSDS_OEM_VERS")
        if line in _OEM_SECTIONS:
            until = _OEM_SECTIONS[line]
        elif line == until:
            until, begins = "", until == "META_STOP" or begins
        elif equals and until == "META_STOP" and key in _OEM_SAME:
            if meta.setdefault(key, value) != value:
                raise ValueError(f"line {number}: segments of another {key} than {meta[key]} are not one trajectory")
        elif line and not equals and not until and not line.startswith("COMMENT"):
            if len(meta) < len(_OEM_SAME):
                absent = next(name for name in _OEM_SAME if name not in meta)
                raise ValueError(f"line {number}: a state comes before {absent} of its META section")
            epoch, *numbers = line.split()
            if len(numbers) not in (6, 9):
                raise ValueError(f"line {number}: not an epoch with 6 or 9 numbers")
            here = _epoch(epoch, number)
            if not (begins and epochs and here == epochs[-1]):
                epochs.append(here)
                rows.append([float(word) for word in numbers[:6]])
            begins = False
    if until:
        raise ValueError(f"it ends without {until}")
    if not rows:
        raise ValueError("it has no states")
    first, part = epochs[0]
    times = [(minute - first).total_seconds() + (seconds - part) for minute, seconds in epochs]
    states = dict(zip(_OEM_STATE, zip(*rows, strict=True), strict=True))
    return {"time_s": times, **states, REF_FRAME: [meta["REF_FRAME"]] * len(rows)}


def _epoch(text: str, line: int) -> tuple[datetime, float]:
    """Return minute and seconds of an epoch by month and day or by the day of the year."""
    minute, _, seconds = text.removesuffix("Z").rpartition(":")
    try:
        found = datetime.strptime(minute, "%Y-%m-%dT%H:%M" if minute.count("-") == 2 else "%Y-%jT%H:%M")
        part = float(seconds)
    except ValueError:
        part = np.nan
    if not 0.0 <= part < 61.0:
        raise ValueError(f"line {line}: {text[:40]!r} is not an epoch as 2026-11-25T12:00:00.000")
    return found, part


def columns_of(table: Table, names: Sequence[str]) -> FloatArray:
    """Return columns of a table, (n, len(names)).

    Raise ValueError or TypeError if a column is missing, or a value is no number of any use.
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
