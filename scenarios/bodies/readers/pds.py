"""Readers of text shapes of the Planetary Data System: plate tables, latitude/longitude/radius grids, and ICQ.

Plate tables have two layouts:

- `v`/`f` records (SPICE MKDSK format 3): ``v x y z`` lines, then ``f i j k`` lines;
- counted tables (MKDSK format 1): the number of vertices, lines ``n x y z``, the number of plates, lines ``n i j k``.

Gaskell's implicitly connected quadrilaterals (ICQ) are numbered on a cube grid: six faces of (Q + 1) x (Q + 1) points
cover a body like the sides of a cube. Points on the seams belong to two or three faces; integer lattice positions
identify the coincident ones.
"""

from __future__ import annotations

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.readers.source import RawShape, ShapeFile
from boresight.scenarios.geometry import spherical_direction


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
    ring = radii[1:-1, :, None] * spherical_direction(lon, lat)
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


# For each face: lattice position of its first point, step along I and step along J, in units of Q.
_FACES = np.array(
    [
        [[0, 1, 1], [1, 0, 0], [0, -1, 0]],
        [[0, 0, 1], [1, 0, 0], [0, 0, -1]],
        [[0, 1, 1], [0, -1, 0], [0, 0, -1]],
        [[1, 1, 1], [-1, 0, 0], [0, 0, -1]],
        [[1, 0, 1], [0, 1, 0], [0, 0, -1]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    ]
)


def cube_lattice(q: int) -> IndexArray:
    """Integer cube positions, (6 (q + 1)**2, 3), of the points in ICQ order: face by face, I runs fastest."""
    i, j = np.meshgrid(np.arange(q + 1), np.arange(q + 1), indexing="xy")
    start, step_i, step_j = (_FACES[:, k, None, None, :] for k in range(3))
    points: IndexArray = q * start + i[..., None] * step_i + j[..., None] * step_j
    return points.reshape(-1, 3)


def cube_quads(q: int) -> IndexArray:
    """Corners, (6 q**2, 4), of the quadrilaterals as point numbers in ICQ order, counter-clockwise from outside."""
    face, j, i = np.meshgrid(np.arange(6), np.arange(q), np.arange(q), indexing="ij")
    # Number of a point in ICQ order.
    corner = (face * (q + 1) + j) * (q + 1) + i
    down = q + 1
    return np.stack([corner, corner + down, corner + down + 1, corner + 1], axis=-1).reshape(-1, 4)


def weld_seams(q: int) -> tuple[IndexArray, IndexArray]:
    """Coincident points of the seams: the first point of each of the 6 q**2 + 2 groups, and each point's group."""
    # One integer for each lattice position; points on the seams have the same.
    key = cube_lattice(q) @ np.array([(q + 1) ** 2, q + 1, 1])
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    # Groups are numbered by their first points, so that vertices keep the order of the file.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[group]


def read_icq(source: ShapeFile) -> RawShape:
    """Read the grid size Q, then 6 (Q + 1)**2 vertices, face by face.

    The seams are welded by the cube's topology: the first of the coincident points replaces the others. In real
    files they differ a little (up to 0.9 m of a 4 m grid on Itokawa), so that comparing coordinates would not close the
    shape; a gap longer than the median edge shows that the file is not in Gaskell's order and raises an error.
    Each quadrilateral is cut along its shorter diagonal.
    """
    lines = source.lines()
    filled = source.filled(lines)
    word = lines[filled[0]].strip()
    if not (word.isascii() and word.isdigit() and 0 < int(word[:9]) <= 16384 and len(word) < 9):
        raise source.fault(f"an ICQ file starts with its grid size Q, not {word[:40]!r}", filled[0] + 1)
    q = int(word)
    expected = 6 * (q + 1) ** 2
    if len(filled) - 1 != expected:
        raise source.fault(f"Q = {q} needs {expected} vertex lines, found {len(filled) - 1}; is the file cut?")
    points = source.table(lines, filled[1:], (0, 1, 2))
    first, group = weld_seams(q)
    _check_seams(source, q, points, first[group])
    vertices = points[first]
    return source.shape(vertices, _split(vertices, group[cube_quads(q)]))


def _check_seams(source: ShapeFile, q: int, points: FloatArray, partner: IndexArray) -> None:
    quads = cube_quads(q)
    edges = np.linalg.norm(points[quads] - points[np.roll(quads, 1, axis=1)], axis=-1)
    tolerance = float(np.median(edges))
    gap = np.linalg.norm(points - points[partner], axis=1)
    if gap.max() > tolerance:
        worst = int(np.argmax(gap))
        raise source.fault(
            f"vertex {worst + 1} lies {gap[worst]:.6g} from its partner across the seam, more than the grid step"
            f" {tolerance:.6g}: not the layout of an ICQ file"
        )


def _split(vertices: FloatArray, quads: IndexArray) -> IndexArray:
    """Cut quadrilaterals (N, 4) into triangles (2 N, 3) along the shorter diagonal."""
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    along_ac = np.linalg.norm(c - a, axis=1) <= np.linalg.norm(d - b, axis=1)
    # Turned by one corner, the quadrilateral has its other diagonal from the first corner to the third.
    turned = np.where(along_ac[:, None], quads, np.roll(quads, -1, axis=1))
    return np.stack([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
