"""BA-SLAM of Delpech et al. (2015), section 3.2: the views of its window, and its depth gauge, equation (5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Distances
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule, reduced_rank_deficiency
from boresight.estimators.slam.association.outliers import OutlierGate
from boresight.estimators.slam.association.prediction import predict_from_window
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.estimators.slam.following import ConfiguredEstimator, Follower, check_connected
from boresight.estimators.slam.keyframes.motion_filter import Propagator
from boresight.estimators.slam.options import BundleOptions
from boresight.scenarios.geometry import angle_between
from boresight.scenarios.observation import Prediction, TrackFrame, TrackSequence

_MAX_PLACED = 2
"""Consecutive frames at most that may be placed without an adjustment of the window."""


@dataclass(frozen=True, slots=True)
class DepthGauge:
    """The distance of a landmark from a view, and its standard deviation, m."""

    view: int
    track: int
    range_m: float
    sigma_m: float


def gauge_distances(slam_map: SlamMap, gauge: DepthGauge, views: Sequence[int], tracks: Sequence[int]) -> Distances:
    """Return the distances that fix the scale of a window: the leading view's measured ranges, or else the gauge."""
    lead = slam_map.distances(views[-1:], tracks)
    if len(lead.view):
        # They were numbered within the one leading view; it is the last of the window.
        return replace(lead, view=lead.view + len(views) - 1)
    # The last row of eq. (5): d - d_hat(l_1, T_1, x).
    return Distances(
        np.array([views.index(gauge.view)], dtype=np.int64),
        np.array([tracks.index(gauge.track)], dtype=np.int64),
        np.array([gauge.range_m]),
        np.array([gauge.sigma_m]),
    )


def hand_over_gauge(
    slam_map: SlamMap,
    gauge: DepthGauge,
    views: Sequence[int],
    seen: Mapping[int, Sequence[int]],
    options: BundleOptions,
) -> DepthGauge:
    """Return the depth gauge of a window of ``views``, the oldest first; ``seen`` lists the views of each track.

    The old gauge stays while its view is the oldest and "as long as the connectivity with the last acquired view can be
    maintained": while the leading view sees its landmark; with ``connected: whole-window`` while any other view does.
    Otherwise it is handed over to a landmark of the oldest view, at the distance measured there, or else at the
    estimated one: of the landmarks in the leading view the one with the most views, since a gauge on a short track
    loses the scale. Raise LostError if no landmark of the oldest view has a known distance and is seen twice.
    """
    oldest, lead = views[0], views[-1]
    by = seen.get(gauge.track, ())
    # One bearing alone, as where its other pixels were refused, places no landmark that could keep the scale.
    held = len(by) >= 2 and (lead in by or options.connected == "whole-window")
    if gauge.view == oldest and held:
        return gauge
    measured = {item.track: item for item in slam_map.frames[oldest].ranges}
    # A guessed distance must not become the scale.
    known = measured.keys() | (slam_map.points_m.keys() - slam_map.guessed)
    candidates = [
        track
        for track in slam_map.frames[oldest].tracks.tolist()
        # A landmark of the oldest view and one other would connect the scale with that view alone, unless it is the
        # leading one.
        if track in known and len(seen[track]) >= 2 and (lead in seen[track] or len(seen[track]) > 2)
    ]
    if not candidates:
        raise LostError("no landmark can take the depth gauge over: the scale is unobservable")
    best = min(candidates, key=lambda track: (track not in measured, lead not in seen[track], -len(seen[track]), track))
    if best in measured:
        return DepthGauge(oldest, best, measured[best].range_m, measured[best].sigma_m)
    # The estimated distance has an error, which biases the scale until the next handover (section 3.2: drift like a
    # random walk).
    distance = float(np.linalg.norm(slam_map.points_m[best] - slam_map.positions_m[oldest]))
    return DepthGauge(oldest, best, distance, options.gauge_sigma_m)


class SharedLandmarks(Protocol):
    """Count of landmarks that two frames share: that of a `SlamMap`, or of an `OutlierGate` with refused pixels."""

    def shared(self, first: int, second: int) -> int:
        """Count the landmarks that two views share."""
        ...


