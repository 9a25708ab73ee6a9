"""Which way the facets of each tile face: a cone that holds their normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.craters.kernels import Layout, kernel, number_tile, room_for_tile
from scenarios.craters.tiles import Tiling

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def facing_cones(tiling: Tiling, vertices_m: SingleArray) -> FloatArray:
    """(T, 4) of each tile the unit mean of its facets' normals, and the least cosine of one of them with it."""
    cones = np.empty((len(tiling.mesh.faces), 4))
    _cones(cones, vertices_m, tiling.layout)
    return cones


def may_face(cones: FloatArray, directions: FloatArray, slack_rad: FloatArray | float) -> BoolArray:
    """(T,): whether a facet of a tile may face unit directions (T, 3) or (3,), which are known to within a slack."""
    towards = np.einsum("ti,ti->t", cones[:, :3], np.broadcast_to(directions, (len(cones), 3)))
    beyond = np.arccos(np.clip(cones[:, 3], -1.0, 1.0)) + slack_rad
    return np.asarray((beyond >= 0.5 * np.pi) | (towards > -np.sin(beyond)))


@kernel
def _cones(cones: FloatArray, vertices: SingleArray, layout: Layout) -> None:
    ids = room_for_tile(layout)
    normals = np.empty((ids.size, 3))
    for f in range(len(layout.faces)):
        n = number_tile(ids, f, layout)
        count = 0
        mean = cones[f]
        mean[:] = 0.0
        for i in range(n):
            for j in range(n - i):
                for half in range(1 if i + j == n - 1 else 2):
                    a, b, c = ids[i + half, j], ids[i + 1, j + half], ids[i, j + 1]
                    if _normal(normals[count], vertices, a, b, c):
                        for x in range(3):
                            mean[x] += normals[count, x]
                        count += 1
        size = np.sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2])
        least = 1.0 if size > 0.0 else -1.0
        for x in range(3):
            mean[x] = mean[x] / size if size > 0.0 else 0.0
        for k in range(count):
            least = min(least, mean[0] * normals[k, 0] + mean[1] * normals[k, 1] + mean[2] * normals[k, 2])
        mean[3] = least


@kernel
def _normal(out: FloatArray, vertices: SingleArray, a: int, b: int, c: int) -> bool:
    """Write the unit normal of a facet, and say whether it has an area."""
    size = 0.0
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        uy, uz = np.float64(vertices[b, y]) - vertices[a, y], np.float64(vertices[b, z]) - vertices[a, z]
        vy, vz = np.float64(vertices[c, y]) - vertices[a, y], np.float64(vertices[c, z]) - vertices[a, z]
        out[x] = uy * vz - uz * vy
        size += out[x] * out[x]
    if size == 0.0:
        return False
    size = np.sqrt(size)
    for x in range(3):
        out[x] /= size
    return True


@kernel
def facet_normals(found: SingleArray, corners: SingleArray, facets: IndexArray) -> None:
    """Write unit normals (N, 3) of facets (N,) with corners (F, 3, 3); those of no area are left as they are."""
    normal = np.empty(3)
    for k in range(len(facets)):
        if _normal(normal, corners[facets[k]], 0, 1, 2):
            for x in range(3):
                found[k, x] = normal[x]
