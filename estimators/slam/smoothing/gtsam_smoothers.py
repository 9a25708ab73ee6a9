"""Smoothers of gtsam as sequence estimators: iSAM2 over all frames, and its fixed-lag form."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Self

import numpy as np

from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.estimators.slam.following import ConfiguredEstimator, Follower, check_connected, check_scale
from boresight.estimators.slam.options import GtsamFixedLagOptions, GtsamOptions
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame, TrackSequence

# A bearing has a sigma of about 3.5e-4 rad (0.67 px): even a hundred of them change this attitude by 1 part in 1e7.
ATTITUDE_SIGMA_RAD = 1e-8
# Standard deviation of a position that is known exactly: gtsam's noise models need a positive one.
_FIXED_SIGMA_M = 1e-6
# Standard deviation of a rotation that a factor leaves free.
_FREE_SIGMA_RAD = 1e3


def load_gtsam() -> Any:
    """Import gtsam; raise BoresightError if it is not installed."""
    try:
        return import_module("gtsam")
    except ImportError as error:
        raise BoresightError(f'gtsam: cannot be imported ({error}); install it: pip install -e ".[gtsam]"') from None


class Factors:
    """Factors of one camera; views and landmarks are given by their numbers."""

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
        """Return the prior factor of a view's known attitude."""
        known = self.gtsam.Rot3(R_cam_body.T)
        return self.gtsam.PoseRotationPrior3D(self.view(view), known, self._noise(3, ATTITUDE_SIGMA_RAD))

    def place(self, view: int, position_m: FloatArray, covariance_m2: FloatArray) -> Any:
        """Return the prior factor of a view's position; a covariance of zero fixes it."""
        # The residual of this factor is in body axes, as the covariance is.
        known = covariance_m2 if np.any(covariance_m2) else np.eye(3) * _FIXED_SIGMA_M**2
        noise = self.gtsam.noiseModel.Gaussian.Covariance(known)
        return self.gtsam.PoseTranslationPrior3D(self.view(view), position_m, noise)

    def pixel(self, view: int, point: int, uv_px: FloatArray, sigma_px: float) -> Any:
        """Return the factor of a landmark's pixel."""
        keys = self.view(view), self.point(point)
        noise = self._noise(2, sigma_px)
        return self.gtsam.GenericProjectionFactorCal3_S2(uv_px, noise, *keys, self._calibration, False, False)

    def distance(self, view: int, point: int, range_m: float, sigma_m: float) -> Any:
        """Return the factor of a measured distance from a view to a landmark."""
        return self.gtsam.RangeFactor3D(self.view(view), self.point(point), range_m, self._noise(1, sigma_m))

    def motion(
        self, views: tuple[int, int], R_cam_body: FloatArray, moved_m: FloatArray, covariance_m2: FloatArray
    ) -> Any:
        """Return the factor of a displacement from view to view, body axes; ``R_cam_body`` (2, 3, 3)."""
        # Pose of the second camera in the first one's axes: T_1^-1 T_2 with T from camera to body.
        between = self.gtsam.Pose3(self.gtsam.Rot3(R_cam_body[0] @ R_cam_body[1].T), R_cam_body[0] @ moved_m)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = np.eye(3) * _FREE_SIGMA_RAD**2
        # gtsam's tangent vectors are [rotation, translation] in the axes of the pose itself: here those of the second
        # camera.
        covariance[3:, 3:] = R_cam_body[1] @ covariance_m2 @ R_cam_body[1].T
        noise = self.gtsam.noiseModel.Gaussian.Covariance(covariance)
        return self.gtsam.BetweenFactorPose3(self.view(views[0]), self.view(views[1]), between, noise)

    def _noise(self, size: int, sigma: float) -> Any:
        if (size, sigma) not in self._isotropic:
            self._isotropic[size, sigma] = self.gtsam.noiseModel.Isotropic.Sigma(size, sigma)
        return self._isotropic[size, sigma]


