"""BA-SLAM of Delpech et al. (2015), section 3.2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from estimators.options import parse_options
from estimators.slam.contract import FrameEstimate, SequenceEstimate
from estimators.slam.following import LostError, follow
from estimators.slam.keyframes import (
    Gauge,
    estimated_anew,
    gauge_rows,
    handed_over,
    measured_gauge,
    offset_views,
    trailing_views,
)
from estimators.slam.motion_filter import Propagator
from estimators.slam.options import BundleOptions
from estimators.slam.outliers import MOST_ROUNDS, Jury
from estimators.slam.prediction import foreseen_by_window
from estimators.slam.problem import Adjusted, Adjustment, State
from estimators.slam.slam_map import Journal
from estimators.slam.solver import StoppingRule, minimise, reduced_rank_deficiency
from scenarios.tracks import Prediction, TrackFrame, TrackSequence

FloatArray = NDArray[np.float64]

_MOST_PLACED = 2
"""Frames in a row that are placed without an adjustment of the window, before it counts as lost."""


class BundleSlam:
    """Sequential bundle adjustment over a window of views; positions alone are free, since the attitude is known.

    The oldest view of the window stays where it was estimated last. A range that is measured on the way takes the
    place of the gauge in the adjustment of its view, and the gauge goes on with the distance that it then has. There
    is no covariance: the window does not know the error of what it is fixed to.

    With ``connected: last-two`` it does not ask whether anything determines its scale, as the paper does not: an
    undetermined one stays where the predicted motion put it. With ``connected: whole-window`` such a sequence fails.
    """

    name: ClassVar[str] = "ba-slam"
    version: ClassVar[int] = 5

    def __init__(self, options: BundleOptions) -> None:
        self.options = options

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one."""
        return cls(parse_options(BundleOptions, options, cls.name))

    def follow(self, sequence: TrackSequence) -> SequenceEstimate:
        """Estimate the camera position at every frame from the frames up to it."""
        return follow(sequence, _Window(sequence, self.options))


