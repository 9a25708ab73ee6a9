"""What is measured of a sequence, as factors of gtsam in C++.

gtsam has no projection of a point into a camera of known attitude, so a view is a Pose3 whose attitude is tied to what
is known by a factor so stiff that it changes the cost by less than a part in a million.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.slam.state import Adjustment, State
from scenarios.errors import BoresightError
from scenarios.geometry import Camera

FloatArray = NDArray[np.float64]

# A bearing of 0.67 px is known to 3.5e-4 rad: a hundred of them give way by a part in 1e7.
ATTITUDE_SIGMA_RAD = 1e-8
_FIXED_SIGMA_M = 1e-6
_FREE_SIGMA_RAD = 1e3


def load_gtsam() -> Any:
    """Import gtsam.

    Raises
    ------
    BoresightError
        If it is not installed.
    """
    try:
        return import_module("gtsam")
    except ImportError as error:
        raise BoresightError(
            f"gtsam: cannot be imported ({error}); install it: pip install 'boresight[gtsam]'"
        ) from None


class Factors:
    """Makes the factors of one camera; views and landmarks go by their numbers."""

    def __init__(self, camera: Camera) -> None:
        self.gtsam = load_gtsam()
        fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
        self._calibration = self.gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
        self._isotropic: dict[tuple[int, float], Any] = {}

    def view(self, number: int) -> int:
        """Return the key of a view."""
        return int(self.gtsam.symbol("x", number))

    def point(self, number: int) -> int:
        """Return the key of a landmark."""
        return int(self.gtsam.symbol("l", number))

    def pose(self, R_cam_body: FloatArray, position_m: FloatArray) -> Any:
        """Return a view as gtsam's Pose3, which takes camera coordinates to body coordinates."""
        return self.gtsam.Pose3(self.gtsam.Rot3(R_cam_body.T), position_m)

    def attitude(self, view: int, R_cam_body: FloatArray) -> Any:
        """Tie a view to its known attitude."""
        known = self.gtsam.Rot3(R_cam_body.T)
        return self.gtsam.PoseRotationPrior3D(self.view(view), known, self._noise(3, ATTITUDE_SIGMA_RAD))

    def place(self, view: int, position_m: FloatArray, covariance_m2: FloatArray) -> Any:
        """Tie a view to a measured position; a covariance of zero fixes it."""
        known = covariance_m2 if np.any(covariance_m2) else np.eye(3) * _FIXED_SIGMA_M**2
        noise = self.gtsam.noiseModel.Gaussian.Covariance(known)
        return self.gtsam.PoseTranslationPrior3D(self.view(view), position_m, noise)

    def sighting(self, view: int, point: int, uv_px: FloatArray, sigma_px: float) -> Any:
        """Tell where a view saw a landmark."""
        keys = self.view(view), self.point(point)
        noise = self._noise(2, sigma_px)
        return self.gtsam.GenericProjectionFactorCal3_S2(uv_px, noise, *keys, self._calibration, False, False)

    def distance(self, view: int, point: int, range_m: float, sigma_m: float) -> Any:
        """Tell how far a landmark is from a view."""
        return self.gtsam.RangeFactor3D(self.view(view), self.point(point), range_m, self._noise(1, sigma_m))

    def motion(
        self, views: tuple[int, int], R_cam_body: FloatArray, moved_m: FloatArray, covariance_m2: FloatArray
    ) -> Any:
        """Tell the displacement from a view to the next, body axes; ``R_cam_body`` (2, 3, 3) are their attitudes."""
        between = self.gtsam.Pose3(self.gtsam.Rot3(R_cam_body[0] @ R_cam_body[1].T), R_cam_body[0] @ moved_m)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = np.eye(3) * _FREE_SIGMA_RAD**2
        covariance[3:, 3:] = R_cam_body[1] @ covariance_m2 @ R_cam_body[1].T
        noise = self.gtsam.noiseModel.Gaussian.Covariance(covariance)
        return self.gtsam.BetweenFactorPose3(self.view(views[0]), self.view(views[1]), between, noise)

    def _noise(self, size: int, sigma: float) -> Any:
        if (size, sigma) not in self._isotropic:
            self._isotropic[size, sigma] = self.gtsam.noiseModel.Isotropic.Sigma(size, sigma)
        return self._isotropic[size, sigma]


def graph_of(problem: Adjustment, state: State) -> tuple[Any, Any]:
    """Write an adjustment without a prior down as a graph of gtsam, and ``state`` as its values."""
    factors = Factors(problem.camera)
    graph, values = factors.gtsam.NonlinearFactorGraph(), factors.gtsam.Values()
    for i, (R, position) in enumerate(zip(problem.R_cam_body, state.positions_m, strict=True)):
        graph.add(factors.attitude(i, R))
        values.insert(factors.view(i), factors.pose(R, position))
        if not problem.free_views[i]:
            graph.add(factors.place(i, position, np.zeros((3, 3))))
    for j, point in enumerate(state.points_m):
        values.insert(factors.point(j), point)
    seen, ranged, moved = problem.sightings, problem.distances, problem.motions
    for i, j, uv, sigma in zip(
        seen.view.tolist(), seen.point.tolist(), seen.uv_px, seen.sigma_px.tolist(), strict=True
    ):
        graph.add(factors.sighting(i, j, uv, sigma))
    for i, j, length, sigma in zip(*(part.tolist() for part in _columns(ranged)), strict=True):
        graph.add(factors.distance(i, j, length, sigma))
    for k in range(len(moved.start)):
        ends = int(moved.start[k]), int(moved.end[k])
        covariance = np.linalg.inv(moved.information[k])
        graph.add(factors.motion(ends, problem.R_cam_body[list(ends)], moved.displacement_m[k], covariance))
    return graph, values


def _columns(ranged: Any) -> tuple[Any, ...]:
    return ranged.view, ranged.point, ranged.range_m, ranged.sigma_m