class GtsamIsam2(ConfiguredEstimator[GtsamOptions]):
    """iSAM2 of gtsam: a Bayes tree of all frames, updated incrementally.

    It needs the extra ``gtsam``.

    Use it when
    -----------
    To compare ``batch`` with another program on the same tracks.

    It fails when
    -------------
    gtsam is not installed; gtsam reports an indeterminate system; otherwise as ``batch``. Outliers are not rejected,
    and errors that add up along a track (``walk_px``, ``contraction`` and ``drift_px`` of ``sequence.knowledge``) are
    not modelled.

    Cost
    ----
    2.4 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Kaess et al. (2012), as implemented in gtsam.
    """

    name: ClassVar[str] = "gtsam-isam2"
    version: ClassVar[int] = 3
    options_model = GtsamOptions

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one, or without gtsam."""
        load_gtsam()
        return super().from_options(options)

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return IncrementalFollower(sequence, self.options, lag=None)


class GtsamFixedLag(GtsamIsam2):
    """Incremental fixed-lag smoother of gtsam: iSAM2 that marginalises frames older than the lag.

    It needs the extra ``gtsam``.

    Use it when
    -----------
    To compare ``fixed-lag`` with another program on the same tracks.

    It fails when
    -------------
    gtsam is not installed; gtsam reports an indeterminate system; otherwise as ``fixed-lag``. Outliers are not
    rejected, and errors that add up along a track (``walk_px``, ``contraction`` and ``drift_px`` of
    ``sequence.knowledge``) are not modelled.

    Cost
    ----
    0.55 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Kaess et al. (2012), as implemented in gtsam.
    """

    name: ClassVar[str] = "gtsam-fixed-lag"
    version: ClassVar[int] = 3
    options: GtsamFixedLagOptions
    options_model = GtsamFixedLagOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return IncrementalFollower(sequence, self.options, lag=self.options.lag)


class IncrementalFollower:
    """Smoother of gtsam on one sequence; ``lag`` in frames, None for all frames."""

    def __init__(self, sequence: TrackSequence, options: GtsamOptions, lag: int | None) -> None:
        self.options, self.lag = options, lag
        self.sequence = sequence
        self.slam_map = SlamMap(sequence.camera)
        self.factors = Factors(sequence.camera)
        gtsam = self.factors.gtsam
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(options.relinearize_m)
        # Look for variables to linearise anew at every update.
        parameters.relinearizeSkip = 1
        self.engine: Any = gtsam.ISAM2(parameters)
        if lag is not None:
            self.engine = gtsam.IncrementalFixedLagSmoother(float(lag), parameters)
        self.mapped: set[int] = set()

    def diagnostics(self) -> dict[str, float]:
        """Scalars about the whole sequence so far."""
        return {"landmarks": float(len(self.mapped))}

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        """Process the next frame. Raises LostError."""
        number = len(self.slam_map.positions_m)
        self.slam_map.frames[number] = frame
        if number == 0:
            self.slam_map.positions_m[0] = self.sequence.position_m.copy()
            self.slam_map.guess(0, self.slam_map.median_depth(0))
        else:
            check_connected(self.slam_map.shared(number - 1, number), self.options.connectivity)
            depth_m = self.slam_map.median_depth(number - 1)
            self.slam_map.place(number, StoppingRule(self.options.tolerance * depth_m, self.options.iterations))
        graph, values = self.factors.gtsam.NonlinearFactorGraph(), self.factors.gtsam.Values()
        self._add_view(graph, values, number)
        self._add_landmarks(graph, values, number)
        try:
            self._update(graph, values, number)
            return self._estimate(number)
        except RuntimeError as error:  # exceptions of gtsam's C++ code
            raise LostError(f"gtsam: {str(error).strip().splitlines()[0]}") from error

    def _add_view(self, graph: Any, values: Any, number: int) -> None:
        frame, factors = self.slam_map.frames[number], self.factors
        values.insert(factors.view(number), factors.pose(frame.R_cam_body, self.slam_map.positions_m[number]))
        graph.add(factors.attitude(number, frame.R_cam_body))
        if number == 0:
            graph.add(factors.place(0, self.sequence.position_m, self.sequence.position_covariance_m2))
        elif self.options.motion:
            attitudes = self.slam_map.attitudes([number - 1, number])
            graph.add(factors.motion((number - 1, number), attitudes, frame.motion_m, frame.motion_covariance_m2))

    def _add_landmarks(self, graph: Any, values: Any, number: int) -> None:
        """Add the pixels of all landmarks that were seen twice or have a range; a new one also with its first pixel."""
        slam_map, frame = self.slam_map, self.slam_map.frames[number]
        ranges = {item.track: item for item in frame.ranges}
        before = set(slam_map.frames[number - 1].tracks.tolist()) if number else set()
        for row, track in enumerate(frame.tracks.tolist()):
            if track not in self.mapped:
                if track not in before and track not in ranges:
                    continue
                views = [view for view in (number - 1, number) if view == number or track in before]
                # A bearing alone leaves the distance undetermined, which makes the tree's linear system singular: the
                # first pixel waits for the second.
                if len(views) == 2:
                    slam_map.points_m[track] = slam_map.triangulate(track, views)
                    slam_map.guessed.discard(track)
                    earlier = slam_map.frames[number - 1]
                    uv_px = earlier.uv_px[int(np.flatnonzero(earlier.tracks == track)[0])]
                    graph.add(self.factors.pixel(number - 1, track, uv_px, earlier.sigma_px))
                elif number > 0:  # a new track with a range: the first frame's are placed already
                    ray = slam_map.ray(number, track)
                    slam_map.points_m[track] = slam_map.positions_m[number] + ranges[track].range_m * ray
                values.insert(self.factors.point(track), slam_map.points_m[track])
                self.mapped.add(track)
            graph.add(self.factors.pixel(number, track, frame.uv_px[row], frame.sigma_px))
            if track in ranges:
                graph.add(self.factors.distance(number, track, ranges[track].range_m, ranges[track].sigma_m))

    def _update(self, graph: Any, values: Any, number: int) -> None:
        """Update the tree with the new factors, then repeat the update ``rounds - 1`` times."""
        if self.lag is None:
            self.engine.update(graph, values)
        else:
            # A landmark's time stamp is renewed while it is in view, so that it stays in the tree; its views do not.
            seen = [self.factors.point(t) for t in self.slam_map.frames[number].tracks.tolist() if t in self.mapped]
            self.engine.update(graph, values, dict.fromkeys([self.factors.view(number), *seen], float(number)))
        # Each update is one Gauss-Newton step of the variables that have moved.
        for _ in range(self.options.rounds - 1):
            self.engine.update()

    def _estimate(self, number: int) -> FrameEstimate:
        factors, slam_map, engine = self.factors, self.slam_map, self.engine
        pose = engine.calculateEstimatePose3(factors.view(number))
        local = engine.marginalCovariance(factors.view(number))[3:, 3:]  # camera axes
        # Camera to body axes.
        turn = pose.rotation().matrix()
        covariance = turn @ local @ turn.T
        tracks = sorted(track for track in slam_map.frames[number].tracks.tolist() if track in self.mapped)
        points = np.array([engine.calculateEstimatePoint3(factors.point(track)) for track in tracks]).reshape(-1, 3)
        position = np.asarray(pose.translation(), dtype=np.float64)
        slam_map.positions_m[number] = position
        slam_map.points_m.update(zip(tracks, points, strict=True))
        if number:
            check_scale(covariance, points, position, self.options.uncertainty_max)
        return FrameEstimate(position, covariance, np.array(tracks, dtype=np.int64), points, 0.0)
