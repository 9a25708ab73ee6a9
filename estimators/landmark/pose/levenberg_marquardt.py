"""Covariance-weighted Levenberg-Marquardt for the pose: equations (15) to (24)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from estimators.landmark.pose.problem import PoseProblem
from scenarios.geometry import Pose
from scenarios.spec.base import SpecModel

FloatArray = NDArray[np.float64]

_LAMBDA_MAX = 1e12
_LAMBDA_MIN = 1e-9


class MarquardtOptions(SpecModel):
    """Parameters and end of the iteration."""

    parameters: Literal["quaternion", "minimal"] = Field(
        "quaternion", description="The paper's seven numbers, or a small rotation and a translation"
    )
    damping: float = Field(1e-3, gt=0, description="First lambda; a tenth of it after success, ten times after failure")
    tolerance: float = Field(1e-10, gt=0, lt=1, description="Done when chi-square falls by less than this, relatively")
    max_iterations: int = Field(100, ge=1, le=10_000)


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """A refined pose.

    Parameters
    ----------
    T_cam_body
        The pose.
    chi2
        Weighted sum of squared residuals at it, equation (20).
    covariance
        (6, 6) of [rotation_rad, translation_m] in camera axes, by the inverse normal matrix; NaN where singular.
    iterations
        Steps tried.
    """

    T_cam_body: Pose
    chi2: float
    covariance: FloatArray
    iterations: int


def refine_pose(problem: PoseProblem, start: Pose, options: MarquardtOptions) -> PoseFit:
    """Minimise chi-square from ``start``; the result is never worse than it."""
    pose, chi2, damping = start, problem.chi2(start), options.damping
    iteration = 0
    while iteration < options.max_iterations and np.isfinite(chi2) and damping <= _LAMBDA_MAX:
        iteration += 1
        trial = _updated(pose, _damped_step(problem, pose, damping, options.parameters), options.parameters)
        trial_chi2 = problem.chi2(trial)
        if trial_chi2 > chi2:
            damping *= 10.0
            continue
        done = chi2 - trial_chi2 <= options.tolerance * chi2
        pose, chi2, damping = trial, trial_chi2, max(0.1 * damping, _LAMBDA_MIN)
        if done:
            break
    return PoseFit(pose, chi2, pose_covariance(problem, pose), iteration)


def _damped_step(problem: PoseProblem, pose: Pose, damping: float, parameters: str) -> FloatArray:
    jacobian = quaternion_jacobian(problem, pose) if parameters == "quaternion" else minimal_jacobian(problem, pose)
    matrix, vector = problem.normal_equations(jacobian, problem.residuals_px(pose))
    damped: FloatArray = matrix + damping * np.diag(np.diag(matrix))
    return np.asarray(np.linalg.solve(damped, vector), dtype=np.float64)  # eq. (24), by LUP


def _updated(pose: Pose, step: FloatArray, parameters: str) -> Pose:
    """Apply x + delta and renormalise the quaternion.

    The R(q) of equation (8) scales the body by |q|**2. The translation is divided by the same, which the paper does
    not say: renormalising then moves no pixel, and the iteration converges quadratically.
    """
    if parameters == "minimal":
        return pose.perturbed(step[:3], step[3:])
    quat_wxyz = pose.quat_wxyz + step[:4]
    translation_m = (pose.translation_m + step[4:]) / float(quat_wxyz @ quat_wxyz)
    return Pose.from_quat_wxyz(quat_wxyz, translation_m)


def quaternion_jacobian(problem: PoseProblem, pose: Pose) -> FloatArray:
    """Differentiate the projections by (q0, q1, q2, q3, Tx, Ty, Tz), (N, 2, 7), for a unit quaternion."""
    q0, q1, q2, q3 = pose.quat_wxyz
    by_q = 2.0 * np.array(  # eq. (23): entry [k, i, j] is half the derivative of R_ij by q_k
        [
            [[q0, -q3, q2], [q3, q0, -q1], [-q2, q1, q0]],
            [[q1, q2, q3], [q2, -q1, -q0], [q3, q0, -q1]],
            [[-q2, q1, q0], [q1, q2, q3], [-q0, q3, -q2]],
            [[-q3, -q0, q1], [q0, -q3, q2], [q1, q2, q3]],
        ]
    )
    point_by_q = np.einsum("kij,nj->nik", by_q, problem.points_body_m)
    return _image_jacobian(problem, pose, point_by_q)


def minimal_jacobian(problem: PoseProblem, pose: Pose) -> FloatArray:
    """Differentiate the projections by [rotation_rad, translation_m] in camera axes, (N, 2, 6).

    The rotation perturbs the attitude on the left, as ``Pose.perturbed`` does.
    """
    x, y, z = np.moveaxis(pose.rotate(problem.points_body_m), 1, 0)
    zero = np.zeros_like(x)
    point_by_rotation = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    return _image_jacobian(problem, pose, point_by_rotation)


def _image_jacobian(problem: PoseProblem, pose: Pose, point_by_attitude: FloatArray) -> FloatArray:
    by_point = problem.camera.jacobian(pose.transform(problem.points_body_m))
    return np.concatenate([by_point @ point_by_attitude, by_point], axis=2)  # eqs. (21), (22)


def pose_covariance(problem: PoseProblem, pose: Pose) -> FloatArray:
    """Inverse of the normal matrix in the minimal parameters, (6, 6); NaN where it is singular."""
    normal, _ = problem.normal_equations(minimal_jacobian(problem, pose), problem.residuals_px(pose))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1.0 / np.finfo(float).eps:
        return np.full((6, 6), np.nan)
    covariance: FloatArray = np.linalg.inv(scaled) * np.outer(scale, scale)
    symmetric: FloatArray = 0.5 * (covariance + covariance.T)
    return symmetric
