"""Predict landmarks and their covariances in an image.

Rowell et al. (2015): visibility (section 3.1.1), projection (equations (4) to (6)) and covariance ((7) to (10)).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh

_PARALLEL = 1e-12
_SLACK = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """Means (N, 2), px, and covariances (N, 2, 2), px^2, of landmarks in an image; NaN behind the camera."""

    uv_px: FloatArray
    covariances_px2: FloatArray


def project_landmarks(database: LandmarkDatabase, camera: Camera, T_cam_body: Pose) -> Projection:
    """Project the means and the covariances of all landmarks into the image, equations (4) to (10)."""
    points_cam_m = T_cam_body.transform(database.means_m)  # eq. (4)
    uv_px = camera.project(points_cam_m)  # eqs. (5), (6)
    return Projection(uv_px, image_covariances(database.covariances_m2, points_cam_m, camera, T_cam_body))


def image_covariances(
    covariances_body_m2: FloatArray, points_cam_m: FloatArray, camera: Camera, T_cam_body: Pose
) -> FloatArray:
    """Project covariances (N, 3, 3) in the body frame to (N, 2, 2) in the image, to first order.

    ``Camera.jacobian`` is the transpose of the paper's J, so the transposes are on the other side.
    """
    rotation = T_cam_body.rotation  # eq. (8)
    in_camera = rotation @ covariances_body_m2 @ rotation.T  # eq. (7)
    in_front = np.where(points_cam_m[:, 2:] > 0.0, points_cam_m, np.nan)
    jacobian = camera.jacobian(in_front)  # eq. (10)
    covariances: FloatArray = jacobian @ in_camera @ np.swapaxes(jacobian, 1, 2)  # eq. (9)
    return covariances


def visible_landmarks(mesh: TriangleMesh, camera: Camera, T_cam_body: Pose) -> BoolArray:
    """(V,): vertices in front of the camera, in the field of view, on the near side and not hidden by terrain."""
    uv_px = camera.project(T_cam_body.transform(mesh.vertices_m))
    position = T_cam_body.camera_position_m
    visible = camera.contains(uv_px) & faces_camera(mesh, position)
    candidates = np.flatnonzero(visible)
    visible[candidates] = ~is_occluded(mesh, position, candidates)
    return visible


def faces_camera(mesh: TriangleMesh, camera_position_body_m: FloatArray) -> BoolArray:
    """(V,): vertices with at least one facet whose outward normal points towards the camera (far-side test)."""
    # A vertex is on the far side only if all its facets face away: one that faces the camera is enough.
    result = np.zeros(len(mesh.vertices_m), dtype=bool)
    result[mesh.faces[_facing(mesh, camera_position_body_m)].ravel()] = True
    return result


def is_occluded(mesh: TriangleMesh, camera_position_body_m: FloatArray, vertices: NDArray[np.intp]) -> BoolArray:
    """(len(vertices),): whether a facet lies between the camera and each vertex (intervening-terrain test).

    Facets of which the vertex is a corner are left out. As in the paper, lines of sight are first tested against a
    bounding sphere of each facet; those that enter it are intersected by Moeller and Trumbore's method. ``mesh`` is
    closed, with the camera outside: any occlusion then involves a facet that faces the camera. The camera's position
    (3,) is in the body frame; ``vertices`` are rows of the mesh's vertices.
    """
    hidden = np.zeros(len(vertices), dtype=bool)
    if not len(vertices):
        return hidden
    # A line of sight that enters a closed mesh does so through a facet that faces the camera: half of the tests
    # suffice.
    facets = np.flatnonzero(_facing(mesh, camera_position_body_m))
    rays = mesh.vertices_m[vertices] - camera_position_body_m
    which, ray = _near_pairs(mesh.corners_of(facets), camera_position_body_m, rays)
    facet = facets[which]
    # A facet meets the line of sight to its own corner at that corner, t = 1 but for rounding.
    apart = (mesh.faces[facet] != vertices[ray, None]).all(axis=1)
    facet, ray = facet[apart], ray[apart]
    blocking = _blocks(mesh.corners_of(facet), camera_position_body_m, rays[ray])
    hidden[ray[blocking]] = True
    return hidden


def _facing(mesh: TriangleMesh, camera_position_body_m: FloatArray) -> BoolArray:
    """(F,): facets whose outward normal points towards the camera."""
    to_camera = camera_position_body_m - mesh.vertices_m[mesh.faces[:, 0]]
    facing: BoolArray = np.einsum("fi,fi->f", mesh.area_vectors_m2, to_camera) > 0.0
    return facing


def _near_pairs(corners: FloatArray, origin: FloatArray, rays: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of a facet and a ray whose line enters the facet's bounding sphere, as rows of both."""
    middle = corners.mean(axis=1)
    offset = middle - origin
    distance = np.linalg.norm(offset, axis=1)
    sine = (1.0 + _SLACK) * np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1) / distance
    # Seen from the camera the sphere is a spherical cap; the tree of unit vectors needs its radius as a chord.
    chord = np.where(sine < 1.0, 2.0 * np.sin(0.5 * np.arcsin(np.minimum(sine, 1.0))), 2.0 + _SLACK)
    tree = cKDTree(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    found = tree.query_ball_point(offset / distance[:, None], chord, return_sorted=True)
    counts = np.fromiter(map(len, found), dtype=np.intp, count=len(found))
    near = np.fromiter(chain.from_iterable(found), dtype=np.intp, count=int(counts.sum()))
    return np.repeat(np.arange(len(found)), counts), near


def _blocks(corners: FloatArray, origin: FloatArray, rays: FloatArray) -> BoolArray:
    """(P,): whether each ray intersects its facet between its two ends (Moeller and Trumbore 1997)."""
    edge1, edge2, offset = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], origin - corners[:, 0]
    # Origin + t ray = corner + u edge1 + v edge2, solved by Cramer's rule.
    p, q = np.cross(rays, edge2), np.cross(offset, edge1)
    determinant = np.einsum("pi,pi->p", edge1, p)
    safe = np.where(np.abs(determinant) > _PARALLEL, determinant, np.nan)
    u = np.einsum("pi,pi->p", offset, p) / safe
    v = np.einsum("pi,pi->p", rays, q) / safe
    t = np.einsum("pi,pi->p", edge2, q) / safe
    # The ray ends at the landmark, t = 1: only facets nearer than it hide it.
    blocking: BoolArray = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0)
    return blocking
