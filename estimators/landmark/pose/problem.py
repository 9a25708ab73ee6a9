"""Matched landmarks as a least-squares problem: equations (15) to (20)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose

FloatArray = NDArray[np.float64]

MIN_LANDMARKS = 4


@dataclass(frozen=True, slots=True, eq=False)
class PoseProblem:
    """N landmarks with their observed positions.

    Parameters
    ----------
    points_body_m
        (N, 3) positions in the body frame.
    uv_px
        (N, 2) observed positions: the data vector D of equation (16).
    information_px2
        (N, 2, 2) inverse covariances of the projections: the blocks of the inverse of equation (18).
    camera
        The camera.

    Raises
    ------
    BoresightError
        If there are fewer than four landmarks or the shapes disagree.
    """

    points_body_m: FloatArray
    uv_px: FloatArray
    information_px2: FloatArray
    camera: Camera

    def __post_init__(self) -> None:
        n = len(self.points_body_m)
        shapes = (self.points_body_m.shape, self.uv_px.shape, self.information_px2.shape)
        if shapes != ((n, 3), (n, 2), (n, 2, 2)) or n < MIN_LANDMARKS:
            raise BoresightError(f"a pose needs {MIN_LANDMARKS} or more landmarks of agreeing shapes, not {shapes}")

    def residuals_px(self, T_cam_body: Pose) -> FloatArray:
        """D - M, (N, 2); NaN where a landmark is behind the camera."""
        return self.uv_px - self.camera.project(T_cam_body.transform(self.points_body_m))

    def chi2(self, T_cam_body: Pose) -> float:
        """Total covariance-weighted reprojection error; infinite where a landmark is behind the camera."""
        residuals = self.residuals_px(T_cam_body)
        value = float(np.einsum("ni,nij,nj->", residuals, self.information_px2, residuals))  # eq. (20)
        return value if np.isfinite(value) else float("inf")

    def normal_equations(self, jacobian: FloatArray, residuals_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """J^T S^-1 J and J^T S^-1 (D - M) of equation (24), for a Jacobian of shape (N, 2, P)."""
        weighted = self.information_px2 @ jacobian
        matrix: FloatArray = np.einsum("nip,niq->pq", jacobian, weighted)
        vector: FloatArray = np.einsum("nip,ni->p", weighted, residuals_px)
        return matrix, vector
