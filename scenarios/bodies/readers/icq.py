"""Gaskell's implicitly connected quadrilaterals (ICQ), as text."""

from __future__ import annotations

import numpy as np

from scenarios.bodies.cubegrid import cube_quads, weld_seams
from scenarios.bodies.readers.source import FloatArray, IndexArray, RawShape, ShapeFile


def read_icq(source: ShapeFile) -> RawShape:
    """Read the grid size Q, then 6 (Q + 1)**2 vertices, face by face.

    The seams are welded by the cube's topology: the first of the coincident points stands for all. In real
    files they differ a little (up to 0.9 m of a 4 m grid on Itokawa), so no exact comparison would close the
    shape; a gap longer than the edges around it means that the file is not laid out as Gaskell's and is refused.
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
    turned = np.where(along_ac[:, None], quads, np.roll(quads, -1, axis=1))
    return np.stack([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
