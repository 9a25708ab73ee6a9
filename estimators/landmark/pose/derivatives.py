"""How landmarks move in the camera with the pose: equations (21) to (23), for one pose or for a stack of poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Camera

FloatArray = NDArray[np.float64]


def point_by_quaternion(quat_wxyz: FloatArray, points_body_m: FloatArray) -> FloatArray:
    """Differentiate R(q) x by the four numbers of a unit quaternion that is not renormalised.

    Parameters
    ----------
    quat_wxyz
        (..., 4) attitudes.
    points_body_m
        (..., N, 3) landmarks.

    Returns
    -------
    (..., N, 3, 4).
    """
    q0, q1, q2, q3 = np.moveaxis(quat_wxyz, -1, 0)
    entries = [  # eq. (23): entry [k, i, j] is half the derivative of R_ij by q_k
        [[q0, -q3, q2], [q3, q0, -q1], [-q2, q1, q0]],
        [[q1, q2, q3], [q2, -q1, -q0], [q3, q0, -q1]],
        [[-q2, q1, q0], [q1, q2, q3], [-q0, q3, -q2]],
        [[-q3, -q0, q1], [q0, -q3, q2], [q1, q2, q3]],
    ]
    by_q = 2.0 * np.ascontiguousarray(np.moveaxis(np.array(entries), (0, 1, 2), (-3, -2, -1)))
    point_by_q: FloatArray = np.einsum("...kij,...nj->...nik", by_q, points_body_m)
    return point_by_q


def point_by_rotation(rotated_m: FloatArray) -> FloatArray:
    """Differentiate exp(w) R x by the small rotation w, (..., N, 3, 3), at R x = ``rotated_m`` (..., N, 3)."""
    x, y, z = np.moveaxis(rotated_m, -1, 0)
    zero = np.zeros_like(x)
    columns = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1)
    return columns.reshape(*x.shape, 3, 3)


def image_jacobian(camera: Camera, points_cam_m: FloatArray, point_by_attitude: FloatArray) -> FloatArray:
    """Differentiate the projections by attitude and translation.

    Parameters
    ----------
    camera
        The camera.
    points_cam_m
        (..., N, 3) landmarks in camera axes.
    point_by_attitude
        (..., N, 3, A) their derivatives by A numbers that describe the attitude.

    Returns
    -------
    (..., N, 2, A + 3).
    """
    by_point = camera.jacobian(points_cam_m)
    return np.concatenate([by_point @ point_by_attitude, by_point], axis=-1)  # eqs. (21), (22)
