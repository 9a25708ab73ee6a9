"""The cube that Gaskell's implicitly connected quadrilaterals (ICQ) are labelled on.

Six faces of (Q + 1) x (Q + 1) grid points wrap a body like the sides of a cube. Points on the seams belong to
two or three faces; the lattice below says which ones coincide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

IndexArray = NDArray[np.int64]

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
    corner = (face * (q + 1) + j) * (q + 1) + i
    down = q + 1
    return np.stack([corner, corner + down, corner + down + 1, corner + 1], axis=-1).reshape(-1, 4)


def weld_seams(q: int) -> tuple[IndexArray, IndexArray]:
    """Coincident points of the seams: the first point of each of the 6 q**2 + 2 groups, and each point's group."""
    key = cube_lattice(q) @ np.array([(q + 1) ** 2, q + 1, 1])
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[group]
