"""Anchored landmarks of section 3.3: a pixel, an inverse distance and the camera position where it was first seen.

Equation (8): ``l = [u, v, rho, T0]``. The 10 elements of equation (9), ``[u, v, rho, T]``, hold the attitude of the
anchor as well, a quaternion of which three angles can be wrong. Where attitudes are known it is a constant, and 6
elements serve.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Camera, cross_matrix

FloatArray = NDArray[np.float64]

SIZE = 6


def landmark_points(camera: Camera, landmarks: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(n, 3) points in the body frame of landmarks (n, 6) with the attitudes (n, 3, 3) of their anchors, m."""
    rays = np.einsum("kji,kj->ki", R_cam_body, camera.unproject(landmarks[:, :2]))
    return np.asarray(landmarks[:, 3:] + rays / landmarks[:, 2:3], dtype=np.float64)


def landmark_jacobians(camera: Camera, landmarks: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(n, 3, 6) of `landmark_points` by the landmark's elements."""
    rays = camera.unproject(landmarks[:, :2])
    inverse = landmarks[:, 2][:, None, None]
    slopes = np.zeros((len(landmarks), 3, 2))
    slopes[:, 0, 0] = rays[:, 2] / camera.fx_px
    slopes[:, 1, 1] = rays[:, 2] / camera.fy_px
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    by_pixel = across @ slopes / inverse
    by_inverse = -rays[:, :, None] / inverse**2
    turned = np.swapaxes(R_cam_body, 1, 2) @ np.concatenate([by_pixel, by_inverse], axis=2)
    ones = np.broadcast_to(np.eye(3), (len(landmarks), 3, 3))
    return np.concatenate([turned, ones], axis=2)


def turn_jacobians(camera: Camera, landmarks: FloatArray, R_cam_body: FloatArray) -> FloatArray:
    """(n, 3, 3) of `landmark_points` by a small turn of the anchor's attitude, R_cam_body = exp(turn) R."""
    rays = camera.unproject(landmarks[:, :2])
    across = np.swapaxes(R_cam_body, 1, 2) @ cross_matrix(rays)
    return np.asarray(across / landmarks[:, 2][:, None, None], dtype=np.float64)
