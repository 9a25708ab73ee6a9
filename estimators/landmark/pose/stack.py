"""Solve many pose problems of one size at once: stacks of poses and problems, EPnP and Levenberg-Marquardt.

Monte Carlo studies of the solver need a hundred thousand fits; one by one, calls would take most of the time. The
result of a problem does not depend on the other problems in the stack.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from boresight.estimators.landmark.database import DatabaseOptions
from boresight.estimators.landmark.pose.problem import (
    LAMBDA_MAX,
    LAMBDA_MIN,
    MarquardtOptions,
    PoseProblem,
    image_jacobian,
    point_by_quaternion,
    point_by_rotation,
    solve_epnp,
)
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose
from boresight.scenarios.spec.base import SpecModel

NAME = "pose-solver"
VERSION = 1


@dataclass(frozen=True, slots=True, eq=False)
class PoseStack:
    """A stack of B poses T_cam_body: rotations (B, 3, 3) and translations (B, 3), m."""

    rotations: FloatArray
    translations_m: FloatArray

    @classmethod
    def of(cls, poses: list[Pose]) -> PoseStack:
        """Stack poses."""
        return cls(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation_m for pose in poses]))

    def __len__(self) -> int:
        return len(self.rotations)

    def rows(self, chosen: NDArray[np.generic]) -> PoseStack:
        """Choose some of the poses."""
        return PoseStack(self.rotations[chosen], self.translations_m[chosen])

    def pose(self, row: int) -> Pose:
        """Return one of the poses."""
        return Pose(self.rotations[row], self.translations_m[row])

    def perturbed(self, steps: FloatArray) -> PoseStack:
        """Perturb each pose on the left by its row of ``steps`` (B, 6), [rotation_rad, translation_m], camera axes."""
        turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        return PoseStack(turns @ self.rotations, self.translations_m + steps[:, 3:])

    def rotate(self, points_body_m: FloatArray) -> FloatArray:
        """Rotate points (B, N, 3) into camera axes, without the translation."""
        rotated: FloatArray = np.einsum("bij,bnj->bni", self.rotations, points_body_m)
        return rotated

    def transform(self, points_body_m: FloatArray) -> FloatArray:
        """Transform points (B, N, 3) to the camera frame, each row by its own pose."""
        return self.rotate(points_body_m) + self.translations_m[:, None, :]

    @property
    def camera_positions_m(self) -> FloatArray:
        """Positions of the cameras in the body frame, (B, 3)."""
        positions: FloatArray = -np.einsum("bji,bj->bi", self.rotations, self.translations_m)
        return positions


class ProblemStack(PoseProblem):
    """A stack of B pose problems of N landmarks each."""

    __slots__ = ()

    def __len__(self) -> int:
        return len(self.points_body_m)

    def rows(self, chosen: NDArray[np.generic]) -> ProblemStack:
        """Choose some of the problems."""
        return ProblemStack(self.points_body_m[chosen], self.uv_px[chosen], self.information_px2[chosen], self.camera)

    def problem(self, row: int) -> PoseProblem:
        """Return one of the problems."""
        return PoseProblem(self.points_body_m[row], self.uv_px[row], self.information_px2[row], self.camera)


@dataclass(frozen=True, slots=True, eq=False)
class FitStack:
    """B refined poses, weighted sums of squared residuals (B,), equation (20), and numbers (B,) of steps tried."""

    poses: PoseStack
    chi2: FloatArray
    iterations: NDArray[np.int64]


class PoseSolverOptions(SpecModel):
    """Options of a pose solver, and of the data base of the landmarks it is tested on."""

    database: DatabaseOptions = DatabaseOptions()
    method: Literal["both", "closed-form", "non-linear"] = Field(
        "both", description="EPnP and then Levenberg-Marquardt, or one of them alone"
    )
    marquardt: MarquardtOptions = MarquardtOptions()


def closed_forms(problems: ProblemStack) -> list[Pose | None]:
    """Solve each problem by EPnP; None where it finds no pose in front of the camera."""
    return [solve_epnp(problems.problem(row)) for row in range(len(problems))]


def solve_stack(
    problems: ProblemStack, priors: PoseStack, closed: list[Pose | None], options: PoseSolverOptions
) -> FitStack:
    """Solve each problem; if EPnP finds no pose, the refinement begins at the prior, as in ``solve_matches``.

    ``closed`` are the solutions by EPnP, see `closed_forms`. Chi-square is infinite where there is no solution.
    """
    starts = priors
    if options.method != "non-linear":
        starts = PoseStack(priors.rotations.copy(), priors.translations_m.copy())
        for row, pose in enumerate(closed):
            if pose is not None:
                starts.rotations[row], starts.translations_m[row] = pose.rotation, pose.translation_m
    if options.method != "closed-form":
        return refine_poses(problems, starts, options.marquardt)
    found = np.array([pose is not None for pose in closed])
    return FitStack(starts, np.where(found, problems.chi2(starts), np.inf), np.zeros(len(found), dtype=np.int64))


def refine_poses(problems: ProblemStack, starts: PoseStack, options: MarquardtOptions) -> FitStack:
    """Minimise chi-square of each problem from its own start, by the algorithm of ``refine_pose``.

    ``active`` are the problems still iterated: not converged, and their damping not above its limit.
    """
    poses = PoseStack(starts.rotations.copy(), starts.translations_m.copy())
    chi2, damping = problems.chi2(starts), np.full(len(starts), options.damping)
    iterations = np.zeros(len(starts), dtype=np.int64)
    active = np.flatnonzero(np.isfinite(chi2))
    for _ in range(options.max_iterations):
        if not active.size:
            break
        iterations[active] += 1
        # Only the rows that still iterate: each has its own damping, and converges as it would alone.
        trial = _trial(problems.rows(active), poses.rows(active), damping[active], options.parameters)
        trial_chi2 = problems.rows(active).chi2(trial)
        before = chi2[active]
        # A step behind the camera has an infinite chi-square, so adaptive damping rejects it.
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
    """Return the poses after one damped step from each pose."""
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
    # As in ``problem._updated``: renormalising then leaves the image as it is.
    if parameters == "quaternion":
        translations_m = translations_m / np.einsum("bi,bi->b", quats_wxyz, quats_wxyz)[:, None]
    return PoseStack(Rotation.from_quat(quats_wxyz, scalar_first=True).as_matrix(), translations_m)


def _step(problems: ProblemStack, poses: PoseStack, jacobians: FloatArray, damping: FloatArray) -> FloatArray:
    """Solve equation (24) for each problem, (B, P); no step where its matrix is singular."""
    matrices, vectors = problems.normal_equations(jacobians, problems.residuals_px(poses))
    diagonal = np.arange(matrices.shape[1])
    # J^T S^-1 J + lambda diag(J^T S^-1 J).
    matrices[:, diagonal, diagonal] *= 1.0 + damping[:, None]
    try:
        return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)  # eq. (24), by LUP
    # NumPy raises for the whole stack if one matrix is singular: then one by one.
    except np.linalg.LinAlgError:
        steps = np.zeros_like(vectors)
        for row, (matrix, vector) in enumerate(zip(matrices, vectors, strict=True)):
            with contextlib.suppress(np.linalg.LinAlgError):
                steps[row] = np.linalg.solve(matrix, vector)
        return steps
