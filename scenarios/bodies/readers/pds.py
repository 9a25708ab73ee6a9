"""Readers of text shapes of the Planetary Data System: plate tables and latitude/longitude/radius grids.

Plate tables have two layouts:

- `v`/`f` records (SPICE MKDSK format 3): ``v x y z`` lines, then ``f i j k`` lines;
- counted tables (MKDSK format 1): the number of vertices, lines ``n x y z``, the number of plates, lines ``n i j k``.
"""

from __future__ import annotations

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.readers.source import RawShape, ShapeFile


def read_grid(source: ShapeFile, west: bool) -> RawShape:
    """Read lines ``latitude longitude radius`` (degrees, planetocentric) in any order.

    The rows must fill a whole grid from pole to pole. The poles, repeated for each longitude, become one vertex each
    with the mean radius; a longitude that occurs twice (0 and 360) counts once. The product's label says whether
    longitudes increase westward, ``west``.
    """
    lines = source.lines()
    table = source.table(lines, source.filled(lines), (0, 1, 2))
    latitudes_deg, longitudes_deg, radii = _grid(source, table, west)
    # South pole, the rings from south to north, north pole.
    lat, lon = np.meshgrid(np.radians(latitudes_deg)[1:-1], np.radians(longitudes_deg), indexing="ij")
    ring = radii[1:-1, :, None] * np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    south, north = [0.0, 0.0, -radii[0].mean()], [0.0, 0.0, radii[-1].mean()]
    vertices = np.vstack([south, ring.reshape(-1, 3), north])
    return source.shape(vertices, _faces(len(latitudes_deg) - 2, len(longitudes_deg)))


def _grid(source: ShapeFile, table: FloatArray, west: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sort the rows into latitudes (n,), east longitudes (m,) and radii (n, m)."""
    if (abs(table[:, 0]) > 90.0).any() or (abs(table[:, 1]) > 360.0).any() or (table[:, 2] <= 0.0).any():
        row = table[(abs(table[:, 0]) > 90.0) | (abs(table[:, 1]) > 360.0) | (table[:, 2] <= 0.0)][0]
        raise source.fault(f"{row.tolist()} is not a latitude, a longitude (deg) and a radius above 0")
    # Rounded, as 360 and 0 may differ in the last digit; the second modulo takes 360.0 from rounding to 0.
    east_deg = np.round((-table[:, 1] if west else table[:, 1]) % 360.0, 9) % 360.0
    latitudes_deg, lat_index = np.unique(table[:, 0], return_inverse=True)
    longitudes_deg, lon_index = np.unique(east_deg, return_inverse=True)
    n_lat, n_lon = len(latitudes_deg), len(longitudes_deg)
    if latitudes_deg[0] != -90.0 or latitudes_deg[-1] != 90.0 or n_lat < 3 or n_lon < 3:
        raise source.fault("a grid needs rows at both poles, latitudes between them and at least 3 longitudes")
    if n_lat * n_lon > len(table):
        raise source.fault(f"{n_lat} latitudes x {n_lon} longitudes need more than {len(table)} rows; is the file cut?")
    cell = lat_index * n_lon + lon_index
    count = np.bincount(cell, minlength=n_lat * n_lon)
    if (count == 0).any():
        hole = int(np.argmin(count))
        place = f"latitude {latitudes_deg[hole // n_lon]:g}, east longitude {longitudes_deg[hole % n_lon]:g}"
        raise source.fault(f"the grid has no row at {place} deg; is the file cut?")
    radii = np.bincount(cell, weights=table[:, 2]) / count
    return latitudes_deg, longitudes_deg, radii.reshape(n_lat, n_lon)


def _faces(n_rings: int, n_lon: int) -> IndexArray:
    """Triangles between the rings and fans at the poles, counter-clockwise from outside."""
    here = np.arange(n_lon)
    east = np.roll(here, -1)
    ring = 1 + n_lon * np.arange(n_rings)[:, None]
    low, low_east, high, high_east = ring[:-1] + here, ring[:-1] + east, ring[1:] + here, ring[1:] + east
    last = ring[-1]
    pole = np.full(n_lon, 1 + n_rings * n_lon)
    parts = [
        np.stack([np.zeros_like(here), 1 + east, 1 + here], axis=-1),
        np.stack([low, low_east, high_east], axis=-1).reshape(-1, 3),
        np.stack([low, high_east, high], axis=-1).reshape(-1, 3),
        np.stack([last + here, last + east, pole], axis=-1),
    ]
    return np.concatenate(parts).astype(np.int64)


def read_plates(source: ShapeFile) -> RawShape:
    """Read a PDS plate table; indices may start at 0 or at 1.

    The `v`/`f` layout resembles an OBJ file, but the base of its indices differs between products
    (1 in 1620geographos.tab, 0 in eros022540.tab): a file that contains index 0 is 0-based.
    """
    lines = source.lines()
    first = lines[source.filled(lines)[0]].split()
    vertices, faces = _tagged(source, lines) if first[0] in ("v", "f", "#") else _counted(source, lines)
    # A 1-based table cannot contain index 0.
    base = 0 if len(faces) and faces.min() == 0 else 1
    return source.shape(vertices, faces - base)


def _tagged(source: ShapeFile, lines: list[str]) -> tuple[FloatArray, FloatArray]:
    rows: dict[str, list[int]] = {"v": [], "f": []}
    for i, line in enumerate(lines):
        tag = line.split(maxsplit=1)[0] if line.strip() else "#"
        if tag in rows:
            rows[tag].append(i)
        elif not tag.startswith("#"):
            raise source.fault(f"a line of a plate table starts with v or f, not {tag[:40]!r}", i + 1)
    return source.table(lines, rows["v"], (1, 2, 3)), source.table(lines, rows["f"], (1, 2, 3))


def _counted(source: ShapeFile, lines: list[str]) -> tuple[FloatArray, FloatArray]:
    filled = source.filled(lines)
    n_vertices = _count(source, lines, filled, 0)
    n_plates = _count(source, lines, filled, n_vertices + 1)
    end = n_vertices + n_plates + 2
    if len(filled) != end:
        raise source.fault(f"{n_vertices} vertices and {n_plates} plates need {end} lines, found {len(filled)}")
    columns = (1, 2, 3)
    vertices = source.table(lines, filled[1 : n_vertices + 1], columns)
    return vertices, source.table(lines, filled[n_vertices + 2 :], columns)


def _count(source: ShapeFile, lines: list[str], filled: list[int], at: int) -> int:
    if at >= len(filled):
        raise source.fault(f"the table ends after {len(filled)} lines, before its count of plates; is the file cut?")
    word = lines[filled[at]].strip()
    if not (word.isascii() and word.isdigit() and len(word) < 16):
        raise source.fault(f"expected a count, found {word[:40]!r}; check body.format", filled[at] + 1)
    return int(word)
