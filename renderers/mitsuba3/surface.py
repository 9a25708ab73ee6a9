"""Geometry of hits on a mesh in double precision, independent of the ray tracer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import BoresightError
from scenarios.geometry import TriangleMesh

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_CHUNK = 200_000


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Outward unit normals (V, 3): the mean of the adjoining facets' normals, weighted by their areas."""
    total = np.zeros_like(mesh.vertices_m)
    for corner in mesh.faces.T:
        for axis in range(3):
            total[:, axis] += np.bincount(corner, mesh.area_vectors_m2[:, axis], len(total))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit: FloatArray = np.divide(total, length, out=np.zeros_like(total), where=length > 0.0)
    return unit


def interpolate(mesh: TriangleMesh, values: FloatArray, facets: IndexArray, weights: FloatArray) -> FloatArray:
    """Values (V, ...) of the vertices, interpolated to (N, ...) points of ``facets`` with corner weights (N, 3)."""
    corners = values[mesh.faces[facets]]
    result: FloatArray = np.einsum("nk,nk...->n...", weights, corners)
    return result


def corner_weights(mesh: TriangleMesh, facets: IndexArray, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
    """Barycentric weights (N, 3) of the points where rays meet given facets, clipped to the facets.

    The ray tracer names the facet in single precision; the point is worked out here in double precision
    (Moeller and Trumbore 1997). Clipping keeps a grazing hit on its facet.
    """
    corner_m = mesh.vertices_m[mesh.faces[facets]]
    edge_1, edge_2 = corner_m[:, 1] - corner_m[:, 0], corner_m[:, 2] - corner_m[:, 0]
    p = np.cross(directions, edge_2)
    s = origins_m - corner_m[:, 0]
    q = np.cross(s, edge_1)
    determinant = np.einsum("ni,ni->n", edge_1, p)
    determinant = np.where(determinant == 0.0, np.finfo(float).tiny, determinant)
    with np.errstate(over="ignore"):
        w1 = np.clip(np.einsum("ni,ni->n", s, p) / determinant, 0.0, 1.0)
        w2 = np.clip(np.einsum("ni,ni->n", directions, q) / determinant, 0.0, 1.0 - w1)
    return np.stack([1.0 - w1 - w2, w1, w2], axis=1)


def check_outside(mesh: TriangleMesh, position_body_m: FloatArray) -> None:
    """Refuse a camera inside the body.

    The solid angle of the closed mesh seen from a point is 4 pi inside it and 0 outside (A. van Oosterom and
    J. Strackee, IEEE Trans. Biomed. Eng. 30, 1983, equation 8). Beyond the farthest vertex nothing is summed.

    Raises
    ------
    BoresightError
        If ``position_body_m`` (3,) lies inside.
    """
    position = np.asarray(position_body_m, dtype=np.float64)
    distance_m = float(np.linalg.norm(position))
    if distance_m > mesh.radius_m:
        return
    solid_angle = sum(_solid_angle(mesh, slice(k, k + _CHUNK), position) for k in range(0, len(mesh.faces), _CHUNK))
    if abs(solid_angle) > 2.0 * np.pi:
        where = ", ".join(f"{x:.6g}" for x in position)
        raise BoresightError(
            f"the camera at ({where}) m, {distance_m:.6g} m from the body's origin, is inside the body, whose farthest"
            f" point is at {mesh.radius_m:.6g} m: choose a larger range"
        )


def _solid_angle(mesh: TriangleMesh, faces: slice, position: FloatArray) -> float:
    """Signed solid angle, sr, of some faces seen from a point."""
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces[faces]] - position, 1, 0)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    volume = np.einsum("ni,ni->n", a, np.cross(b, c))
    dots = [np.einsum("ni,ni->n", x, y) for x, y in ((a, b), (a, c), (b, c))]
    return float(2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * lb + dots[2] * la).sum())
