"""Processor time of adjustments and smoothers of sequences, ours and other engines', in turn on the same data.

Every adjustment is checked to end at its minimum; all begin at the same start.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.ceres import Case, ceres
from benchmarks.peers import PeerSolution, solved_by_gtsam
from boresight.estimators.slam.adjustment.problem import Adjustment, Distances, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule, minimise
from boresight.estimators.slam.contract import FrameEstimate
from boresight.estimators.slam.smoothing.gtsam_smoothers import GtsamFixedLag, IncrementalFollower, load_gtsam
from boresight.estimators.slam.smoothing.smoother import FixedLagSmoother
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.sequences import SequenceTruth, SphereGround, draw_sequence
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.tracks import TrackSequence

Solver = Callable[[int], PeerSolution]

GTSAM, CERES = "gtsam's optimizer", "Ceres (C++)"
WINDOWS = ((10, 3), (25, 9), (100, 5), (500, 9))
LANDMARKS = (10, 20, 100)
# Updates of gtsam's tree in a frame, each a Gauss-Newton step: as many as our estimator takes, and the least.
UPDATES = (2, 1)
COST_TOLERANCE = 1e-6
_SEED = 20150615
# Part of the distance: as the peers' rules, the loosest power of ten with which all windows end within COST_TOLERANCE.
_STEP = 1e-3
_REPETITIONS = 5
# Frames until the window of ten is full.
_FULL = 12


@dataclass(frozen=True, slots=True)
class WindowRatio:
    """A peer's processor time over that of our whole call: medians and range over some windows.

    ``whole`` counts the making of the peer's problem as well; ``cost_gap`` is the largest relative distance of a cost,
    ours or the peer's, from that of the minimum.
    """

    peer: str
    landmarks: int
    views: int
    ours_s: float
    solve: FloatArray
    whole: FloatArray
    cost_gap: float


@dataclass(frozen=True, slots=True)
class CycleRatio:
    """Processor time of gtsam's fixed-lag smoother over ours in the same frames, and how far apart they are in sigma.

    ``updates`` is how often gtsam updates its tree in a frame; ``update`` counts these alone, ``whole`` also what feeds
    them and reads the result, in Python.
    """

    landmarks: int
    updates: int
    frames: int
    ours_s: float
    update: float
    whole: float
    apart_sigma: float


def window_ratios(windows: int, rounds: int, tell: Callable[[str], None]) -> Iterator[WindowRatio]:
    """Time full adjustments of some windows of each size; a peer that is not installed is told of and left out.

    All engines solve a window in turn, once to warm up and then for some rounds; the least time of each counts.
    """
    cases = [make_window(*size, trial) for size in WINDOWS for trial in range(windows)]
    with ExitStack() as stack:
        peers = _peers(cases, stack, tell)
        for k, (landmarks, views) in enumerate(WINDOWS if peers else ()):
            numbers = range(k * windows, (k + 1) * windows)
            found = [_solved(cases[i], i, rounds, peers) for i in numbers]
            for peer in peers:
                pairs = [(solved[""], solved[peer]) for solved in found]
                yield WindowRatio(
                    peer, landmarks, views, float(np.median([ours.solve_s for ours, _ in pairs])),
                    np.array([theirs.solve_s / ours.solve_s for ours, theirs in pairs]),
                    np.array([(theirs.build_s + theirs.solve_s) / ours.solve_s for ours, theirs in pairs]),
                    max(_gap(cases[i], pair) for i, pair in zip(numbers, pairs, strict=True)),
                )  # fmt: skip


def _peers(cases: Sequence[Case], stack: ExitStack, tell: Callable[[str], None]) -> dict[str, Solver]:
    """Return those that are here, by name; each solves a case by its number."""
    found: dict[str, Solver] = {}
    try:
        load_gtsam()
        found[GTSAM] = lambda number: solved_by_gtsam(*cases[number])
    except BoresightError as error:
        tell(f"left out: {error}")
    try:
        program = stack.enter_context(ceres(cases))
        found[CERES] = lambda number: program.solve(number, _REPETITIONS)
    except BoresightError as error:
        tell(f"left out: {error}")
    return found


def _solved(case: Case, number: int, rounds: int, peers: Mapping[str, Solver]) -> dict[str, PeerSolution]:
    """Return our solution of a case, named "", and the peers', each with its least times."""
    solvers = {"": lambda _: _our_solution(*case), **peers}
    for solve in solvers.values():  # to warm up
        solve(number)
    turns = [{name: solve(number) for name, solve in solvers.items()} for _ in range(rounds)]
    return {name: _least([turn[name] for turn in turns]) for name in solvers}


def _least(found: Sequence[PeerSolution]) -> PeerSolution:
    """Return one of the same solutions, with the least of the times of all."""
    return replace(found[0], build_s=min(one.build_s for one in found), solve_s=min(one.solve_s for one in found))


