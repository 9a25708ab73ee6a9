"""The range that a pose predicts: along the boresight to the landmark mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.landmark.database import LandmarkDatabase
from scenarios.geometry import Pose, TriangleMesh

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MeshRange:
    """Where the boresight meets a mesh.

    Parameters
    ----------
    range_m
        Distance from the camera.
    gradient
        (6,) its derivative by [rotation_rad, translation_m] of the pose, perturbed on the left, camera axes.
    cos_incidence
        Cosine of the angle between the facet's normal and the direction to the camera, above 0.
    """

    range_m: float
    gradient: FloatArray
    cos_incidence: float


def boresight_range(mesh: TriangleMesh, T_cam_body: Pose) -> MeshRange | None:
    """Cast a ray along the boresight; None where it misses the mesh.

    With n the facet's normal and p a point of it in camera axes, the range is r = n.p / n_z. A shift d of the body
    moves it by n.d / n_z, a turn w by n.(w x a) / n_z, a being the point that is hit, seen from the body's origin.
    """
    found = _first_hit(mesh, T_cam_body.camera_position_m, T_cam_body.rotation[2])
    if found is None:
        return None
    range_m, facet = found
    normal_cam = T_cam_body.rotate(mesh.normals[facet])
    arm_m = np.array([0.0, 0.0, range_m]) - T_cam_body.translation_m
    gradient = np.concatenate([np.cross(arm_m, normal_cam), normal_cam]) / normal_cam[2]
    return MeshRange(range_m, gradient, float(-normal_cam[2]))


def _first_hit(mesh: TriangleMesh, origin_m: FloatArray, direction: FloatArray) -> tuple[float, int] | None:
    """Distance and facet of the first hit of a ray on a facet that it enters by (Moeller and Trumbore 1997)."""
    first = mesh.corners_m[:, 0]
    edge1, edge2 = mesh.corners_m[:, 1] - first, mesh.corners_m[:, 2] - first
    entering = mesh.area_vectors_m2 @ direction < 0.0
    p = np.cross(direction, edge2)
    determinant = np.where(entering, np.einsum("fi,fi->f", edge1, p), np.nan)
    offset = origin_m - first
    q = np.cross(offset, edge1)
    u = np.einsum("fi,fi->f", offset, p) / determinant
    v = q @ direction / determinant
    distance = np.einsum("fi,fi->f", edge2, q) / determinant
    hit = np.flatnonzero((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0))
    if not len(hit):
        return None
    nearest = int(hit[np.argmin(distance[hit])])
    return float(distance[nearest]), nearest


def mesh_height_sigma_m(database: LandmarkDatabase) -> float:
    """Estimate how far the landmark mesh is from the surface, RMS along the normal, from the data base alone.

    Two parts add up: the landmarks' own scatter along the normal, and the relief between them. Each landmark tells of
    the second by its height over the mean of its neighbours. Inside a facet the surface departs less from the mesh than
    a landmark does from a mesh without it: by a quarter where the surface is smooth and bends evenly, by all of it
    where it is rough at every scale. Half is taken.
    """
    mesh = database.mesh()
    normals = _vertex_normals(mesh)
    scatter_m2 = np.einsum("ni,nij,nj->n", normals, database.covariances_m2, normals)
    relief_m = np.einsum("ni,ni->n", normals, mesh.vertices_m - _neighbour_means(mesh))
    return float(np.sqrt(scatter_m2.mean() + np.mean((0.5 * relief_m) ** 2)))


def _vertex_normals(mesh: TriangleMesh) -> FloatArray:
    total = np.zeros_like(mesh.vertices_m)
    for corner in mesh.faces.T:
        np.add.at(total, corner, mesh.area_vectors_m2)
    normals: FloatArray = total / np.linalg.norm(total, axis=1, keepdims=True)
    return normals


def _neighbour_means(mesh: TriangleMesh) -> FloatArray:
    """Mean (V, 3) of the vertices that share an edge with each; every edge of a closed mesh lies in two facets."""
    total, count = np.zeros_like(mesh.vertices_m), np.zeros(len(mesh.vertices_m))
    for tail, head in ((0, 1), (1, 2), (2, 0)):
        np.add.at(total, mesh.faces[:, tail], mesh.vertices_m[mesh.faces[:, head]])
        np.add.at(count, mesh.faces[:, tail], 1.0)
    means: FloatArray = total / count[:, None]
    return means
