"""Tables of numbers that a scenario names: CSV, Parquet and MATLAB files, ephemerides of the CCSDS, trajectories."""

from __future__ import annotations

import csv
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import one_line
from boresight.scenarios.reading import LARGEST_NUMBER, MOST_FOLD, may_unfold

REF_FRAME = "ref_frame"
"""Column of the name of the frame that states of an ephemeris message are in."""

_OEM_SECTIONS = {"META_START": "META_STOP", "COVARIANCE_START": "COVARIANCE_STOP"}
_OEM_STATE = ("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s")
_TUM = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_OEM_SAME = ("OBJECT_NAME", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM")

Table = Mapping[str, Sequence[object] | FloatArray]
"""Values of each column by its name; texts where the file is CSV."""


def read_table(file: str, folders: Sequence[Path]) -> Table:
    """Read a CSV file with a header and comments after #, Parquet, OEM, TUM or SONIC's MATLAB file.

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
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            return _text_table(stream, path.suffix.lower())
    except UnicodeDecodeError:
        raise ValueError("not a text table: it holds bytes that are not UTF-8") from None


def _text_table(stream: Iterable[str], suffix: str) -> Table:
    """Read the lines of an OEM or TUM file, or of a CSV file with a header."""
    if suffix == ".oem":
        return _ephemeris(stream)
    lines = (line.partition("#")[0] for line in stream)
    if suffix == ".tum":
        return _tum(lines)
    try:
        header, *rows = [
            [word.strip() or "nan" for word in row] for row in csv.reader(lines) if any(map(str.strip, row))
        ]
    except UnicodeDecodeError:
        raise
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


def _tum(lines: Iterable[str]) -> Table:
    """Read a trajectory as evo and the TUM benchmark write it: ``time x y z qx qy qz qw``, s and m.

    The quaternion is the rotation from camera axes (x right, y down, z forward) to those of the positions; the columns
    of the result have its inverse.
    """
    rows = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if words and len(words) != len(_TUM):
            raise ValueError(f"line {number}: {len(words)} numbers, not the 8 of time x y z qx qy qz qw")
        try:
            rows += [[float(word) for word in words]] if words else []
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from None
    if not rows:
        raise ValueError("it has no poses")
    columns = dict(zip(_TUM, np.array(rows).T, strict=True))
    return columns | {name: -columns[name] for name in ("qx", "qy", "qz")}


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


_HEADER_BYTES, _COMPRESSED = 128, 15  # of MATLAB's level-5 format
_FAULTS = (
    ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, NotImplementedError, OSError, RuntimeError,
    TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


def read_matlab(path: Path) -> Mapping[str, NDArray[np.float64]]:
    """Read poses (``cam_positions``, ``cam_rots``) or tracks (``Tracks`` of ``viewIds`` and ``meas``) as a table.

    Poses: ``cam_positions``, (3, F) km, points from the camera to the body's origin, so that the camera is at minus it;
    ``cam_rots``, (3, 3, F), takes body to camera axes. The files have no epochs: ``time_s`` is the number of the view,
    from 0. Tracks: view numbers from 1 and coordinates x / z, y / z. Tracks of one sighting are left out, as the
    matcher that wrote them leaves what it did not find again. Raise ValueError if it is no such file.
    """
    # 0.1 s, which most commands do without.
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        _refuse_bombs(path)
        sizes = {name: int(np.prod(shape, dtype=np.float64)) for name, shape, _ in whosmat(path)}
        if max(sizes.values(), default=0) > MOST_FOLD * path.stat().st_size:
            raise ValueError("its variables are larger than the file can hold")
        content = loadmat(path, variable_names=["cam_positions", "cam_rots", "Tracks"])
        return _tracks(content["Tracks"]) if "Tracks" in content else _poses(content)
    except (*_FAULTS, MatReadError) as error:
        raise ValueError(f"not readable as a MATLAB file of poses or tracks: {one_line(error)}") from None


def _refuse_bombs(path: Path) -> None:
    """Raise ValueError if a variable expands to far more than the size of the file."""
    content = path.read_bytes()
    at = _HEADER_BYTES
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, at)
        if kind == _COMPRESSED:
            stream = zlib.decompressobj()
            most = max(1 << 28, MOST_FOLD * size)
            stream.decompress(content[at + 8 : at + 8 + size], most)
            if stream.unconsumed_tail and not may_unfold(size, most + 1):
                raise ValueError("it would expand to far more than its size")
        at += 8 + size


def _poses(content: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    towards_km, turns = np.asarray(content["cam_positions"]), np.moveaxis(content["cam_rots"], 2, 0)
    if towards_km.shape != (3, len(turns)) or turns.shape[1:] != (3, 3):
        raise ValueError(f"cam_positions {towards_km.shape} and cam_rots are not those of as many views")
    from scipy.spatial.transform import Rotation  # 0.1 s too

    quaternions = Rotation.from_matrix(turns).as_quat(scalar_first=True)
    columns = {"time_s": np.arange(len(turns), dtype=np.float64)}
    columns |= dict(zip(("x_km", "y_km", "z_km"), -towards_km, strict=True))
    return columns | dict(zip(("qw", "qx", "qy", "qz"), quaternions.T, strict=True))


def _tracks(tracks: NDArray[np.void]) -> dict[str, NDArray[np.float64]]:
    views = [np.asarray(one, dtype=np.float64).ravel() for one in tracks["viewIds"].ravel()]
    seen = [np.atleast_2d(np.asarray(one, dtype=np.float64)) for one in tracks["meas"].ravel()]
    several = [k for k in range(len(views)) if len(views[k]) > 1]
    if any(seen[k].shape != (len(views[k]), 2) for k in several):
        raise ValueError("a track has not a row of two meas for each of its viewIds")
    if not several:
        raise ValueError("no track has two sightings")
    places = np.concatenate([seen[k] for k in several])
    return {
        "track": np.repeat(np.array(several, dtype=np.float64), [len(views[k]) for k in several]),
        "frame": np.concatenate([views[k] for k in several]) - 1.0,
        "x_normalised": places[:, 0],
        "y_normalised": places[:, 1],
    }