class _Window:
    """The window at work on one sequence."""

    def __init__(self, sequence: TrackSequence, options: BundleOptions) -> None:
        self.options = options
        self.journal = Journal(sequence.camera)
        self.first_m = sequence.position_m
        self.propagator = Propagator(sequence, options) if options.motion == "constant-gain" else None
        self.trailing: list[int] = []
        self.gauge: Gauge | None = None
        self.jury = Jury(self.journal, options.false_alarm) if options.associations == "consensus" else None
        self.adjusted: Adjusted | None = None
        self.placed_alone = 0
        self.handovers = 0
        self.shifts = 0
        self.iterations = 0

    def diagnostics(self) -> dict[str, float]:
        frames = max(len(self.journal.frames) - 1, 1)
        return {
            "gauge_handovers": float(self.handovers),
            "window_shifts": float(self.shifts),
            "iterations_per_frame": self.iterations / frames,
            **({} if self.jury is None else {"refused_pixels": float(self.jury.ever)}),
        }

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        number = len(self.journal.frames)
        if self.propagator is not None:
            frame = self.propagator.predict(frame)
        self.journal.frames[number] = frame
        if self.jury is not None:
            self.jury.admit(number, frame)
        estimate = self._begin(frame) if number == 0 else self._follow(number)
        if self.propagator is None:
            return estimate
        return replace(estimate, velocity_m_s=self.propagator.correct(estimate.position_m))

    def predict(self, frame: TrackFrame) -> Prediction | None:
        """Tell where the landmarks in view will be in the next frame, by the covariance of the window's adjustment."""
        last = len(self.journal.frames) - 1
        return foreseen_by_window(self.journal, last, frame, self.adjusted) if last >= 0 else None

    def _follow(self, number: int) -> FrameEstimate:
        depth = self.journal.median_depth(number - 1)
        rule = StoppingRule(self.options.tolerance * depth, self.options.iterations)
        if self.jury is None:
            self.journal.place(number, rule)
        else:
            self.jury.place(number, self.adjusted, rule, depth)
        placed_m, guessed = self.journal.positions_m[number], set(self.journal.guessed)
        views = self._window(number)
        try:
            self.adjusted = self._adjusted(views, rule)
            if self.options.connected == "whole-window":
                self._check_rank(self.adjusted.problem, self.adjusted.state)
        except LostError:
            if not self._robbed(number):
                raise
            self.journal.guessed |= guessed
            return self._placed(number, placed_m)
        self.placed_alone = 0
        tracks = self.adjusted.tracks.tolist()
        if len(self.journal.distances(views[-1:], tracks).view):
            self.gauge = estimated_anew(self.journal, self._gauge(), self.options.gauge_sigma_m)
        points = np.array([self.journal.points_m[track] for track in tracks])
        return FrameEstimate(self.journal.positions_m[number], None, np.array(tracks, dtype=np.int64), points, 0.0)

    def _robbed(self, number: int) -> bool:
        """Tell whether a window that cannot be adjusted could be, had no pixel of its newest frame been refused."""
        jury = self.jury
        return jury is not None and bool(jury.refused.get(number)) and self.placed_alone < _MOST_PLACED

    def _placed(self, number: int, position_m: FloatArray) -> FrameEstimate:
        """Leave a view where its predicted motion and the map put it: the next frames may hold the scale again."""
        self.placed_alone += 1
        self.adjusted = None
        self.journal.positions_m[number] = position_m
        tracks = sorted(set(self.journal.frames[number].tracks.tolist()) & self.journal.points_m.keys())
        points = self.journal.state((), tracks).points_m
        return FrameEstimate(position_m, None, np.array(tracks, dtype=np.int64), points, 0.0)

    def _adjusted(self, views: list[int], rule: StoppingRule) -> Adjusted:
        """Adjust the window, again as long as what is left of a pixel is too much."""
        for rounds in range(MOST_ROUNDS):
            seen = self.journal.seen_by(views)
            self._hold_the_scale(views, seen)
            tracks = self._map(seen)
            problem = self._problem(views, tracks)
            if self.options.steps == "motion-structure-full":
                self._adjust(replace(problem, free_views=np.zeros_like(problem.free_views)), views, tracks, rule)
            state = self._adjust(problem, views, tracks, rule)
            adjusted = Adjusted(problem, state, tuple(views), np.array(tracks, dtype=np.int64))
            if self.jury is None or rounds + 1 == MOST_ROUNDS or not self.jury.object(adjusted):
                break
        return adjusted

    def _begin(self, frame: TrackFrame) -> FrameEstimate:
        """Place the first view, and all landmarks provisionally at the distance of the gauge."""
        journal = self.journal
        journal.positions_m[0] = self.first_m.copy()
        self.gauge = measured_gauge(journal, 0)
        if self.gauge.track not in frame.tracks:
            raise LostError(f"the range is to track {self.gauge.track}, which is not in view")
        self.trailing = [0]
        journal.guess(0, self.gauge.range_m)
        tracks = np.array([self.gauge.track], dtype=np.int64)
        return FrameEstimate(self.first_m.copy(), None, tracks, journal.points_m[self.gauge.track][None], 0.0)

    def _window(self, lead: int) -> list[int]:
        """Choose the views of the window for a new leading one, which comes last."""
        before = self.trailing
        tracks = self.journal if self.jury is None else self.jury  # a frame that lost pixels for once must not shift it
        choose = trailing_views(self.journal, tracks, before, lead, self.options)
        if self.options.strategy == "offset":
            choose = offset_views(tracks, lead, self.options)
        self.trailing = choose
        self.shifts += int(choose[0] != before[0])
        return [*choose, lead]

    def _hold_the_scale(self, views: list[int], seen: dict[int, list[int]]) -> None:
        """Let the gauge go over to another landmark if it must."""
        gauge = handed_over(self.journal, self._gauge(), views, seen, self.options)
        self.handovers += int(gauge != self.gauge)
        self.gauge = gauge

    def _map(self, seen: dict[int, list[int]]) -> list[int]:
        """List the landmarks seen by two views or more, sorted; those without an estimate get one."""
        tracks = sorted(track for track, by in seen.items() if len(by) >= 2)
        self.journal.triangulate_new(tracks, seen)
        if len(tracks) < self.options.connectivity:
            raise LostError(f"tracks are lost: {len(tracks)} landmarks are seen twice in the window")
        return tracks

    def _problem(self, views: list[int], tracks: list[int]) -> Adjustment:
        """Return the full adjustment, with the gauge."""
        return Adjustment(
            camera=self.journal.camera,
            R_cam_body=self.journal.attitudes(views),
            sightings=self.journal.sightings(views, tracks),
            free_views=np.arange(len(views)) > 0,
            free_points=np.ones(len(tracks), dtype=np.bool_),
            distances=gauge_rows(self.journal, self._gauge(), views, tracks),
        )

    def _adjust(self, problem: Adjustment, views: list[int], tracks: list[int], rule: StoppingRule) -> State:
        """Structure-only or full adjustment."""
        solution = minimise(problem, self.journal.state(views, tracks), rule)
        self.iterations += solution.iterations
        if not np.isfinite(solution.cost):
            raise LostError("a landmark is behind a camera that sees it")
        self.journal.keep(solution.state, views, tracks)
        return solution.state

    def _check_rank(self, problem: Adjustment, state: State) -> None:
        if reduced_rank_deficiency(problem, state):
            raise LostError("the scale is unobservable: the reduced system has not full rank")

    def _gauge(self) -> Gauge:
        if self.gauge is None:
            raise LostError("there is no depth gauge")
        return self.gauge
