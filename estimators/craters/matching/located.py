"""Craters of an image on the a priori shape: the plane of each rim, and how errors of the pose move it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import CraterImage, Ground
from scenarios.geometry import Pose, cross_matrix

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_RIM_POINTS = 8
_LEAST_ON_BODY = 5


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where the craters of an image lie by its prior pose.

    Parameters
    ----------
    points_body_m
        (n, 3) where the line of sight of a rim's centre meets the plane of the rim; NaN off the body.
    normals_body
        (n, 3) outward unit normals of those planes.
    T_cam_body
        The prior pose that they were located with.
    """

    points_body_m: FloatArray
    normals_body: FloatArray
    T_cam_body: Pose

    @property
    def on_body(self) -> BoolArray:
        """(n,) whether the line of sight met the body."""
        return np.asarray(np.isfinite(self.points_body_m).all(axis=1))

    def __len__(self) -> int:
        return len(self.points_body_m)

    def by_pose(self) -> FloatArray:
        """Differentiate each point by the error of the pose, (n, 3, 6) m in body axes.

        The error is that of `Pose.perturbed`, [rotation_rad, translation_m]; the line of sight in the camera and the
        plane on the body stand still. With x = R p + t, the unit line of sight d and the normal m in camera axes,
        R dp = d (m . e) / (m . d) - e where e = w x R p + dt.
        """
        pose = self.T_cam_body
        turned = self.points_body_m @ pose.rotation.T
        seen = turned + pose.translation_m
        sight = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        normal = self.normals_body @ pose.rotation.T
        slant = np.einsum("ni,ni->n", normal, sight)
        error = np.concatenate([-cross_matrix(turned), np.broadcast_to(np.eye(3), (len(self), 3, 3))], axis=2)
        along = np.einsum("ni,nij->nj", normal, error) / slant[:, None]
        moved = sight[:, :, None] * along[:, None, :] - error
        return np.asarray(np.einsum("ji,njk->nik", pose.rotation, moved), dtype=np.float64)

    def by_height(self) -> FloatArray:
        """Differentiate each point by the height of the shape above where it is thought, (n, 3): along the sight."""
        sight = self.points_body_m - self.T_cam_body.camera_position_m
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        return np.asarray(sight / np.einsum("ni,ni->n", self.normals_body, sight)[:, None], dtype=np.float64)


def locate(image: CraterImage, ground: Ground) -> Located:
    """Locate the craters of an image on the a priori shape by its prior pose.

    The plane of a rim is that of least squares through the points of the shape under the rim, so that the facets of a
    plate model do not decide the local normal; under a rim that reaches over the limb it is that of its centre.
    """
    ellipses, pose = image.detections.ellipses, image.frame.prior_T_cam_body
    centre_dir = pose.inverse().rotate(image.camera.unproject(ellipses.centre_px))
    points, normals = _met(ground, pose, centre_dir)
    rim, _ = _met(ground, pose, pose.inverse().rotate(image.camera.unproject(ellipses.points(_RIM_POINTS)[0])))
    middles, fitted = _planes(rim, normals)
    known = np.isfinite(middles).all(axis=1)
    slant = np.einsum("ni,ni->n", fitted, centre_dir)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.einsum("ni,ni->n", fitted, middles - pose.camera_position_m) / slant
    known &= slant < -1e-3
    moved = pose.camera_position_m + depth[:, None] * centre_dir
    return Located(np.where(known[:, None], moved, points), np.where(known[:, None], fitted, normals), pose)


def hidden(points_body_m: FloatArray, seen_from_body_m: FloatArray, ground: Ground, slack_m: FloatArray) -> BoolArray:
    """(n,) whether the shape stands more than ``slack_m``, (n,), before the points as seen from a place."""
    rays = points_body_m - seen_from_body_m
    ranges = np.linalg.norm(rays, axis=1)
    met, _ = ground.intersect(np.broadcast_to(seen_from_body_m, rays.shape), rays / ranges[:, None])
    nearer = ranges - np.linalg.norm(met - seen_from_body_m, axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(nearer > slack_m)


def _met(ground: Ground, pose: Pose, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Meet the shape with lines of sight (..., 3): points and normals of the same shape."""
    flat = directions.reshape(-1, 3)
    points, normals = ground.intersect(np.broadcast_to(pose.camera_position_m, flat.shape), flat)
    return points.reshape(directions.shape), normals.reshape(directions.shape)


def _planes(rims: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit planes to the points of rims that are on the body: middles and normals, (n, 3), on the side of ``normals``.

    NaN where too little of a rim, (n, k, 3), is on the body. Rims that lie on it whole are fitted all at once.
    """
    on_body = np.asarray(np.isfinite(rims).all(axis=2), dtype=np.bool_)
    fitted = (on_body.sum(axis=1) >= _LEAST_ON_BODY) & np.isfinite(normals).all(axis=1)
    middles, across = np.full(normals.shape, np.nan), normals.copy()
    whole = fitted & on_body.all(axis=1)
    if whole.any():
        middles[whole], across[whole] = _plane(rims[whole])
    for row in np.flatnonzero(fitted & ~whole):
        middles[row], across[row] = _plane(rims[row, on_body[row]])
    inwards = np.einsum("ni,ni->n", across, normals) <= 0.0
    return middles, np.where(inwards[:, None] & fitted[:, None], -across, across)


def _plane(rims: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit planes of least squares to points (..., k, 3): their middles and normals of either sign."""
    middle = rims.mean(axis=-2)
    return middle, np.linalg.svd(rims - middle[..., None, :])[2][..., 2, :]
