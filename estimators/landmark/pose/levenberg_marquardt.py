"""Refine a pose by covariance-weighted Levenberg-Marquardt: equations (15) to (24).

``stack.refine_poses`` runs the same algorithm on many problems at once. It sums in another order, so that the results
agree to rounding and not bit for bit; the estimators of one image keep this version.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from boresight.estimators.landmark.pose.problem import (
    PoseProblem,
    image_jacobian,
    point_by_quaternion,
    point_by_rotation,
)
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose
from boresight.scenarios.spec.base import SpecModel

LAMBDA_MAX = 1e12
LAMBDA_MIN = 1e-9


class MarquardtOptions(SpecModel):
    """Options of the pose refinement."""

    parameters: Literal["quaternion", "quaternion-as-printed", "minimal"] = Field(
        "quaternion",
        description="The paper's quaternion and translation, renormalised without or with (as printed) a change of the"
        " image; or a small rotation and a translation",
    )
    damping: float = Field(1e-3, gt=0, description="First lambda")
    schedule: Literal["adaptive", "fixed"] = Field(
        "adaptive",
        description="Lambda divided by 10 after success and multiplied by 10 after failure, or constant",
    )
    tolerance: float = Field(
        1e-10, gt=0, lt=1, description="Done when chi-square changes by less than this, relatively"
    )
    max_iterations: int = Field(100, ge=1, le=10_000, description="Most iterations")


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """A refined pose, and the number of steps tried.

    ``chi2`` is the weighted sum of squared residuals at it, equation (20), and ``covariance`` (6, 6) that of
    [rotation_rad, translation_m] in camera axes, by the inverse normal matrix; NaN where singular.
    """

    T_cam_body: Pose
    chi2: float
    covariance: FloatArray
    iterations: int


def refine_pose(problem: PoseProblem, start: Pose, options: MarquardtOptions) -> PoseFit:
    """Minimise chi-square from ``start``; with adaptive damping it never increases.

    With fixed damping every step that leaves the landmarks in front of the camera is accepted.
    """
    pose, chi2, damping = start, float(problem.chi2(start)), options.damping
    adaptive = options.schedule == "adaptive"
    iteration = 0
    while iteration < options.max_iterations and np.isfinite(chi2) and damping <= LAMBDA_MAX:
        iteration += 1
        minimal = options.parameters == "minimal"
        jacobian = minimal_jacobian(problem, pose) if minimal else quaternion_jacobian(problem, pose)
        matrix, vector = problem.normal_equations(jacobian, problem.residuals_px(pose))
        # Marquardt's scaling by the diagonal: radians, quaternions and metres are damped alike. With the quaternion the
        # matrix alone is singular, as scaling q by a factor and T by its square leaves the image unchanged; lambda
        # stays positive.
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), vector)  # eq. (24), by LUP
        trial = _updated(pose, np.asarray(step, dtype=np.float64), options.parameters)
        trial_chi2 = float(problem.chi2(trial))
        # Also a step that puts a landmark behind the camera, where chi-square is infinite.
        if adaptive and trial_chi2 > chi2:
            damping *= 10.0
            continue
        if not np.isfinite(trial_chi2):
            break
        done = abs(chi2 - trial_chi2) <= options.tolerance * chi2
        pose, chi2 = trial, trial_chi2
        damping = max(0.1 * damping, LAMBDA_MIN) if adaptive else damping
        if done:
            break
    return PoseFit(pose, chi2, pose_covariance(problem, pose), iteration)


def _updated(pose: Pose, step: FloatArray, parameters: str) -> Pose:
    """Apply x + delta and renormalise the quaternion.

    The R(q) of equation (8) scales the body by |q|**2, so that renormalising alone, as printed, changes the image and
    undoes a part of the step. If the translation is divided by the same factor, the image does not change, and the
    iteration converges quadratically.
    """
    if parameters == "minimal":
        return pose.perturbed(step[:3], step[3:])
    quat_wxyz, translation_m = pose.quat_wxyz + step[:4], pose.translation_m + step[4:]
    if parameters == "quaternion":
        translation_m = translation_m / float(quat_wxyz @ quat_wxyz)
    return Pose.from_quat_wxyz(quat_wxyz, translation_m)


def quaternion_jacobian(problem: PoseProblem, pose: Pose) -> FloatArray:
    """Differentiate the projections by (q0, q1, q2, q3, Tx, Ty, Tz), (N, 2, 7), for a unit quaternion."""
    by_quaternion = point_by_quaternion(pose.quat_wxyz, problem.points_body_m)
    return image_jacobian(problem.camera, pose.transform(problem.points_body_m), by_quaternion)


def minimal_jacobian(problem: PoseProblem, pose: Pose) -> FloatArray:
    """Differentiate the projections by [rotation_rad, translation_m] in camera axes, (N, 2, 6).

    The rotation perturbs the attitude on the left, as ``Pose.perturbed`` does.
    """
    by_rotation = point_by_rotation(pose.rotate(problem.points_body_m))
    return image_jacobian(problem.camera, pose.transform(problem.points_body_m), by_rotation)


def pose_covariance(problem: PoseProblem, pose: Pose) -> FloatArray:
    """Inverse of the normal matrix in the minimal parameters, (6, 6); NaN where it is singular."""
    # Six parameters: with the seven of the quaternion the normal matrix would be singular.
    normal, _ = problem.normal_equations(minimal_jacobian(problem, pose), problem.residuals_px(pose))
    # Scaled to a unit diagonal: square radians and square metres differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1.0 / np.finfo(float).eps:
        return np.full((6, 6), np.nan)
    covariance: FloatArray = np.linalg.inv(scaled) * np.outer(scale, scale)
    symmetric: FloatArray = 0.5 * (covariance + covariance.T)
    return symmetric
