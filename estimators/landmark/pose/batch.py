"""Levenberg-Marquardt on many pose problems at once: ``levenberg_marquardt`` over a stack, step by step the same.

A Monte Carlo study of the solver itself needs a hundred thousand fits; one by one, most of the time would go into
calling. What comes out for a problem depends on that problem alone, whatever else is in the stack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimators.landmark.pose.derivatives import image_jacobian, point_by_quaternion, point_by_rotation
from estimators.landmark.pose.levenberg_marquardt import LAMBDA_MAX, LAMBDA_MIN, MarquardtOptions
from estimators.landmark.pose.stack import PoseStack, ProblemStack

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FitStack:
    """B refined poses.

    Parameters
    ----------
    poses
        The poses.
    chi2
        (B,) weighted sums of squared residuals at them, equation (20).
    iterations
        (B,) steps tried.
    """

    poses: PoseStack
    chi2: FloatArray
    iterations: NDArray[np.int64]


def refine_poses(problems: ProblemStack, starts: PoseStack, options: MarquardtOptions) -> FitStack:
    """Minimise chi-square of each problem from its own start, as ``refine_pose`` does for one."""
    poses = PoseStack(starts.rotations.copy(), starts.translations_m.copy())
    chi2, damping = problems.chi2(starts), np.full(len(starts), options.damping)
    iterations = np.zeros(len(starts), dtype=np.int64)
    active = np.flatnonzero(np.isfinite(chi2))
    for _ in range(options.max_iterations):
        if not active.size:
            break
        iterations[active] += 1
        trial = _trial(problems.rows(active), poses.rows(active), damping[active], options.parameters)
        trial_chi2 = problems.rows(active).chi2(trial)
        before = chi2[active]
        if options.schedule == "adaptive":
            taken = trial_chi2 <= before
            damping[active] *= np.where(taken, 0.1, 10.0)
            damping = np.maximum(damping, LAMBDA_MIN)
            over = damping[active] > LAMBDA_MAX
        else:
            taken = np.isfinite(trial_chi2)
            over = ~taken
        done = taken & (np.abs(before - trial_chi2) <= options.tolerance * before)
        rows = active[taken]
        poses.rotations[rows], poses.translations_m[rows] = trial.rotations[taken], trial.translations_m[taken]
        chi2[rows] = trial_chi2[taken]
        active = active[~(done | over)]
    return FitStack(poses, chi2, iterations)


def _trial(problems: ProblemStack, poses: PoseStack, damping: FloatArray, parameters: str) -> PoseStack:
    """Take one damped step from each pose."""
    rotated = poses.rotate(problems.points_body_m)
    points_cam_m = rotated + poses.translations_m[:, None, :]
    if parameters == "minimal":
        step = _step(
            problems, poses, image_jacobian(problems.camera, points_cam_m, point_by_rotation(rotated)), damping
        )
        turn = Rotation.from_rotvec(step[:, :3]).as_matrix()
        return PoseStack(np.einsum("bij,bjk->bik", turn, poses.rotations), poses.translations_m + step[:, 3:])
    quats_wxyz = Rotation.from_matrix(poses.rotations).as_quat(canonical=True, scalar_first=True)
    by_quaternion = point_by_quaternion(quats_wxyz, problems.points_body_m)
    step = _step(problems, poses, image_jacobian(problems.camera, points_cam_m, by_quaternion), damping)
    quats_wxyz, translations_m = quats_wxyz + step[:, :4], poses.translations_m + step[:, 4:]
    if parameters == "quaternion":
        translations_m = translations_m / np.einsum("bi,bi->b", quats_wxyz, quats_wxyz)[:, None]
    return PoseStack(Rotation.from_quat(quats_wxyz, scalar_first=True).as_matrix(), translations_m)


def _step(problems: ProblemStack, poses: PoseStack, jacobians: FloatArray, damping: FloatArray) -> FloatArray:
    """Solve equation (24) for each problem, (B, P); no step where its matrix is singular."""
    matrices, vectors = problems.normal_equations(jacobians, poses)
    diagonal = np.arange(matrices.shape[1])
    matrices[:, diagonal, diagonal] *= 1.0 + damping[:, None]
    try:
        return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)  # eq. (24), by LUP
    except np.linalg.LinAlgError:
        return np.stack([_solution(matrix, vector) for matrix, vector in zip(matrices, vectors, strict=True)])


def _solution(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Solve one of them; one singular matrix must not take its whole stack with it."""
    try:
        return np.asarray(np.linalg.solve(matrix, vector), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.zeros(len(vector))
