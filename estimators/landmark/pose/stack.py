"""Many poses and pose problems of one size side by side: what ``problem`` is for one, over stacks of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.landmark.pose.problem import PoseProblem
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]


def window_overlap(first_px: FloatArray, last_px: FloatArray) -> FloatArray:
    """Share (N, N) of the pixels that each two windows have in common, over the geometric mean of their areas.

    If what disturbs an observation is white noise in the pixels of its window, this is the correlation of the
    disturbances of two; as the Gram matrix of the windows it is never indefinite.

    Parameters
    ----------
    first_px, last_px
        (N, 2) columns and rows of the windows' first corners and of their opposite corners.
    """
    low = np.maximum(first_px[:, None], first_px[None])
    high = np.minimum(last_px[:, None], last_px[None])
    common = np.clip(high - low, 0.0, None).prod(axis=2)
    root = np.sqrt(np.diag(common))
    share: FloatArray = common / np.outer(root, root)
    return share


@dataclass(frozen=True, slots=True, eq=False)
class PoseStack:
    """B poses T_cam_body.

    Parameters
    ----------
    rotations
        (B, 3, 3).
    translations_m
        (B, 3).
    """

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

    def rotate(self, points_body_m: FloatArray) -> FloatArray:
        """Turn points (B, N, 3) into camera axes, without the translation."""
        rotated: FloatArray = np.einsum("bij,bnj->bni", self.rotations, points_body_m)
        return rotated

    def transform(self, points_body_m: FloatArray) -> FloatArray:
        """Take points (B, N, 3) to the camera frame, each row with its own pose."""
        return self.rotate(points_body_m) + self.translations_m[:, None, :]

    @property
    def camera_positions_m(self) -> FloatArray:
        """The cameras in the body frame, (B, 3)."""
        positions: FloatArray = -np.einsum("bji,bj->bi", self.rotations, self.translations_m)
        return positions


@dataclass(frozen=True, slots=True, eq=False)
class ProblemStack:
    """B pose problems of N landmarks each.

    Parameters
    ----------
    points_body_m
        (B, N, 3).
    uv_px
        (B, N, 2) observed positions.
    information_px2
        (B, N, 2, 2) inverse covariances.
    camera
        The camera.

    Raises
    ------
    BoresightError
        If the shapes disagree.
    """

    points_body_m: FloatArray
    uv_px: FloatArray
    information_px2: FloatArray
    camera: Camera

    def __post_init__(self) -> None:
        size = self.points_body_m.shape[:2]
        shapes = (self.points_body_m.shape, self.uv_px.shape, self.information_px2.shape)
        if shapes != ((*size, 3), (*size, 2), (*size, 2, 2)):
            raise BoresightError(f"pose problems side by side need landmarks of agreeing shapes, not {shapes}")

    def __len__(self) -> int:
        return len(self.points_body_m)

    def rows(self, chosen: NDArray[np.generic]) -> ProblemStack:
        """Choose some of the problems."""
        return ProblemStack(self.points_body_m[chosen], self.uv_px[chosen], self.information_px2[chosen], self.camera)

    def problem(self, row: int) -> PoseProblem:
        """Return one of the problems."""
        return PoseProblem(self.points_body_m[row], self.uv_px[row], self.information_px2[row], self.camera)

    def residuals_px(self, poses: PoseStack) -> FloatArray:
        """D - M, (B, N, 2); NaN where a landmark is behind the camera."""
        return self.uv_px - self.camera.project(poses.transform(self.points_body_m))

    def chi2(self, poses: PoseStack) -> FloatArray:
        """Total weighted reprojection errors, (B,); infinite where a landmark is behind the camera."""
        residuals = self.residuals_px(poses)
        values = np.einsum("bni,bnij,bnj->b", residuals, self.information_px2, residuals)  # eq. (20)
        finite: FloatArray = np.where(np.isfinite(values), values, np.inf)
        return finite

    def normal_equations(self, jacobians: FloatArray, poses: PoseStack) -> tuple[FloatArray, FloatArray]:
        """J^T S^-1 J, (B, P, P), and J^T S^-1 (D - M), (B, P), of equation (24), for Jacobians (B, N, 2, P)."""
        weighted = self.information_px2 @ jacobians
        matrices: FloatArray = np.einsum("bnip,bniq->bpq", jacobians, weighted)
        vectors: FloatArray = np.einsum("bnip,bni->bp", weighted, self.residuals_px(poses))
        return matrices, vectors
