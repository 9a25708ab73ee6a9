"""Attitude from directions: Wahba's problem, solved by singular values, and robustly with wrong stars among them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.errors import BoresightError

# A residual beyond it has a chance of 3e-4 (chi-square of two degrees of freedom); wrong stars are far beyond.
_MOST_SIGMAS = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """An attitude from stars.

    ``R_cam_inertial`` (3, 3) takes inertial to camera axes, ``covariance`` (3, 3), rad^2, is that of its error
    as a rotation vector in camera axes (perturbed on the left), ``used`` (n,) says which directions it is from, and
    ``chi2`` is the sum of their squared residuals over their variances, with ``2 n - 3`` degrees of freedom.
    """

    R_cam_inertial: FloatArray
    covariance: FloatArray
    used: BoolArray
    chi2: float


def solve_wahba(cam: FloatArray, inertial: FloatArray, sigma_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the rotation R that minimises sum |b - R r|^2 / s^2, and the covariance (3, 3) of its error.

    ``cam`` and ``inertial`` are unit vectors b and r, (n, 3), ``sigma_rad`` (n,) standard deviations s of the
    directions across the line of sight. Markley (1988): with B = sum b r^T / s^2 = U S V^T, R = U diag(1, 1, det U
    det V) V^T. Shuster and Oh (1981): P = (sum (I - b b^T) / s^2)^-1, in camera axes. Raise BoresightError if the
    directions leave a rotation free: fewer than two, or all along one line.
    """
    weights = 1.0 / np.square(sigma_rad)
    left, _, right = np.linalg.svd((weights[:, None] * cam).T @ inertial)
    rotation = (left * [1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)]) @ right
    seen = inertial @ rotation.T
    information = weights.sum() * np.eye(3) - (weights[:, None] * seen).T @ seen
    # Its least eigenvalue is that about the direction that the stars share.
    if len(cam) < 2 or np.linalg.cond(information) > 1e12:
        raise BoresightError("the directions leave a rotation free: they are fewer than two, or along one line")
    covariance = np.linalg.inv(information)
    return rotation, 0.5 * (covariance + covariance.T)


def residual_sigmas(R: FloatArray, cam: FloatArray, inertial: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """(n,) angles between b and R r, over the standard deviation of each; `solve_wahba` has the arguments."""
    # The length of b - R r is the angle for small ones, without the lost digits of an arc cosine.
    return np.asarray(np.linalg.norm(cam - inertial @ R.T, axis=1) / sigma_rad)


def robust_attitude(cam: FloatArray, inertial: FloatArray, sigma_rad: FloatArray) -> Attitude:
    """Solve Wahba's problem and leave out the worst direction until all are within 4 standard deviations.

    Raise BoresightError if fewer than two are left. See `solve_wahba`.
    """
    used = np.ones(len(cam), dtype=bool)
    while True:
        rotation, covariance = solve_wahba(cam[used], inertial[used], sigma_rad[used])
        away = np.where(used, residual_sigmas(rotation, cam, inertial, sigma_rad), 0.0)
        if away.max() <= _MOST_SIGMAS:
            return Attitude(rotation, covariance, used, float(away @ away))
        used[np.argmax(away)] = False
