"""How a body turns in inertial space: not at all, about one axis, or tumbling; and the axes of the first camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from scenarios.errors import BoresightError
from scenarios.spec.motion import BodyMotionSpec

FloatArray = NDArray[np.float64]
Attitude = Callable[[FloatArray], FloatArray]
"""Takes (n,) seconds since the first frame to R_body_inertial, (n, 3, 3)."""

_HOUR_S = 3600.0
_TOLERANCE = 1e-12

R_PAPER_CAMERA: FloatArray = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""``x_C = R_PAPER_CAMERA x_cam``: the paper's R_C, z along the boresight, x along the sensor's vertical and y along its
horizontal. It does not say which way; x down the columns of the image makes y point left."""


def inertial_from_body(points_m: FloatArray, R_body_inertial: FloatArray) -> FloatArray:
    """Turn points (..., 3) of the body frame R_A into ACRF; ``R_body_inertial`` is (..., 3, 3), m."""
    return np.asarray(np.einsum("...ji,...j->...i", R_body_inertial, points_m), dtype=np.float64)


def first_camera_from_inertial(points_m: FloatArray, first_camera_m: FloatArray) -> FloatArray:
    """Shift points (..., 3) of ACRF to R_0, whose origin is the first camera position (3,) in ACRF, m."""
    return np.asarray(points_m - first_camera_m, dtype=np.float64)


def angular_velocity(motion: BodyMotionSpec) -> FloatArray:
    """(3,) rad/s at the first frame, where body and inertial axes agree; zero for a body at rest."""
    if motion.kind == "none":
        return np.zeros(3)
    axis = np.asarray(motion.axis_body, dtype=np.float64)
    return np.asarray(2.0 * np.pi / (motion.period_h * _HOUR_S) * axis / np.linalg.norm(axis))


def attitude_law(motion: BodyMotionSpec, rate_rad_s: FloatArray, until_s: float) -> Attitude:
    """Return the rotation of the body from its angular velocity at the first frame on.

    Parameters
    ----------
    motion
        Kind and inertia.
    rate_rad_s
        (3,) angular velocity at the first frame.
    until_s
        Time that the law is to hold for.
    """
    if motion.kind == "none" or not rate_rad_s.any():
        return lambda times_s: np.tile(np.eye(3), (len(times_s), 1, 1))
    if motion.kind == "spin":
        return lambda times_s: Rotation.from_rotvec(-np.outer(times_s, rate_rad_s)).as_matrix()
    return _tumbling(np.asarray(motion.inertia, dtype=np.float64), rate_rad_s, until_s)


def _tumbling(inertia: FloatArray, rate_rad_s: FloatArray, until_s: float) -> Attitude:
    """Integrate Euler's equations and the attitude in units of the first angle per time."""
    unit = float(np.linalg.norm(rate_rad_s))

    def change(_: float, state: FloatArray) -> FloatArray:
        rate, quat = state[:3], state[3:]
        turned = np.cross(inertia * rate, rate) / inertia  # I w' = (I w) x w
        return np.concatenate([turned, _quat_rate(quat, rate)])

    start = np.concatenate([rate_rad_s / unit, [0.0, 0.0, 0.0, 1.0]])
    end = max(unit * until_s, 1e-9)
    found = solve_ivp(change, (0.0, end), start, "DOP853", dense_output=True, rtol=_TOLERANCE, atol=_TOLERANCE)
    if not found.success or found.sol is None:
        raise BoresightError(f"sequence.body_motion: the rotation cannot be integrated: {found.message}")

    solution = found.sol

    def attitude(times_s: FloatArray) -> FloatArray:
        quat_xyzw = solution(unit * np.asarray(times_s))[3:].T
        return np.swapaxes(Rotation.from_quat(quat_xyzw).as_matrix(), 1, 2)

    return attitude


def _quat_rate(quat_xyzw: FloatArray, rate: FloatArray) -> FloatArray:
    """Differentiate by time: q' = q (w, 0) / 2 for q from body to inertial axes and w in body axes."""
    vector, scalar = quat_xyzw[:3], quat_xyzw[3]
    return 0.5 * np.concatenate([scalar * rate + np.cross(vector, rate), [-vector @ rate]])
