"""BA-SLAM of Delpech et al. (2015), section 3.2."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Adjustment, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule, reduced_rank_deficiency
from boresight.estimators.slam.association.outliers import MAX_ROUNDS, OutlierGate
from boresight.estimators.slam.association.prediction import predict_from_window
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.estimators.slam.following import ConfiguredEstimator, Follower
from boresight.estimators.slam.keyframes.keyframes import (
    DepthGauge,
    gauge_distances,
    hand_over_gauge,
    measure_gauge,
    offset_views,
    reestimate_gauge,
    trailing_views,
)
from boresight.estimators.slam.keyframes.motion_filter import Propagator
from boresight.estimators.slam.options import BundleOptions
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.tracks import Prediction, TrackFrame, TrackSequence

_MAX_PLACED = 2
"""Consecutive frames at most that may be placed without an adjustment of the window."""


class BundleSlam(ConfiguredEstimator[BundleOptions]):
    """Sequential bundle adjustment over a sliding window of views: BA-SLAM of Delpech et al. (2015).

    The attitude is known, so only positions and landmarks are adjusted. The oldest view of the window is fixed at its
    last estimate, and the distance of one landmark, the depth gauge, fixes the scale. A range measured at the leading
    view replaces the gauge in its adjustment, and the gauge continues with the distance estimated there. There is no
    covariance, since the error of the fixed view and of the gauge is not modelled.

    With ``connected: last-two`` the rank is not checked, as in the paper: an undetermined scale stays as the predicted
    motion gave it. With ``connected: whole-window`` such a sequence fails.

    Use it when
    -----------
    The method of the paper is wanted. Otherwise use ``fixed-lag``, which has smaller errors and a covariance on the
    same tracks.

    It fails when
    -------------
    No range is measured at the first frame, its landmark is lost before another takes the gauge over, or too few
    landmarks are seen twice in the window. In ``delpech2015-comparison`` 83 of 100 runs of 10 landmarks a frame ended,
    89 of 100 of 15 and of 20. The error of the scale is handed on and grows.

    Cost
    ----
    0.10 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Delpech et al. (2015), section 3.2.
    """

    name: ClassVar[str] = "ba-slam"
    version: ClassVar[int] = 7
    options_model = BundleOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return _Window(sequence, self.options)


class _Window:
    """Sliding window of BA-SLAM on one sequence."""

    def __init__(self, sequence: TrackSequence, options: BundleOptions) -> None:
        self.options = options
        self.slam_map = SlamMap(sequence.camera)
        self.first_m = sequence.position_m
        self.propagator = Propagator(sequence, options) if options.motion == "constant-gain" else None
        self.trailing: list[int] = []
        self.gauge: DepthGauge | None = None
        self.gate = OutlierGate(self.slam_map, options.false_alarm) if options.associations == "consensus" else None
        self.adjusted: AdjustedWindow | None = None
        self.placed_alone = 0
        self.handovers = 0
        self.shifts = 0
        self.iterations = 0

    def diagnostics(self) -> dict[str, float]:
        frames = max(len(self.slam_map.frames) - 1, 1)
        return {
            "gauge_handovers": float(self.handovers),
            "window_shifts": float(self.shifts),
            "iterations_per_frame": self.iterations / frames,
            **({} if self.gate is None else {"refused_pixels": float(self.gate.refused_count)}),
        }

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        number = len(self.slam_map.frames)
        # The paper's option of a dynamic model: the prediction of the propagator replaces the given displacement.
        if self.propagator is not None:
            frame = self.propagator.predict(frame)
        self.slam_map.frames[number] = frame
        if self.gate is not None:
            self.gate.add_frame(number, frame)
        estimate = self._begin(frame) if number == 0 else self._follow(number)
        if self.propagator is None:
            return estimate
        return replace(estimate, velocity_m_s=self.propagator.correct(estimate.position_m))

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Predict the pixels of the landmarks of the last frame in the next one, with the window's covariance."""
        last = len(self.slam_map.frames) - 1
        return predict_from_window(self.slam_map, last, frame, self.adjusted) if last >= 0 else None

    def _follow(self, number: int) -> FrameEstimate:
        # The tolerance scales with the distance: the same angle, about the same part of a pixel, at any range.
        depth = self.slam_map.median_depth(number - 1)
        rule = StoppingRule(self.options.tolerance * depth, self.options.iterations)
        # Step 1 of the paper, motion only.
        if self.gate is None:
            self.slam_map.place(number, rule)
        else:
            self.gate.place(number, self.adjusted, rule, depth)
        # Kept for the case that the adjustment of the window fails.
        placed_m, guessed = self.slam_map.positions_m[number], set(self.slam_map.guessed)
        views = self._window(number)
        try:
            self.adjusted = self._adjusted(views, rule)
            if self.options.connected == "whole-window":
                self._check_rank(self.adjusted.problem, self.adjusted.state)
        except LostError:
            if not self._lost_by_refusals(number):
                raise
            self.slam_map.guessed |= guessed
            return self._place_only(number, placed_m)
        self.placed_alone = 0
        tracks = self.adjusted.tracks.tolist()
        # A range at the leading view has fixed the scale of this window. The gauge goes on with the distance that it
        # has in this solution, so that the next window has the same scale.
        if len(self.slam_map.distances(views[-1:], tracks).view):
            self.gauge = reestimate_gauge(self.slam_map, self._gauge(), self.options.gauge_sigma_m)
        points = np.array([self.slam_map.points_m[track] for track in tracks])
        return FrameEstimate(self.slam_map.positions_m[number], None, np.array(tracks, dtype=np.int64), points, 0.0)

    def _lost_by_refusals(self, number: int) -> bool:
        """Return whether refused pixels of the newest frame may be the reason that the window cannot be adjusted."""
        gate = self.gate
        return gate is not None and bool(gate.refused.get(number)) and self.placed_alone < _MAX_PLACED

    def _place_only(self, number: int, position_m: FloatArray) -> FrameEstimate:
        """Keep the result of the motion-only adjustment; the next frames may determine the scale again."""
        self.placed_alone += 1
        self.adjusted = None
        self.slam_map.positions_m[number] = position_m
        tracks = sorted(set(self.slam_map.frames[number].tracks.tolist()) & self.slam_map.points_m.keys())
        points = self.slam_map.state((), tracks).points_m
        return FrameEstimate(position_m, None, np.array(tracks, dtype=np.int64), points, 0.0)

    def _adjusted(self, views: list[int], rule: StoppingRule) -> AdjustedWindow:
        """Adjust the window, repeatedly while the gate rejects outliers."""
        for rounds in range(MAX_ROUNDS):
            seen = self.slam_map.seen_by(views)
            self._update_gauge(views, seen)
            tracks = self._map(seen)
            problem = self._problem(views, tracks)
            # Step 2 of the paper, structure only: all views fixed. Step 3, full, follows.
            if self.options.steps == "motion-structure-full":
                self._adjust(replace(problem, free_views=np.zeros_like(problem.free_views)), views, tracks, rule)
            state = self._adjust(problem, views, tracks, rule)
            adjusted = AdjustedWindow(problem, state, tuple(views), np.array(tracks, dtype=np.int64))
            # No refusal after the last adjustment: the estimate would have used the refused pixels.
            if self.gate is None or rounds + 1 == MAX_ROUNDS or not self.gate.reject_outliers(adjusted):
                break
        return adjusted

    def _begin(self, frame: TrackFrame) -> FrameEstimate:
        """Place the first view, and its landmarks provisionally at the distance of the gauge."""
        slam_map = self.slam_map
        # The first position is known, section 3.1. A bearing gives no distance: all landmarks start at that of the
        # gauge, on a sphere about the camera, and are marked as guessed.
        slam_map.positions_m[0] = self.first_m.copy()
        self.gauge = measure_gauge(slam_map, 0)
        if self.gauge.track not in frame.tracks:
            raise LostError(f"the range is to track {self.gauge.track}, which is not in view")
        self.trailing = [0]
        slam_map.guess(0, self.gauge.range_m)
        tracks = np.array([self.gauge.track], dtype=np.int64)
        return FrameEstimate(self.first_m.copy(), None, tracks, slam_map.points_m[self.gauge.track][None], 0.0)

    def _window(self, lead: int) -> list[int]:
        """Choose the trailing views for a new leading one; the leading view is the last of the list."""
        before = self.trailing
        # Refused pixels count, so that outliers do not shift the window.
        tracks = self.slam_map if self.gate is None else self.gate
        # The second strategy of section 3.2, which the paper uses; then the first.
        choose = trailing_views(self.slam_map, tracks, before, lead, self.options)
        if self.options.strategy == "offset":
            choose = offset_views(tracks, lead, self.options)
        self.trailing = choose
        # A new oldest view is a new reference of position and scale: each shift adds to the drift.
        self.shifts += int(choose[0] != before[0])
        return [*choose, lead]

    def _update_gauge(self, views: list[int], seen: dict[int, list[int]]) -> None:
        """Hand the depth gauge over to another landmark if necessary."""
        gauge = hand_over_gauge(self.slam_map, self._gauge(), views, seen, self.options)
        self.handovers += int(gauge != self.gauge)
        self.gauge = gauge

    def _map(self, seen: dict[int, list[int]]) -> list[int]:
        """List the tracks seen in two views or more, sorted; new ones are triangulated."""
        # One bearing leaves the distance undetermined: section 3.2 estimates landmarks that were observed in at least
        # two views.
        tracks = sorted(track for track, by in seen.items() if len(by) >= 2)
        self.slam_map.triangulate_new(tracks, seen)
        if len(tracks) < self.options.connectivity:
            raise LostError(f"tracks are lost: {len(tracks)} landmarks are seen twice in the window")
        return tracks

    def _problem(self, views: list[int], tracks: list[int]) -> Adjustment:
        """Return the full adjustment, with the depth gauge."""
        return Adjustment(
            camera=self.slam_map.camera,
            R_cam_body=self.slam_map.attitudes(views),
            pixels=self.slam_map.pixels(views, tracks),
            # Of the seven freedoms of a monocular reconstruction the known attitudes fix three; the fixed oldest view
            # fixes the translation, and the depth gauge of eq. (5) the scale.
            free_views=np.arange(len(views)) > 0,
            free_points=np.ones(len(tracks), dtype=np.bool_),
            distances=gauge_distances(self.slam_map, self._gauge(), views, tracks),
        )

    def _adjust(self, problem: Adjustment, views: list[int], tracks: list[int], rule: StoppingRule) -> State:
        """Minimise the structure-only or the full adjustment from the present estimates, and count the steps."""
        solution = self.slam_map.adjust(problem, views, tracks, rule)
        self.iterations += solution.iterations
        return solution.state

    def _check_rank(self, problem: Adjustment, state: State) -> None:
        if reduced_rank_deficiency(problem, state):
            raise LostError("the scale is unobservable: the reduced system has not full rank")

    def _gauge(self) -> DepthGauge:
        if self.gauge is None:
            raise LostError("there is no depth gauge")
        return self.gauge
