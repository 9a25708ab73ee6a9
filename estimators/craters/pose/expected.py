"""Which craters of a data base an image should show, and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import Ground
from estimators.craters.database.landmarks import Landmarks
from estimators.craters.matching.association import Association, Expected, centre_noise, given
from estimators.craters.matching.located import hidden
from estimators.craters.pose.options import CraterPoseOptions
from estimators.craters.robust import huber_weights
from scenarios.geometry import Camera, Ellipses, Pose, View, cross_matrix, project_circles
from scenarios.observation import Frame

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_PASSES = 10


def adjusted(expected: Expected, seen: Ellipses, found: Association) -> Association:
    """Adjust the common error anew by Huber's loss: centres of rims have heavier tails than a Gaussian.

    The noise of each couple is divided by its weight until the weights stand still; the prior keeps its weight.
    """
    foretold = expected.ellipses.centre_px + expected.by_error @ expected.mean
    offsets = seen.centre_px[None] - foretold[:, None]
    i, k = found.pairs.T
    error, noise = found.error - expected.mean, expected.noise_px2[i]
    for _ in range(_PASSES):
        left = offsets[i, k] - expected.by_error[i] @ error
        sigmas = np.sqrt(np.einsum("ni,nij,nj->n", left, np.linalg.inv(noise), left))
        weighed = expected.noise_px2.copy()
        weighed[i] = noise / huber_weights(sigmas)[:, None, None]
        error, covariance = given(replace(expected, noise_px2=weighed), offsets, found.pairs)
    return replace(found, error=expected.mean + error, covariance=covariance)


def expected_craters(
    landmarks: Landmarks, ground: Ground, frame: Frame, camera: Camera, pose: Pose, options: CraterPoseOptions
) -> tuple[IndexArray, Expected]:
    """Predict the rims of the landmarks that a pose should show: their rows, and what is expected.

    The common error is that of the frame's prior pose, [rotation_rad, translation_m]; ``pose`` is where it is
    linearised. The caller says of the mean of the error.
    """
    rows = np.flatnonzero(_may_be_seen(landmarks, frame, camera, pose, options))
    position = pose.camera_position_m
    rows = rows[~hidden(landmarks.position_body_m[rows], position, ground, 2.0 * landmarks.radius_m[rows])]
    points, normals = landmarks.position_body_m[rows], landmarks.normal_body[rows]
    view = View(camera, pose, pose.rotation.T @ frame.sun_dir_cam)
    ellipses = project_circles(view, points, normals, landmarks.radius_m[rows])
    turned = points @ pose.rotation.T
    by_point = camera.jacobian(turned + pose.translation_m)
    by_error = by_point @ np.concatenate([-cross_matrix(turned), np.broadcast_to(np.eye(3), (len(rows), 3, 3))], axis=2)
    across = by_point @ pose.rotation
    noise = centre_noise(ellipses, options.association)
    noise = noise + across @ landmarks.covariance_m2[rows] @ np.swapaxes(across, 1, 2)
    return rows, Expected(ellipses, by_error, frame.prior_covariance, noise, np.zeros(6))


def _may_be_seen(
    landmarks: Landmarks, frame: Frame, camera: Camera, pose: Pose, options: CraterPoseOptions
) -> NDArray[np.bool_]:
    """(n,) landmarks that face the camera and the Sun and may be in the frame by the prior's uncertainty."""
    towards = pose.camera_position_m - landmarks.position_body_m
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    sun_dir_body = pose.rotation.T @ frame.sun_dir_cam
    facing = np.einsum("ni,ni->n", towards, landmarks.normal_body) > np.cos(np.radians(options.emission_deg))
    lit = landmarks.normal_body @ sun_dir_body > np.cos(np.radians(options.incidence_deg))
    cam = pose.transform(landmarks.position_body_m)
    spread_m = 3.0 * np.sqrt(np.trace(frame.prior_covariance[3:, 3:]))
    spread_px = spread_m / np.linalg.norm(pose.translation_m) / camera.pixel_angle_rad
    return np.asarray(facing & lit & (cam[:, 2] > 0.0) & camera.contains(camera.project(cam), -spread_px))
