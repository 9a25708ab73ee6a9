"""Landmarks seen by a camera: equations (4) to (10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.landmark.database import LandmarkDatabase
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """Landmarks in camera and image.

    Parameters
    ----------
    points_cam_m
        (N, 3) means in camera axes.
    uv_px
        (N, 2) means in the image; NaN behind the camera.
    covariances_px2
        (N, 2, 2) covariances in the image; NaN behind the camera.
    """

    points_cam_m: FloatArray
    uv_px: FloatArray
    covariances_px2: FloatArray


def project_landmarks(database: LandmarkDatabase, camera: Camera, T_cam_body: Pose) -> Projection:
    """Project the means and the covariances of all landmarks into the image."""
    points_cam_m = T_cam_body.transform(database.means_m)  # eq. (4)
    uv_px = camera.project(points_cam_m)  # eqs. (5), (6)
    return Projection(points_cam_m, uv_px, image_covariances(database.covariances_m2, points_cam_m, camera, T_cam_body))


def image_covariances(
    covariances_body_m2: FloatArray, points_cam_m: FloatArray, camera: Camera, T_cam_body: Pose
) -> FloatArray:
    """Covariances (N, 3, 3) in the body frame to (N, 2, 2) in the image, to first order.

    ``Camera.jacobian`` is the transpose of the J that the paper prints, so the transposes change sides.
    """
    rotation = T_cam_body.rotation  # eq. (8)
    in_camera = rotation @ covariances_body_m2 @ rotation.T  # eq. (7)
    in_front = np.where(points_cam_m[:, 2:] > 0.0, points_cam_m, np.nan)
    jacobian = camera.jacobian(in_front)  # eq. (10)
    covariances: FloatArray = jacobian @ in_camera @ np.swapaxes(jacobian, 1, 2)  # eq. (9)
    return covariances
