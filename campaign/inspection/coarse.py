"""A mesh made coarse, so that it can be looked at in a page."""

from __future__ import annotations

import numpy as np

from scenarios.geometry import TriangleMesh

_FINER = 1.25


def coarsened(mesh: TriangleMesh, most_faces: int) -> TriangleMesh:
    """Merge the vertices of each cube of a grid into their mean until no more than ``most_faces`` facets are left.

    Facets whose corners come together vanish. That is rough, and good enough for the eye; nothing is measured on it.
    """
    if len(mesh.faces) <= most_faces:
        return mesh
    # A closed surface of area A in cubes of edge a crosses about A / a^2 of them, with two facets for each vertex.
    area_m2 = float(np.linalg.norm(mesh.area_vectors_m2, axis=1).sum())
    edge_m = float(np.sqrt(2.0 * area_m2 / most_faces))
    while True:
        coarse = _merged(mesh, edge_m)
        if len(coarse.faces) <= most_faces:
            return coarse
        edge_m *= _FINER


def _merged(mesh: TriangleMesh, edge_m: float) -> TriangleMesh:
    cubes = np.floor(mesh.vertices_m / edge_m).astype(np.int64)
    _, which, counts = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    sums = np.stack([np.bincount(which, mesh.vertices_m[:, axis]) for axis in range(3)], axis=1)
    faces = which[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return TriangleMesh(sums / counts[:, None], faces[np.sort(first)].astype(np.int32))
