"""Fixed-lag smoother with loop closure: merges recognised landmarks and adjusts all frames at loop closures."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy.special import gammaincinv

from boresight.estimators.slam.adjustment.marginal import Retained, landmark_covariance, marginalise_outside
from boresight.estimators.slam.adjustment.problem import Adjustment, State
from boresight.estimators.slam.adjustment.slam_map import lookup
from boresight.estimators.slam.adjustment.solver import StoppingRule
from boresight.estimators.slam.association.outliers import without_tracks
from boresight.estimators.slam.contract import FrameEstimate, LostError
from boresight.estimators.slam.following import ConfiguredEstimator, Follower
from boresight.estimators.slam.options import LoopOptions
from boresight.estimators.slam.smoothing.loop_history import GlobalMap
from boresight.estimators.slam.smoothing.smoother import WindowSmoother
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.tracks import TrackFrame, TrackSequence

_SAME_PLACE_M = 1e-3
"""Standard deviation, m, to which the two landmarks of a pair are the same point; keeps the covariances invertible."""


def compatible_pairs(differences_m: FloatArray, covariance_m2: FloatArray, probability: float) -> list[int]:
    """List the largest jointly compatible set of pairs.

    A correct pair is one landmark estimated twice: the difference is an error, most of it common to all pairs, the
    drift of the path. Each pair that passes its own chi-square test (3 degrees of freedom) starts a set. The pair with
    the smallest chi-square given the set is added and conditions the others, until none passes. This is a greedy
    version of joint compatibility branch and bound (Neira and Tardos 2001), which searches a tree.

    Parameters
    ----------
    differences_m
        (k, 3) difference of the two estimates of each pair.
    covariance_m2
        (3 k, 3 k) joint covariance of the differences.
    probability
        Probability that a correct pair passes the test.
    """
    gate = 2.0 * float(gammaincinv(1.5, probability))  # the quantile of chi-square of 3 degrees of freedom
    best: tuple[int, float] = (0, 0.0)
    found: list[int] = []
    for seed in range(len(differences_m)):
        if seed in found:  # it would grow into the same set
            continue
        members, total = _grown(seed, differences_m.ravel(), covariance_m2, gate)
        if (len(members), -total) > best:
            best, found = (len(members), -total), members
    return sorted(found)


def _grown(seed: int, difference: FloatArray, covariance: FloatArray, gate: float) -> tuple[list[int], float]:
    """Grow a set from one pair; return it with its joint chi-square, empty if the pair fails its own test."""
    members: list[int] = []
    total, candidate = 0.0, seed
    squares = _squares(difference, covariance)
    while squares[candidate] <= gate:
        members.append(candidate)
        total += float(squares[candidate])
        difference, covariance = _given(candidate, difference, covariance)
        squares = _squares(difference, covariance)
        # Members are not candidates again. The conditional chi-squares of a chain add up to the joint one.
        squares[members] = np.inf
        candidate = int(np.argmin(squares))
    return members, total


def _squares(difference: FloatArray, covariance: FloatArray) -> FloatArray:
    """(k,) squared Mahalanobis distances of the pairs, one by one."""
    count = len(difference) // 3
    rows = np.arange(count)
    blocks = covariance.reshape(count, 3, count, 3)[rows, :, rows] + _SAME_PLACE_M**2 * np.eye(3)
    parts = difference.reshape(count, 3)
    return np.asarray(np.einsum("ki,ki->k", parts, np.linalg.solve(blocks, parts[:, :, None])[:, :, 0]))


def _given(pair: int, difference: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Condition the differences and their covariance on one pair being a single landmark."""
    # A Kalman update by the measurement "the difference of this pair is zero": what remains of the other differences is
    # what the drift common to all does not explain.
    rows = slice(3 * pair, 3 * pair + 3)
    block = covariance[rows, rows] + _SAME_PLACE_M**2 * np.eye(3)
    gain = np.linalg.solve(block, covariance[rows]).T
    return difference - gain @ difference[rows], covariance - gain @ covariance[rows]


class LoopSmoother(ConfiguredEstimator[LoopOptions]):
    """``fixed-lag`` that adjusts all frames when enough lost landmarks have been recognised again.

    Pairs of tracks that the vision layer recognises as one landmark are tested together against the covariance of the
    drift. Compatible pairs are merged, all frames are adjusted, and the measurements outside the window are
    marginalised to its new prior: every measurement is used once, and the covariance contains the loop closure.

    Use it when
    -----------
    Landmarks are seen again after a revolution and recognised (``sequence.vision.recognised``): in ``apophis-loops``
    the mean position error is 0.58 m, where that of ``fixed-lag`` is 4.06 m (20 runs).

    It fails when
    -------------
    As ``fixed-lag``; or the history of all frames is not determined at a loop closure. Where nothing is recognised it
    is ``fixed-lag``.

    Cost
    ----
    0.28 s a revolution of ``apophis-sphere-sequence`` (181 frames, without a loop closure).

    Source
    ------
    Ours. Joint compatibility: a greedy version of Neira and Tardos (2001).
    """

    name: ClassVar[str] = "loop-smoother"
    version: ClassVar[int] = 3
    options_model = LoopOptions

    def follower(self, sequence: TrackSequence) -> Follower:
        """Return the estimator at work on one sequence."""
        return _LoopClosingWindow(sequence, self.options)