def trailing_views(
    slam_map: SlamMap, tracks: SharedLandmarks, trailing: Sequence[int], lead: int, options: BundleOptions
) -> list[int]:
    """Second strategy: the trailing views stay while they are connected with the leading one.

    The paper shifts the window "when the distance between the two last frames cannot ensure a proper landmark
    connectivity": the oldest view is dropped, and the leading view of the step before becomes the last of the trailing
    ones. "The window size gets reduced before growing again": the oldest views of the shifted window that share too few
    landmarks with the leading one are dropped, since the gauge of the oldest view is valid only "as long as the
    connectivity with the last acquired view can be maintained". With ``connected: whole-window``, which is not the
    paper's, the window is shifted as soon as the leading view is no longer connected with the oldest one.

    While the window grows, which the paper does not detail, views are added at equal ratios of shared landmarks, so
    that the full window spans just the connectivity. Raise LostError if the leading view shares too few landmarks with
    every trailing view and with the frame before.
    """
    views = list(trailing)
    if len(views) < options.views - 1:
        held = tracks.shared(views[-1], views[-1])
        # The first and the leading view of a full window, views - 1 steps apart, then share just the connectivity.
        share = (options.connectivity / held) ** (1.0 / (options.views - 1))
        near = tracks.shared(views[-1], lead) >= share * held
        grown = views if near or views[-1] == lead - 1 else [*views, lead - 1]
        return _connected_part(tracks, grown, lead, options)
    # Shared landmarks are counted with the last trailing view, as in the paper, or with the oldest; the angle of table
    # 2 is between consecutive views, so with the last one in both cases.
    base = views[-1] if options.connected == "last-two" else views[0]
    angle = angle_between(slam_map.positions_m[views[-1]], slam_map.positions_m[lead])
    if tracks.shared(base, lead) >= options.connectivity and angle <= np.radians(options.angle_max_deg):
        return views
    # The shift of section 3.2: T1 := T2, T2 := T3, T3 := T4, where T4 was the leading view of the step before.
    return _connected_part(tracks, [*views[1:], lead - 1] if views[-1] != lead - 1 else views[1:], lead, options)


def offset_views(tracks: SharedLandmarks, lead: int, options: BundleOptions) -> list[int]:
    """First strategy: a constant offset, counted in frames, between the views; fewer at the beginning."""
    # The paper's offset is an angle; frames of equal anomaly steps (section 4) make it a number of frames.
    back = [lead - options.offset_frames * step for step in range(1, options.views)]
    views = sorted(view for view in back if view >= 0) or [0]
    return _connected_part(tracks, views, lead, options)


