"""Which landmarks can be seen from a viewpoint: section 3.1.1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Camera, Pose, TriangleMesh

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_PARALLEL = 1e-12
_MAX_PAIRS = 2_000_000


def faces_camera(mesh: TriangleMesh, camera_position_body_m: FloatArray) -> BoolArray:
    """(V,): vertices with at least one facet whose outward normal points towards the camera (far-side test)."""
    to_camera = camera_position_body_m - mesh.corners_m[:, 0]
    facing = np.einsum("fi,fi->f", mesh.area_vectors_m2, to_camera) > 0.0
    result = np.zeros(len(mesh.vertices_m), dtype=bool)
    result[mesh.faces[facing].ravel()] = True
    return result


def is_occluded(mesh: TriangleMesh, camera_position_body_m: FloatArray, vertices: NDArray[np.intp]) -> BoolArray:
    """(len(vertices),): whether a facet stands between the camera and each vertex (intervening-terrain test).

    Facets that the vertex is a corner of do not count. All rays are tested against all facets at once by
    Moeller and Trumbore's method; the minimum bounding spheres of the paper have no use then.
    """
    chunk = max(1, _MAX_PAIRS // max(1, len(mesh.faces)))
    parts = [
        _occluded(mesh, camera_position_body_m, vertices[start : start + chunk])
        for start in range(0, len(vertices), chunk)
    ]
    return np.concatenate(parts) if parts else np.empty(0, dtype=bool)


def _occluded(mesh: TriangleMesh, origin: FloatArray, vertices: NDArray[np.intp]) -> BoolArray:
    first, second, third = (mesh.corners_m[:, i] for i in range(3))
    edge1, edge2, offset = second - first, third - first, origin - first
    rays = mesh.vertices_m[vertices] - origin
    # With p = ray x edge2 and q = offset x edge1, every product is a triple product: one (n, 3) @ (3, F) each.
    determinant = -rays @ np.cross(edge1, edge2).T
    safe = np.where(np.abs(determinant) > _PARALLEL, determinant, np.nan)
    u = rays @ np.cross(edge2, offset).T / safe
    q = np.cross(offset, edge1)
    v = rays @ q.T / safe
    t = np.einsum("fi,fi->f", edge2, q) / safe
    connected = (mesh.faces[None, :, :] == vertices[:, None, None]).any(axis=2)
    blocking = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0) & ~connected
    hidden: BoolArray = blocking.any(axis=1)
    return hidden


def visible_landmarks(mesh: TriangleMesh, camera: Camera, T_cam_body: Pose) -> BoolArray:
    """(V,): vertices in front of the camera, in the field of view, on the near side and not hidden by terrain."""
    uv_px = camera.project(T_cam_body.transform(mesh.vertices_m))
    position = T_cam_body.camera_position_m
    visible = camera.contains(uv_px) & faces_camera(mesh, position)
    candidates = np.flatnonzero(visible)
    visible[candidates] = ~is_occluded(mesh, position, candidates)
    return visible