class _LoopClosingWindow(WindowSmoother):
    """Window on one sequence, with the map of all frames.

    Attributes
    ----------
    raw
        Frames of the window as measured, weighted.
    pending
        Recognised pairs (new track, old track) that have not been tested yet.
    """

    def __init__(self, sequence: TrackSequence, options: LoopOptions) -> None:
        super().__init__(sequence, options)
        self.loops = options
        self.global_map = GlobalMap(sequence, motion=options.motion)
        self.raw: dict[int, TrackFrame] = {}
        self.pending: set[tuple[int, int]] = set()
        self.closed_at = 0
        self.closures = self.united = self.refused = 0

    def diagnostics(self) -> dict[str, float]:
        counts = {"closures": self.closures, "united": self.united, "refused": self.refused}
        return {**super().diagnostics(), **{name: float(count) for name, count in counts.items()}}

    def advance(self, frame: TrackFrame) -> FrameEstimate:
        number = len(self.slam_map.positions_m)
        self.raw[number] = self.weighted(frame)
        estimate = super().advance(frame)
        # Recognised pairs wait until enough of them can be tested together.
        self.pending |= {(int(new), int(old)) for new, old in frame.again}
        if number - self.closed_at < self.loops.closure_frames or len(self.pending) < self.loops.closure_pairs:
            return estimate
        self._update_global_map()
        # A landmark seen once has no covariance along its line of sight.
        ripe = [pair for pair in sorted(self.pending) if self._is_determined(*pair)]
        known = self.global_map
        # Landmarks for tracks: earlier closures may have merged some. Two landmarks in one image are two.
        pairs = sorted({(known.of(a), known.of(b)) for a, b in ripe if known.may_merge(known.of(a), known.of(b))})
        if len(pairs) < self.loops.closure_pairs:
            return estimate
        self.pending.difference_update(ripe)
        self.closed_at = number
        return self._close(pairs) or estimate

    def _marginalise(self, problem: Adjustment, state: State, tracks: Sequence[int]) -> None:
        """Marginalise the oldest view, after adding it to the map of all frames."""
        # Before the base class deletes the frame, and with the refusals that are final now.
        self.global_map.add(self.views[0], self._believed(self.views[0]))
        del self.raw[self.views[0]]
        super()._marginalise(problem, state, tracks)

    def _is_determined(self, *tracks: int) -> bool:
        """Return whether the landmarks of all of ``tracks`` were seen twice or more."""
        return all(len(self.global_map.seen.get(self.global_map.of(track), ())) >= 2 for track in tracks)

    def _close(self, pairs: list[tuple[int, int]]) -> FrameEstimate | None:
        """Merge compatible pairs, adjust all frames, and replace the window's prior; None if none are compatible."""
        try:
            united = self._merge(pairs)
            if not united:
                return None
            problem, state, tracks = self._adjusted()
            self._replace_prior(problem, state, tracks)
        except np.linalg.LinAlgError as error:
            raise LostError("the history of all frames is not determined") from error
        self.closures += 1
        return self._smoothed()

    def _update_global_map(self) -> None:
        """Copy the window's frames and estimates to the map of all frames; merged landmarks keep their estimates."""
        known = self.global_map
        for view in self.views:
            known.add(view, self._believed(view))
        # Older frames have their positions of the last closure or of leaving the window: a start for the adjustment.
        known.slam_map.positions_m.update({view: self.slam_map.positions_m[view] for view in known.slam_map.frames})
        for track, point in self.slam_map.points_m.items():
            if track in known.seen and track not in known.members:
                known.slam_map.points_m[track] = point

    def _merge(self, pairs: list[tuple[int, int]]) -> int:
        """Test the pairs for joint compatibility and merge the compatible ones; return their number."""
        # These pairs are still unmerged, so that the difference of a pair is the drift between the two visits.
        problem, state, tracks = self._adjusted({landmark for pair in pairs for landmark in pair})
        first, second = (lookup(tracks, np.array(side, dtype=np.int64)) for side in zip(*pairs, strict=True))
        differences = state.points_m[first] - state.points_m[second]
        joint = landmark_covariance(problem, state, np.concatenate([first, second]))
        half = len(joint) // 2
        # Of the difference a - b: P_aa + P_bb - P_ab - P_ba.
        covariance = joint[:half, :half] + joint[half:, half:] - joint[:half, half:] - joint[half:, :half]
        good = compatible_pairs(differences, covariance, self.loops.recognition)
        # A few pairs may agree by chance.
        if len(good) < self.loops.closure_pairs:
            good = []
        for new, old in (pairs[k] for k in good):
            new, old = self.global_map.of(new), self.global_map.of(old)
            # Merges before this one may have brought both into one landmark or one frame.
            if self.global_map.may_merge(new, old):
                self.global_map.merge(new, old)
                self.united += 1
        self.refused += len(pairs) - len(good)
        return len(good)

    def _adjusted(self, kept: Collection[int] = ()) -> tuple[Adjustment, State, list[int]]:
        """Adjust all frames, and store the estimates in the map of all frames."""
        known = self.global_map
        problem, tracks = known.problem(kept)
        views = sorted(known.slam_map.frames)
        rule = StoppingRule(self.loops.closure_tolerance_m, self.options.iterations)
        return problem, known.slam_map.adjust(problem, views, tracks, rule).state, tracks

    def _replace_prior(self, problem: Adjustment, state: State, tracks: list[int]) -> None:
        """Replace the window's prior by the marginalised measurements of all frames outside the window.

        The window has one track for each landmark. Pixels of its other tracks, and those in the old prior, are part of
        the new prior.
        """
        known, views = self.global_map, np.array(sorted(self.global_map.slam_map.frames))
        # The window goes on with the track that is in view, under which the next frames will see the landmark.
        alive = {known.of(track): track for track in self.raw[self.views[-1]].tracks.tolist()}
        numbers = np.array([self._window_number(track, alive) for track in tracks], dtype=np.int64)
        inside = np.isin(views, self.views)
        # Landmarks seen by an older frame stay only if they are in view; the others have been marginalised for good.
        outer = np.array([min(known.seen[track]) < self.views[0] for track in tracks])
        stays = np.isin(tracks, sorted(alive)) | ~outer
        rows = (problem.pixels, problem.distances)
        sighted, ranged = (
            inside[seen.view]
            & stays[seen.point]
            & self._seen_under_number(numbers[seen.point], views[seen.view], seen.point, tracks)
            for seen in rows
        )
        # From the measurements themselves, not from the old prior: linearised at the closed loop, and no measurement is
        # used twice.
        prior = marginalise_outside(problem, state, Retained(inside, stays, sighted, ranged))
        for slot, track in enumerate(tracks):
            self.slam_map.points_m[int(numbers[slot])] = state.points_m[slot]
            members = known.members.get(track, {track})
            # Other tracks of a landmark must not start a second one in the window.
            self.absorbed |= members - {int(numbers[slot])} if stays[slot] else members
        self.slam_map.positions_m.update(zip(views.tolist(), state.positions_m, strict=True))
        self.prior = replace(prior, views=views[prior.views], points=numbers[prior.points])
        # All first estimates are replaced with the prior that they belong to.
        self.first_positions_m = dict(zip(self.prior.views.tolist(), state.positions_m[prior.views], strict=True))
        self.first_points_m = dict(zip(self.prior.points.tolist(), state.points_m[prior.points], strict=True))

    def _seen_under_number(
        self, numbers: IndexArray, views: IndexArray, points: IndexArray, tracks: list[int]
    ) -> BoolArray:
        """(k,): whether a view of the window has a landmark under its track ``numbers`` (k,) of the window."""
        held = {view: set(self.slam_map.frames[view].tracks.tolist()) for view in self.views}
        named = self.global_map.track_in_frame
        rows = zip(numbers.tolist(), views.tolist(), points.tolist(), strict=True)
        return np.array(
            [named[view][tracks[point]] == number and number in held.get(view, ()) for number, view, point in rows],
            dtype=np.bool_,
        )

    def _window_number(self, landmark: int, alive: Mapping[int, int]) -> int:
        """Return the window's track of a landmark: the one in view, if there is one, else the newest."""
        if landmark in alive:
            return alive[landmark]
        return max(self.global_map.members.get(landmark, {landmark}))

    def _smoothed(self) -> FrameEstimate:
        """Adjust the window once more."""
        rule = StoppingRule(self.loops.closure_tolerance_m, self.options.iterations)
        self.adjusted = self._adjust(rule)
        return self._estimate(self.adjusted.problem, self.adjusted.state, self.adjusted.tracks.tolist())

    def _believed(self, view: int) -> TrackFrame:
        """Return a frame of the window as measured, without the refused pixels."""
        refused = set() if self.gate is None else self.gate.refused.get(view, set())
        return without_tracks(self.raw[view], refused)
