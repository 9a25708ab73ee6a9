"""Reader of Gaskell's implicitly connected quadrilaterals (ICQ), and the cube grid that they are numbered on.

Six faces of (Q + 1) x (Q + 1) grid points cover a body like the sides of a cube. Points on the seams belong to two
or three faces; integer lattice positions identify the coincident ones.
"""

from __future__ import annotations

import numpy as np

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.bodies.readers.source import RawShape, ShapeFile

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