def cycle_ratios(frames: int, rounds: int, tell: Callable[[str], None]) -> Iterator[CycleRatio]:
    """Time the fixed-lag smoothers on the same sequences in turn, from the frame on at which the window is full.

    The least time of each frame in some rounds counts.
    """
    try:
        engines = [GtsamFixedLag.from_options({"rounds": updates}) for updates in UPDATES]
    except BoresightError as error:
        tell(f"left out: {error}")
        return
    # The engine believes all associations as well.
    smoother = FixedLagSmoother.from_options({"associations": "all"})
    for landmarks in LANDMARKS:
        sequence = _draw(landmarks, frames, 0)[1]
        turns = [[_ours(sequence, smoother), *(_theirs(sequence, one) for one in engines)] for _ in range(1 + rounds)]
        ours, *peers = zip(*turns[1:], strict=True)  # by engine, its turns but the first, which is to warm up
        ours_s = np.min([[cycle.whole_s for cycle in turn] for turn in ours], axis=0)
        for updates, theirs in zip(UPDATES, peers, strict=True):
            whole_s = np.min([[cycle.whole_s for cycle in turn] for turn in theirs], axis=0)
            update_s = np.min([[cycle.update_s for cycle in turn] for turn in theirs], axis=0)
            apart = [_sigmas(a.estimate, b.estimate) for a, b in zip(ours[0], theirs[0], strict=True)]
            yield CycleRatio(
                landmarks, updates, len(ours_s), float(np.median(ours_s)), float(np.median(update_s / ours_s)),
                float(np.median(whole_s / ours_s)), float(np.sqrt(np.mean(np.square(apart)))),
            )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Cycle:
    """A frame, and the processor time of all of it and of gtsam's updates in it."""

    estimate: FrameEstimate
    whole_s: float
    update_s: float = 0.0


def _ours(sequence: TrackSequence, smoother: FixedLagSmoother) -> list[_Cycle]:
    follower, cycles = smoother.follower(sequence), []
    for frame in sequence.frames:
        began = time.process_time()
        estimate = follower.advance(frame)
        cycles.append(_Cycle(estimate, time.process_time() - began))
    return cycles[_FULL:]


def _theirs(sequence: TrackSequence, engine: GtsamFixedLag) -> list[_Cycle]:
    follower, cycles = IncrementalFollower(sequence, engine.options, engine.options.lag), []
    follower.engine = updates = _TimedUpdates(follower.engine)
    for frame in sequence.frames:
        updates.seconds, began = 0.0, time.process_time()
        estimate = follower.advance(frame)
        cycles.append(_Cycle(estimate, time.process_time() - began, updates.seconds))
    return cycles[_FULL:]


class _TimedUpdates:
    """An engine of gtsam whose updates are timed."""

    def __init__(self, engine: Any) -> None:
        self.engine, self.seconds = engine, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.engine, name)

    def update(self, *arguments: Any) -> None:
        began = time.process_time()
        self.engine.update(*arguments)
        self.seconds += time.process_time() - began


def make_window(landmarks: int, views: int, trial: int) -> tuple[Adjustment, State]:
    """Return a window of the world of Delpech et al. (2015) with its depth gauge, and a start that is off by metres."""
    truth, sequence = _draw(landmarks, views, trial)
    slam_map, numbers = SlamMap(sequence.camera), list(range(views))
    slam_map.frames = dict(enumerate(sequence.frames[:views]))
    seen = slam_map.seen_by(numbers)
    tracks = sorted(track for track, by in seen.items() if len(by) >= 2)
    gauge = max((track for track in tracks if seen[track][0] == 0), key=lambda track: (len(seen[track]), -track))
    positions = np.array([pose.camera_position_m for pose in truth.poses[:views]])
    points = truth.points_m[tracks]
    length = float(np.linalg.norm(truth.points_m[gauge] - positions[0]))
    rng = np.random.default_rng([_SEED, trial])
    free = np.arange(views) > 0
    start = State(
        positions + 3.0 * rng.normal(size=positions.shape) * free[:, None], points + 5.0 * rng.normal(size=points.shape)
    )
    none = np.zeros(1, dtype=np.int64)
    problem = Adjustment(
        camera=sequence.camera,
        R_cam_body=slam_map.attitudes(numbers),
        pixels=slam_map.pixels(numbers, tracks),
        free_views=free,
        free_points=np.ones(len(tracks), dtype=np.bool_),
        distances=Distances(none, np.array([tracks.index(gauge)]), np.array([length]), np.array([0.1])),
    )
    return problem, start


def _draw(landmarks: int, frames: int, trial: int) -> tuple[SequenceTruth, TrackSequence]:
    spec = SequenceSpec.model_validate(
        {
            "sphere_radius_m": 190,
            "orbit": {"step_deg": 2, "revolutions": 2.0 * frames / 360.0},
            "vision": {"landmarks_per_frame": landmarks},
        }
    )
    return draw_sequence(spec, Camera.from_fov(1024, 1024, np.radians(30.0)), SphereGround(190.0), _SEED, trial)


def _our_solution(problem: Adjustment, start: State) -> PeerSolution:
    """Solve by our whole call, from the problem's arrays to the minimum; its time is a mean."""
    rule = StoppingRule(_STEP * _depth_m(start))
    began = time.process_time()
    for _ in range(_REPETITIONS):
        found = minimise(problem, start, rule)
    return PeerSolution(found.state, found.cost, 0.0, (time.process_time() - began) / _REPETITIONS)


def _gap(case: Case, solved: Sequence[PeerSolution]) -> float:
    """Return the largest relative distance of the costs from that of the minimum."""
    lowest = minimise(*case, StoppingRule(1e-9 * _depth_m(case[1]))).cost
    return max(abs(found.cost / lowest - 1.0) for found in solved)


def _depth_m(start: State) -> float:
    return float(np.median(np.linalg.norm(start.points_m - start.positions_m[0], axis=1)))


def _sigmas(ours: FrameEstimate, theirs: FrameEstimate) -> float:
    if ours.covariance_m2 is None:
        return float("nan")
    gap = ours.position_m - theirs.position_m
    return float(np.sqrt(gap @ np.linalg.solve(ours.covariance_m2, gap)))
