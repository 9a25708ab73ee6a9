"""The least-squares problem of the pose from matched landmarks: Jacobians, EPnP, Levenberg-Marquardt refinement.

Equations (15) to (24) of Rowell et al. (2015); the covariances that weight it are predicted by `landmark.projection`.
``stack.refine_poses`` runs the same algorithm on many problems at once. It sums in another order, so that the results
agree to rounding and not bit for bit; the estimators of one image keep this version.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import cv2
import numpy as np
from pydantic import Field

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, pixel_to_opencv
from boresight.scenarios.spec.base import SpecModel

MIN_LANDMARKS = 4

LAMBDA_MAX = 1e12
LAMBDA_MIN = 1e-9


class Transform(Protocol):
    """One pose, or one for each problem of a stack."""

    def transform(self, points_m: FloatArray, /) -> FloatArray:
        """Take points (..., N, 3) to the camera frame."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PoseProblem:
    """Landmarks in the body frame with their observed positions in the image, of one problem or of a stack of them.

    ``points_body_m`` (..., N, 3) are positions in the body frame, ``uv_px`` (..., N, 2) the observed positions, the
    data vector D of equation (16), and ``information_px2`` (..., N, 2, 2) inverse covariances of the projections, the
    blocks of the inverse of equation (18). Raises BoresightError if there are fewer than four landmarks or the shapes
    disagree.
    """

    points_body_m: FloatArray
    uv_px: FloatArray
    information_px2: FloatArray
    camera: Camera

    def __post_init__(self) -> None:
        size = self.points_body_m.shape[:-1]
        shapes = (self.points_body_m.shape, self.uv_px.shape, self.information_px2.shape)
        if shapes != ((*size, 3), (*size, 2), (*size, 2, 2)) or size[-1] < MIN_LANDMARKS:
            raise BoresightError(f"a pose needs {MIN_LANDMARKS} or more landmarks of agreeing shapes, not {shapes}")

    def residuals_px(self, T_cam_body: Transform) -> FloatArray:
        """D - M, (..., N, 2); NaN where a landmark is behind the camera."""
        return self.uv_px - self.camera.project(T_cam_body.transform(self.points_body_m))

    def chi2(self, T_cam_body: Transform) -> FloatArray:
        """Total weighted reprojection errors (...); infinite where a landmark is behind the camera."""
        residuals = self.residuals_px(T_cam_body)
        values = np.einsum("...ni,...nij,...nj->...", residuals, self.information_px2, residuals)  # eq. (20)
        finite: FloatArray = np.where(np.isfinite(values), values, np.inf)
        return finite

    def normal_equations(self, jacobian: FloatArray, residuals_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """J^T S^-1 J and J^T S^-1 (D - M) of equation (24), for Jacobians of shape (..., N, 2, P)."""
        # S is block diagonal (18): each landmark is weighted with its own 2 x 2 block.
        weighted = self.information_px2 @ jacobian
        matrix: FloatArray = np.einsum("...nip,...niq->...pq", jacobian, weighted)
        vector: FloatArray = np.einsum("...nip,...ni->...p", weighted, residuals_px)
        return matrix, vector


def solve_epnp(problem: PoseProblem) -> Pose | None:
    """Solve for the pose in closed form by OpenCV's EPnP (Lepetit, Moreno-Noguer and Fua 2009).

    Return T_cam_body, or None where there is no solution with all landmarks in front of the camera.
    """
    camera = problem.camera
    matrix = camera.matrix
    # OpenCV counts the first pixel's centre as 0, this project as 0.5: for the principal point as for the corners.
    matrix[:2, 2] = pixel_to_opencv(matrix[:2, 2])
    found, rotation_vector, translation = cv2.solvePnP(
        problem.points_body_m, pixel_to_opencv(problem.uv_px), matrix, None, flags=cv2.SOLVEPNP_EPNP
    )
    if not found or not (np.isfinite(rotation_vector).all() and np.isfinite(translation).all()):
        return None
    pose = Pose(cv2.Rodrigues(rotation_vector)[0], translation.ravel())
    return pose if (pose.transform(problem.points_body_m)[:, 2] > 0.0).all() else None


def image_jacobian(camera: Camera, points_cam_m: FloatArray, point_by_attitude: FloatArray) -> FloatArray:
    """Differentiate the projections by A attitude parameters and the translation, (..., N, 2, A + 3).

    ``points_cam_m`` (..., N, 3) are landmarks in camera axes, ``point_by_attitude`` (..., N, 3, A) their derivatives by
    the attitude parameters.
    """
    # The translation moves the point in the camera by itself, so that its columns are those of the point.
    by_point = camera.jacobian(points_cam_m)
    return np.concatenate([by_point @ point_by_attitude, by_point], axis=-1)  # eqs. (21), (22)


def point_by_quaternion(quat_wxyz: FloatArray, points_body_m: FloatArray) -> FloatArray:
    """Differentiate R(q) x by the components of a unit quaternion, without renormalisation, (..., N, 3, 4).

    ``quat_wxyz`` (..., 4) are attitudes, ``points_body_m`` (..., N, 3) landmarks.
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
    # d(exp(w) x)/dw = -[x]x at w = 0, as w x x = -x x w.
    columns = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1)
    return columns.reshape(*x.shape, 3, 3)


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