def _connected_part(tracks: SharedLandmarks, views: list[int], lead: int, options: BundleOptions) -> list[int]:
    """Drop the oldest views until the leading one is connected with the first remaining one."""
    while views and tracks.shared(views[0], lead) < options.connectivity:
        views = views[1:]
    if views:
        return views
    # No trailing view is connected: start again from the frame before, which is the best connected one.
    check_connected(tracks.shared(lead - 1, lead), options.connectivity)
    return [lead - 1]


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
    89 of 100 of 15 and of 20. The error of the scale is handed on and grows. Errors that add up along a track
    (``walk_px``, ``contraction`` and ``drift_px`` of ``sequence.knowledge``) are not modelled.

    Cost
    ----
    0.10 s a revolution of ``apophis-sphere-sequence`` (181 frames).

    Source
    ------
    Delpech et al. (2015), section 3.2.
    """

    name: ClassVar[str] = "ba-slam"
    version: ClassVar[int] = 8
    options_model = BundleOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return _Window(sequence, self.options)


class _Window:
    """Sliding window of BA-SLAM on one sequence."""

    gauge: DepthGauge

    def __init__(self, sequence: TrackSequence, options: BundleOptions) -> None:
        self.options = options
        self.slam_map = SlamMap(sequence.camera)
        self.first_m = sequence.position_m
        self.propagator = Propagator(sequence, options) if options.motion == "constant-gain" else None
        self.trailing = [0]
        self.gate = OutlierGate(self.slam_map, options)
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
            **self.gate.diagnostics(),
        }

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        number = len(self.slam_map.frames)
        # The paper's option of a dynamic model: the prediction of the propagator replaces the given displacement.
        if self.propagator is not None:
            frame = self.propagator.predict(frame)
        self.gate.add_frame(number, frame)
        estimate = self._begin(frame) if number == 0 else self._follow(number)
        if self.propagator is None:
            return estimate
        return replace(estimate, velocity_m_s=self.propagator.correct(estimate.position_m))

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Predict the pixels of the landmarks of the last frame in the next one, with the window's covariance."""
        last = len(self.slam_map.frames) - 1
        return predict_from_window(self.slam_map, last, frame, self.adjusted) if last >= 0 else None

    def _begin(self, frame: TrackFrame) -> FrameEstimate:
        """Place the first view, and its landmarks provisionally at the distance of the gauge."""
        slam_map = self.slam_map
        # The first position is known, section 3.1. A bearing gives no distance: all landmarks start at that of the
        # gauge, on a sphere about the camera, and are marked as guessed.
        slam_map.positions_m[0] = self.first_m.copy()
        if not frame.ranges:
            raise LostError("no range is measured at the first frame: the scale is unobservable")
        # The range with the smallest error; the track decides between equal errors, so that the choice does not depend
        # on the order of the ranges.
        best = min(frame.ranges, key=lambda item: (item.sigma_m, item.track))
        if best.track not in frame.tracks:
            raise LostError(f"the range is to track {best.track}, which is not in view")
        self.gauge = DepthGauge(0, best.track, best.range_m, best.sigma_m)
        slam_map.guess(0, best.range_m)
        tracks = np.array([best.track], dtype=np.int64)
        return FrameEstimate(self.first_m.copy(), None, tracks, slam_map.points_m[best.track][None], 0.0)

    def _follow(self, number: int) -> FrameEstimate:
        """Run the three steps of section 3.2 on a new leading view."""
        slam_map, gate = self.slam_map, self.gate
        # The tolerance scales with the distance: the same angle, about the same part of a pixel, at any range.
        depth = slam_map.median_depth(number - 1)
        rule = StoppingRule(self.options.tolerance * depth, self.options.iterations)
        # Step 1 of the paper, motion only.
        gate.place(number, self.adjusted, rule, depth)
        # Kept for the case that the adjustment of the window fails.
        placed_m, guessed = slam_map.positions_m[number], set(slam_map.guessed)
        views = self._choose_views(number)
        try:
            adjusted = self.adjusted = self._adjust(views, rule)
        except LostError:
            # Refused pixels of the newest frame may be the reason that the window cannot be adjusted. Then the result
            # of the motion-only adjustment is kept; the next frames may determine the scale again.
            if not gate.refused.get(number) or self.placed_alone >= _MAX_PLACED:
                raise
            self.placed_alone += 1
            self.adjusted = None
            slam_map.guessed |= guessed
            slam_map.positions_m[number] = placed_m
            tracks = sorted(set(slam_map.frames[number].tracks.tolist()) & slam_map.points_m.keys())
        else:
            self.placed_alone = 0
            tracks = adjusted.tracks.tolist()
            # A range at the leading view has fixed the scale of this window. The gauge goes on with the distance that
            # it has in this solution, so that the next window has the same scale.
            if len(slam_map.distances(views[-1:], tracks).view):
                distance = slam_map.points_m[self.gauge.track] - slam_map.positions_m[self.gauge.view]
                self.gauge = replace(
                    self.gauge, range_m=float(np.linalg.norm(distance)), sigma_m=self.options.gauge_sigma_m
                )
        points = slam_map.state((), tracks).points_m
        return FrameEstimate(slam_map.positions_m[number], None, np.array(tracks, dtype=np.int64), points, 0.0)

    def _choose_views(self, lead: int) -> list[int]:
        """Choose the trailing views for a new leading one; the leading view is the last of the list."""
        before = self.trailing
        # The second strategy of section 3.2, which the paper uses; then the first. Outliers do not shift the window.
        choose = trailing_views(self.slam_map, self.gate, before, lead, self.options)
        if self.options.strategy == "offset":
            choose = offset_views(self.gate, lead, self.options)
        self.trailing = choose
        # A new oldest view is a new reference of position and scale: each shift adds to the drift.
        self.shifts += int(choose[0] != before[0])
        return [*choose, lead]

    def _adjust(self, views: list[int], rule: StoppingRule) -> AdjustedWindow:
        """Adjust the window, repeatedly while the gate rejects outliers."""
        adjusted = self.gate.adjust(lambda: self._adjust_once(views, rule))
        whole = self.options.connected == "whole-window"
        if whole and reduced_rank_deficiency(adjusted.problem, adjusted.state):
            raise LostError("the scale is unobservable: the reduced system has not full rank")
        return adjusted

    def _adjust_once(self, views: list[int], rule: StoppingRule) -> AdjustedWindow:
        """Adjust the window and the landmarks that two of its views or more see, new ones triangulated before."""
        slam_map, seen = self.slam_map, self.slam_map.seen_by(views)
        gauge = hand_over_gauge(slam_map, self.gauge, views, seen, self.options)
        self.handovers += int(gauge != self.gauge)
        self.gauge = gauge
        # One bearing leaves the distance undetermined: section 3.2 estimates landmarks that were observed in at least
        # two views.
        tracks = sorted(track for track, by in seen.items() if len(by) >= 2)
        slam_map.triangulate_new(tracks, seen)
        if len(tracks) < self.options.connectivity:
            raise LostError(f"tracks are lost: {len(tracks)} landmarks are seen twice in the window")
        problem = replace(
            slam_map.problem(views, tracks),
            # Of the seven freedoms of a monocular reconstruction the known attitudes fix three; the fixed oldest view
            # fixes the translation, and the depth gauge of eq. (5) the scale.
            free_views=np.arange(len(views)) > 0,
            distances=gauge_distances(slam_map, gauge, views, tracks),
        )
        # Step 2 of the paper, structure only: all views fixed.
        if self.options.steps == "motion-structure-full":
            structure = replace(problem, free_views=np.zeros_like(problem.free_views))
            self.iterations += slam_map.adjust(structure, views, tracks, rule).iterations
        # Step 3, full.
        solution = slam_map.adjust(problem, views, tracks, rule)
        self.iterations += solution.iterations
        return AdjustedWindow(problem, solution.state, tuple(views), np.array(tracks, dtype=np.int64))
