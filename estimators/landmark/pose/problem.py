"""The least-squares problem of the pose from matched landmarks, its Jacobians and EPnP.

Equations (15) to (24) of Rowell et al. (2015); the covariances that weight it are predicted by `landmark.projection`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, pixel_to_opencv

MIN_LANDMARKS = 4


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
