"""Smoothers: a window of all frames of a fixed lag, with what older ones tell in a quadratic; or all frames at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from estimators.slam.contract import FrameEstimate
from estimators.slam.following import ConfiguredEstimator, Follower, LostError, check_connected, check_scale, lookup
from estimators.slam.marginal import marginalise_view
from estimators.slam.options import BatchOptions, SmootherOptions
from estimators.slam.outliers import MAX_ROUNDS, OutlierGate, without_tracks
from estimators.slam.prediction import predict_from_window
from estimators.slam.problem import AdjustedWindow, Adjustment, Motions, QuadraticPrior, State
from estimators.slam.slam_map import SlamMap, values_or_nan
from estimators.slam.solver import StoppingRule, view_covariance
from scenarios.tracks import Prediction, TrackFrame, TrackSequence

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_WEAK_RATIO = 10.0


class FixedLagSmoother(ConfiguredEstimator[SmootherOptions]):
    """Adjusts the last frames; older ones and lost landmarks are marginalised: nothing measured is forgotten."""

    name: ClassVar[str] = "fixed-lag"
    version: ClassVar[int] = 5
    options_model = SmootherOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return WindowSmoother(sequence, self.options)


class BatchAdjustment(ConfiguredEstimator[BatchOptions]):
    """Adjusts all frames so far, anew at each frame: the yardstick of the others, at its cost."""

    name: ClassVar[str] = "batch"
    version: ClassVar[int] = 1
    options_model = BatchOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        endless = SmootherOptions.model_construct(
            **self.options.model_dump(), lag=len(sequence.frames) + 1, first_estimates=False
        )
        return WindowSmoother(sequence, endless)


class WindowSmoother:
    """The window at work on one sequence. Views and tracks of the prior go by their numbers in the sequence."""

    def __init__(self, sequence: TrackSequence, options: SmootherOptions) -> None:
        self.options = options
        self.slam_map = SlamMap(sequence.camera)
        self.first_m = sequence.position_m
        self.first_covariance_m2 = sequence.position_covariance_m2
        self.views: list[int] = []
        self.prior: QuadraticPrior | None = None
        self.absorbed: set[int] = set()
        self.first_positions_m: dict[int, FloatArray] = {}
        self.first_points_m: dict[int, FloatArray] = {}
        self.gate = OutlierGate(self.slam_map, options.false_alarm) if options.associations == "consensus" else None
        self.adjusted: AdjustedWindow | None = None
        self.iterations = 0
        self.widest_prior = 0

    def diagnostics(self) -> dict[str, float]:
        """Return the steps of a minimisation, and how many variables the prior had at most."""
        frames = max(len(self.slam_map.positions_m) - 1, 1)
        refused = {} if self.gate is None else {"refused_pixels": float(self.gate.refused_count)}
        return {
            "iterations_per_frame": self.iterations / frames,
            "prior_variables": float(self.widest_prior),
            **refused,
        }

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        """Take the next frame in, and drop the oldest one where the window is full. Raises LostError."""
        number = len(self.slam_map.positions_m)
        frame = self.weighted(frame)
        self.slam_map.frames[number] = frame
        if self.gate is not None:
            self.gate.add_frame(number, frame)
        self.views.append(number)
        if number == 0:
            return self._begin()
        depth = self.slam_map.median_depth(number - 1)
        rule = StoppingRule(self.options.tolerance * depth, self.options.iterations)
        self._check_connected(number)
        if self.gate is None:
            self.slam_map.place(number, rule)
        else:
            self.gate.place(number, self.adjusted, rule, depth)
        self.adjusted = self._adjust(rule)
        problem, state, tracks = self.adjusted.problem, self.adjusted.state, self.adjusted.tracks.tolist()
        estimate = self._estimate(problem, state, tracks)
        if len(self.views) > self.options.lag:
            self._marginalise(problem, state, tracks)
        return estimate

    def weighted(self, frame: TrackFrame) -> TrackFrame:
        """Give pixels the noise of the star tracker as well, where that is asked for.

        It moves all pixels of a frame together, which independent noise does not say, but a landmark's pixels in
        different frames independently, which it does.
        """
        if self.options.attitude == "known":
            return frame
        shift_px = frame.attitude_noise_rad / self.slam_map.camera.pixel_angle_rad
        return replace(frame, sigma_px=math.hypot(frame.sigma_px, shift_px))

    def _adjust(self, rule: StoppingRule) -> AdjustedWindow:
        """Adjust the window, again as long as what is left of a pixel is too much."""
        for rounds in range(MAX_ROUNDS):
            tracks = self._map()
            problem = self._problem(tracks)
            solution = self.slam_map.adjust(problem, self.views, tracks, rule)
            self.iterations += solution.iterations
            adjusted = AdjustedWindow(problem, solution.state, tuple(self.views), np.array(tracks, dtype=np.int64))
            if self.gate is None or rounds + 1 == MAX_ROUNDS or not self.gate.reject_outliers(adjusted):
                break
        return adjusted

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Tell where the landmarks in view will be in the next frame."""
        return predict_from_window(self.slam_map, self.views[-1], frame, self.adjusted) if self.views else None

    def _begin(self) -> FrameEstimate:
        """Place the first view, and its landmarks provisionally at the measured distance."""
        self.slam_map.positions_m[0] = self.first_m.copy()
        estimate = self.slam_map.first_estimate(self.first_covariance_m2)
        if self._first_is_free():
            self.prior = QuadraticPrior.of_first_position(self.first_m, self.first_covariance_m2)
        return estimate

    def _first_is_free(self) -> bool:
        return bool(np.any(self.first_covariance_m2))

    def _check_connected(self, number: int) -> None:
        shared = (self.slam_map if self.gate is None else self.gate).shared(number - 1, number)
        check_connected(shared, self.options.connectivity)

    def _map(self) -> list[int]:
        """List the landmarks that the window determines, sorted; those without an estimate get one."""
        seen = self.slam_map.seen_by(self.views)
        ranged = {item.track for view in self.views for item in self.slam_map.frames[view].ranges}
        joined = set() if self.prior is None else set(self.prior.points.tolist())
        determined = {
            track for track, by in seen.items() if track not in self.absorbed and (len(by) >= 2 or track in ranged)
        }
        tracks = sorted(determined | joined)  # also those of the prior whose pixels are all refused
        self.slam_map.triangulate_new(tracks, seen)
        return tracks

    def _problem(self, tracks: list[int]) -> Adjustment:
        free_views = np.ones(len(self.views), dtype=np.bool_)
        free_views[0] = self.views[0] != 0 or self._first_is_free()
        return Adjustment(
            camera=self.slam_map.camera,
            R_cam_body=self.slam_map.attitudes(self.views),
            pixels=self.slam_map.pixels(self.views, tracks),
            free_views=free_views,
            free_points=np.ones(len(tracks), dtype=np.bool_),
            distances=self.slam_map.distances(self.views, tracks),
            motions=self.slam_map.motions(self.views) if self.options.motion else Motions(),
            prior=self._local_prior(tracks),
            frozen=self._frozen(tracks),
        )

    def _local_prior(self, tracks: list[int]) -> QuadraticPrior | None:
        """Return the prior with its variables numbered as the problem does."""
        if self.prior is None:
            return None
        return replace(self.prior, views=lookup(self.views, self.prior.views), points=lookup(tracks, self.prior.points))

    def _frozen(self, tracks: list[int]) -> State | None:
        """Tell where derivatives by the variables of the prior are taken."""
        if not self.options.first_estimates:
            return None
        return State(values_or_nan(self.first_positions_m, self.views), values_or_nan(self.first_points_m, tracks))

    def _estimate(self, problem: Adjustment, state: State, tracks: list[int]) -> FrameEstimate:
        try:
            covariance = view_covariance(problem, state, len(self.views) - 1)
        except np.linalg.LinAlgError as error:
            raise LostError("the scale is unobservable: the reduced system has not full rank") from error
        position = state.positions_m[-1]
        check_scale(covariance, state.points_m, position, self.options.uncertainty_max)
        return FrameEstimate(position, covariance, np.array(tracks, dtype=np.int64), state.points_m, 0.0)

    def _marginalise(self, problem: Adjustment, state: State, tracks: Sequence[int]) -> None:
        """Drop the oldest view, and the landmarks that it saw and that are lost; keep what they tell."""
        number = np.array(tracks, dtype=np.int64)
        oldest = self.slam_map.in_view(self.views[0], tracks)
        if problem.prior is not None:
            oldest[problem.prior.points] = True
        newest = self.slam_map.frames if self.gate is None else self.gate.raw_frames
        lost = oldest & ~np.isin(number, newest[self.views[-1]].tracks)
        excess = self._beyond_prior_size(number, oldest & ~lost)
        try:
            local = marginalise_view(problem, state, 0, lost | excess)
        except np.linalg.LinAlgError as error:
            raise LostError("the scale is unobservable: the oldest view is not determined") from error
        old = np.zeros(0, dtype=np.int64) if self.prior is None else self.prior.points
        self.prior = replace(local, views=np.array(self.views)[local.views], points=number[local.points])
        if self.gate is not None:
            self.prior = _with_weak_lines(
                self.prior, lookup(old.tolist(), self.prior.points) < 0, self.slam_map.median_depth(self.views[-1])
            )
        self.widest_prior = max(self.widest_prior, len(local.origin_m))
        for view, position in zip(self.prior.views.tolist(), state.positions_m[local.views], strict=True):
            self.first_positions_m.setdefault(view, position)
        for track, point in zip(self.prior.points.tolist(), state.points_m[local.points], strict=True):
            self.first_points_m.setdefault(track, point)
        self.absorbed |= set(number[lost].tolist())
        del self.slam_map.frames[self.views[0]]
        if self.gate is not None:
            self.gate.drop_view(self.views[0])
        self.views = self.views[1:]
        self._forget_measurements(number[excess])

    def _beyond_prior_size(self, number: IndexArray, staying: BoolArray) -> BoolArray:
        """(L,) landmarks that the prior has no room for: those of the prior stay until they are lost.

        A dense prior costs the cube of its size. What the window saw of such a landmark is marginalised with it, and so
        joins the views that saw it; what is seen of it from now on counts as another landmark's. Each measurement is
        used once and none twice, so that the covariance stays honest: what is given up is that both are one landmark.
        That costs: with 100 landmarks a frame, of which the prior would hold about 40, room for 30 made the error 1.4
        times as large (10 sequences).
        """
        beyond = staying.copy()
        old = set() if self.prior is None else set(self.prior.points.tolist())
        order = sorted(np.flatnonzero(staying).tolist(), key=lambda j: (number[j] not in old, number[j]))
        beyond[order[: self.options.prior_landmarks]] = False
        return beyond

    def _forget_measurements(self, tracks: IndexArray) -> None:
        """Forget what the window saw of ``tracks``: the prior knows it."""
        gone = set(tracks.tolist())
        for view in self.views if gone else ():
            self.slam_map.frames[view] = without_tracks(self.slam_map.frames[view], gone)
            if self.gate is not None:
                self.gate.drop_tracks(view, gone)
        for track in gone:
            self.first_points_m.pop(track, None)


def _with_weak_lines(prior: QuadraticPrior, new: BoolArray, depth_m: float) -> QuadraticPrior:
    """Hold landmarks that are new in a prior at their line from its first view, to within ten times their distance.

    It may know one from a single bearing, and the pixels that would tell its distance may be refused later on. A line
    and not a place is held, since nothing tells where all of it is.
    """
    if len(prior.views) == 0 or not new.any():
        return prior
    weight = 1.0 / (_WEAK_RATIO * depth_m) ** 2
    information, view = prior.information.copy(), np.arange(3)
    for point in (len(prior.views) + np.flatnonzero(new)).tolist():
        own = 3 * point + view
        information[own, own] += weight
        information[view, view] += weight
        information[own, view] -= weight
        information[view, own] -= weight
    return replace(prior, information=information)
