"""Fixed-lag smoother, with a marginalisation prior for the older frames, and batch adjustment of all frames."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from boresight.estimators.slam.adjustment.global_map import planned_covariance
from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Adjustment, Motions, QuadraticPrior, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap, lookup, values_or_nan
from boresight.estimators.slam.adjustment.solver import StoppingRule, marginalise_view, view_covariance
from boresight.estimators.slam.adjustment.track_errors import COMMON
from boresight.estimators.slam.association.outliers import OutlierGate
from boresight.estimators.slam.association.prediction import predict_from_window
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.estimators.slam.following import ConfiguredEstimator, Follower, check_connected, check_scale
from boresight.estimators.slam.options import BatchOptions, SmootherOptions
from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.observation import Prediction, TrackFrame, TrackSequence

_WEAK_RATIO = 10.0
"""Standard deviation of the weak prior of a landmark, in median depths of the newest view."""


class FixedLagSmoother(ConfiguredEstimator[SmootherOptions]):
    """Fixed-lag smoother: adjusts the last frames, and marginalises older ones and lost landmarks to a prior.

    Predicted motions, ranges and pixels are measurements. Derivatives by variables of the prior are taken at their
    first estimates. Outliers are rejected by one-point RANSAC and by their residuals.

    Use it when
    -----------
    The usual choice for tracks along an orbit: small errors, a covariance that describes them, and cost that does not
    grow. Errors that add up along tracks are modelled if they are stated (``walk_px``, ``contraction`` and ``drift_px``
    of ``sequence.knowledge``): on ``vesta-simulated-tracks`` with the errors of real tracks and a range every 10 frames
    the mean NEES is then 2.5 and 2.1 in place of 18 and 61, 3 expected (20 and 60 tracks, 12 runs of each).

    It fails when
    -------------
    Too few landmarks are shared by two frames, or the scale is unobservable: the position's standard deviation exceeds
    ``uncertainty_max`` of the distance. In ``delpech2015-comparison`` 96, 100 and 100 of 100 runs of 10, 15 and 20
    landmarks a frame ended, with a mean NEES of 3.16, 2.97 and 2.84, 3 expected. Errors of the attitude are not
    modelled with ``attitude: known``. With ``sequence.knowledge.walk_px`` a wrong pixel passes the gate the more
    easily, the older its track is.

    Cost
    ----
    0.26 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Ours. First-estimates Jacobians: Huang et al. (2010).
    """

    name: ClassVar[str] = "fixed-lag"
    version: ClassVar[int] = 8
    options_model = SmootherOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return WindowSmoother(sequence, self.options)

    def predict(self, sequence: TrackSequence, positions_m: FloatArray, points_m: FloatArray) -> FloatArray | None:
        """Predict by all frames at once, see `SequenceEstimator`: what a window forgets is not in the covariance."""
        weighted = tuple(map(WindowSmoother(sequence, self.options).weighted, sequence.frames))
        planned = replace(sequence, frames=weighted)
        return planned_covariance(planned, positions_m, points_m, motion=self.options.motion)


class BatchAdjustment(ConfiguredEstimator[BatchOptions]):
    """Adjusts all frames so far at each frame: the accuracy reference of the other estimators, and slow.

    Use it when
    -----------
    To see how much of an estimator's error comes from its window: no right association can give more than this. Errors
    that add up along tracks are modelled as in ``fixed-lag``.

    It fails when
    -------------
    As ``fixed-lag``. Outliers are used as they are unless ``associations: consensus`` is set: of 20 descents by tracks
    of images (``hayabusa2-descent-frames``) it ends 3 without and 19 with it. The time of a frame grows with the number
    of frames.

    Cost
    ----
    0.63 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Ours: bundle adjustment with predicted motions and ranges.
    """

    name: ClassVar[str] = "batch"
    version: ClassVar[int] = 4
    options_model = BatchOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        endless = SmootherOptions.model_construct(
            **self.options.model_dump(), lag=len(sequence.frames) + 1, first_estimates=False
        )
        return WindowSmoother(sequence, endless)

    def predict(self, sequence: TrackSequence, positions_m: FloatArray, points_m: FloatArray) -> FloatArray | None:
        """Predict by the normal matrix of all frames, see `SequenceEstimator`."""
        return planned_covariance(sequence, positions_m, points_m, motion=self.options.motion)


class WindowSmoother:
    """Window of a smoother on one sequence; ``prior`` numbers its views and landmarks by frame and track.

    ``absorbed`` are tracks of marginalised landmarks, whose further pixels are not used. ``first_positions_m`` and
    ``first_points_m`` are first estimates of the variables in the prior, by view and by track.
    """

    def __init__(self, sequence: TrackSequence, options: SmootherOptions) -> None:
        self.options = options
        self.slam_map = SlamMap(sequence.camera)
        self.first_m = sequence.position_m
        self.first_covariance_m2 = sequence.position_covariance_m2
        # With a covariance of zero the first view is fixed instead: its information would be infinite.
        self.first_is_free = bool(np.any(self.first_covariance_m2))
        self.views: list[int] = []
        self.prior: QuadraticPrior | None = None
        self.absorbed: set[int] = set()
        self.first_positions_m: dict[int, FloatArray] = {}
        self.first_points_m: dict[int, FloatArray] = {}
        self.gate = OutlierGate(self.slam_map, options)
        self.adjusted: AdjustedWindow | None = None
        self.iterations = 0
        self.widest_prior = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the mean number of steps of a frame, and the largest number of variables in the prior."""
        frames = max(len(self.slam_map.positions_m.keys() - {COMMON}) - 1, 1)
        return {
            "iterations_per_frame": self.iterations / frames,
            "prior_variables": float(self.widest_prior),
            **self.gate.diagnostics(),
        }

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        """Adjust with the next frame, and marginalise the oldest one if the window is full. Raises LostError."""
        number = self.next_number
        self._note(frame)
        self.gate.add_frame(number, self.weighted(frame))
        self.views.append(number)
        if number == 0:
            return self._begin()
        depth = self.slam_map.median_depth(number - 1)
        rule = StoppingRule(self.options.tolerance * depth, self.options.iterations)
        check_connected(self.gate.shared(number - 1, number), self.options.connectivity)
        self.gate.place(number, self.adjusted, rule, depth)
        estimate = self._adjust_without_outliers(rule)
        if len(self.views) > self.options.lag and self.adjusted is not None:
            self._marginalise(self.adjusted)
        return estimate

    def _note(self, frame: TrackFrame) -> None:
        """Note the next frame for errors that add up along its tracks."""
        self.slam_map.errors.add(frame)

    @property
    def next_number(self) -> int:
        """Number of the next frame."""
        return self.views[-1] + 1 if self.views else 0

    def weighted(self, frame: TrackFrame) -> TrackFrame:
        """Add the star tracker's noise to that of the pixels with ``attitude: noisy``.

        An attitude error shifts all pixels of a frame together, which this model ignores; the pixels of a landmark in
        different frames are shifted independently, as modelled.
        """
        if self.options.attitude == "known":
            return frame
        # A rotation across the line of sight moves a pixel by its angle; one about the boresight moves it less.
        shift_px = frame.attitude_noise_rad / self.slam_map.camera.pixel_angle_rad
        return replace(frame, sigma_px=math.hypot(frame.sigma_px, shift_px))

    def _adjust(self, rule: StoppingRule) -> AdjustedWindow:
        """Adjust the window once."""
        joined = set() if self.prior is None else set(self.prior.points.tolist())
        # Also landmarks of the prior whose pixels are all refused.
        tracks, seen = self.slam_map.determined(self.views, self.absorbed, joined)
        self.slam_map.triangulate_new(tracks, seen)
        problem = self._problem(tracks)
        solution = self.slam_map.adjust(problem, self.slam_map.errors.views(self.views), tracks, rule)
        self.iterations += solution.iterations
        return AdjustedWindow(problem, solution.state, tuple(self.views), np.array(tracks, dtype=np.int64))

    def _adjust_without_outliers(self, rule: StoppingRule) -> FrameEstimate:
        """Adjust the window, repeatedly while the gate rejects outliers; return the estimate of the newest view."""
        self.adjusted = self.gate.adjust(lambda: self._adjust(rule))
        problem, state = self.adjusted.problem, self.adjusted.state
        try:
            covariance = view_covariance(problem, state, len(self.views) - 1)
        except np.linalg.LinAlgError as error:
            raise LostError("the scale is unobservable: the reduced system has not full rank") from error
        # An unobservable scale shows as a large covariance: predicted motions and rounding keep it finite.
        position = state.positions_m[len(self.views) - 1]
        check_scale(covariance, state.points_m, position, self.options.uncertainty_max)
        return FrameEstimate(position, covariance, self.adjusted.tracks, state.points_m, 0.0)

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Predict the pixels of the landmarks of the last frame in the next one."""
        return predict_from_window(self.slam_map, self.views[-1], frame, self.adjusted) if self.views else None

    def _begin(self) -> FrameEstimate:
        """Place the first view, and its landmarks provisionally at the measured distance."""
        self.slam_map.positions_m[0] = self.first_m.copy()
        estimate = self.slam_map.first_estimate(self.first_covariance_m2)
        if self.first_is_free:
            self.prior = QuadraticPrior.of_first_position(self.first_m, self.first_covariance_m2)
        self.prior = self.slam_map.errors.prior(self.prior)
        if self.slam_map.errors.common_m:
            self.slam_map.positions_m[COMMON] = np.zeros(3)
        return estimate

    def _problem(self, tracks: list[int]) -> Adjustment:
        """Return the adjustment of the window's views and of ``tracks``."""
        errors = self.slam_map.errors
        prior, frozen, views = self.prior, None, errors.views(self.views)
        if prior is not None:
            prior = replace(prior, views=lookup(views, prior.views), points=lookup(tracks, prior.points))
        if self.options.first_estimates:
            # Derivatives are taken at the first estimates of the prior's variables. The prior of the first position is
            # linear, so that it needs no point of linearisation: only variables of marginalised measurements are
            # frozen.
            frozen = State(values_or_nan(self.first_positions_m, views), values_or_nan(self.first_points_m, tracks))
        free_views = np.ones(len(self.views), dtype=np.bool_)
        # Later oldest views are free: the prior of marginalisation holds them.
        free_views[0] = self.views[0] != 0 or self.first_is_free
        problem = replace(
            self.slam_map.problem(self.views, tracks),
            free_views=free_views,
            motions=self.slam_map.motions(self.views) if self.options.motion else Motions(),
            prior=prior,
            frozen=frozen,
        )
        return errors.extended(problem, self.views, tracks)

    def _marginalise(self, adjusted: AdjustedWindow) -> None:
        """Marginalise the oldest view, and those of its landmarks and of the prior's that are out of view."""
        problem, state, number = adjusted.problem, adjusted.state, adjusted.tracks
        in_prior = np.zeros(len(number), dtype=np.bool_)
        in_prior[problem.prior_points] = True
        # Refused pixels count as in view: the landmark may fit again in the next frame.
        last = set(self.gate.raw_frames[self.views[-1]].tracks.tolist())
        first = set(self.slam_map.frames[self.views[0]].tracks.tolist())
        oldest = in_prior | np.array([track in first for track in number.tolist()], dtype=np.bool_)
        lost = oldest & np.array([track not in last for track in number.tolist()], dtype=np.bool_)
        # What remains of the oldest view's landmarks would enter the prior, which couples them all.
        excess = self._beyond_prior_size(oldest & ~lost, in_prior)
        try:
            local = marginalise_view(problem, state, 0, lost | excess)
        except np.linalg.LinAlgError as error:
            raise LostError("the scale is unobservable: the oldest view is not determined") from error
        errors = self.slam_map.errors
        views = np.array(errors.views(self.views))
        self.prior = replace(local, views=views[local.views], points=number[local.points])
        if self.gate.active:
            self.prior = _with_weak_lines(
                self.prior, ~in_prior[local.points], self.slam_map.median_depth(self.views[-1])
            )
        self.widest_prior = max(self.widest_prior, len(local.origin_m))
        # The estimate at the first entry stays the point of linearisation as long as the variable is in the prior.
        for view, position in zip(self.prior.views.tolist(), state.positions_m[local.views], strict=True):
            self.first_positions_m.setdefault(view, position)
        for track, point in zip(self.prior.points.tolist(), state.points_m[local.points], strict=True):
            self.first_points_m.setdefault(track, point)
        self.absorbed |= set(number[lost].tolist())
        del self.slam_map.frames[self.views[0]]
        self.gate.drop_view(self.views[0])
        self.views = self.views[1:]
        before, errors.since = errors.since, self.views[0]
        # Landmarks where they were followed to at the view before become landmarks at the oldest view.
        at = self.slam_map.positions_m[self.views[0]], self.slam_map.frames[self.views[0]].R_cam_body
        self.prior = errors.carried(self.prior, before, self.slam_map.camera, at)
        # The prior contains the pixels of the excess landmarks.
        gone = set(number[excess].tolist())
        for view in self.views if gone else ():
            self.gate.drop_tracks(view, gone)
        for track in gone:
            # A later landmark of the same track is a new variable.
            self.first_points_m.pop(track, None)

    def _beyond_prior_size(self, staying: BoolArray, in_prior: BoolArray) -> BoolArray:
        """(L,) landmarks beyond the size limit of the prior; those already in it stay until they are lost.

        The cost of a dense prior grows with the cube of its size. The pixels of an excess landmark are marginalised
        with it, and so constrain only the views that saw it; its later pixels belong to a new landmark. Each
        measurement is used exactly once, so that the covariance stays consistent, but the information that both are
        one landmark is lost: with 100 landmarks a frame, of which the prior would hold about 40, a limit of 30 made
        the error 1.4 times as large (10 sequences).
        """
        rows = np.flatnonzero(staying)
        # Landmarks of the prior first, then the oldest tracks.
        rows = rows[np.argsort(~in_prior[rows], kind="stable")]
        beyond = np.zeros_like(staying)
        beyond[rows[self.options.prior_landmarks :]] = True
        return beyond


def _with_weak_lines(prior: QuadraticPrior, new: BoolArray, depth_m: float) -> QuadraticPrior:
    """Add a weak prior on the lines of sight of ``new`` landmarks: a sigma of ten times the median depth ``depth_m``.

    The prior may hold a landmark from a single bearing, and the later pixels that would determine its distance may be
    refused; then the normal matrix would be singular. The difference from the first view is constrained, not the
    landmark's position, so that a common translation stays free.
    """
    if not len(prior.views) or prior.views[0] == COMMON or not new.any():
        return prior
    weight = 1.0 / (_WEAK_RATIO * depth_m) ** 2
    information, view = prior.information.copy(), np.arange(3)
    for point in (len(prior.views) + np.flatnonzero(new)).tolist():
        # w |(p - x) - (p0 - x0)|^2 / 2 with p the landmark and x the prior's first view: +w on both diagonal blocks, -w
        # between them; no gradient, since it is zero at the origin.
        own = 3 * point + view
        information[own, own] += weight
        information[view, view] += weight
        information[own, view] -= weight
        information[view, own] -= weight
    return replace(prior, information=information)
