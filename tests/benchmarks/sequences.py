"""Adjustments and smoothers of sequences beside other engines, and beside their own reference in numpy.

All engines take turns on the same data, by processor time. Every adjustment is checked to end at its minimum; all begin
at the same start.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy_adjustment
from threadpoolctl import threadpool_limits

from benchmarks.ceres import Case, ceres
from benchmarks.peers import PeerSolution, solved_by_gtsam
from benchmarks.ratio import Absent, Ratio
from benchmarks.timing import Settings, in_turn, timed
from boresight.campaign.runs.benchmark import one_core
from boresight.estimators.slam.adjustment.problem import Adjustment, Distances, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule, minimise
from boresight.estimators.slam.contract import FrameEstimate
from boresight.estimators.slam.smoothing.gtsam_smoothers import GtsamFixedLag, IncrementalFollower, load_gtsam
from boresight.estimators.slam.smoothing.smoother import FixedLagSmoother
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackSequence
from boresight.scenarios.sequences import SequenceTruth, SphereGround, draw_sequence
from boresight.scenarios.spec.sequence import SequenceSpec

Solver = Callable[[int], PeerSolution]

GTSAM, CERES = "gtsam's optimizer", "Ceres (C++)"
WINDOWS = ((10, 3), (25, 9), (100, 5), (500, 9))
LANDMARKS, CYCLE_FRAMES = (10, 20, 100), 45
# Updates of gtsam's tree in a frame, each a Gauss-Newton step: as many as our estimator takes, and the least.
UPDATES = (2, 1)
COST_TOLERANCE = 1e-6
_AIMS = {(CERES, 25, 9): 5.0, (CERES, 500, 9): 10.0, **{(GTSAM, *size): 5.0 for size in WINDOWS}}
_UPDATE_AIM = 2.0
_SEED = 20150615
# Part of the distance: as the peers' rules, the loosest power of ten with which all windows end within COST_TOLERANCE.
_STEP = 1e-3
_ROUNDS, _REPETITIONS = 5, 5
# Frames until the window of ten is full.
_FULL = 12


def adjustment_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time full adjustments of windows on one core beside the solvers of gtsam and of Ceres alone.

    All engines solve a window in turn, once to warm up and then for some rounds; the least time of each counts.
    """
    absent: list[Absent] = []
    cases = [make_window(*size, trial) for size in WINDOWS for trial in range(settings.rounds)]
    with one_core(), threadpool_limits(limits=1), ExitStack() as stack:
        peers = _peers(cases, stack, absent)
        for k, (landmarks, views) in enumerate(WINDOWS if peers else ()):
            work = f"adjustment of {landmarks} landmarks in {views} views"
            numbers = range(k * settings.rounds, (k + 1) * settings.rounds)
            solved = [_solved(cases[i], i, peers) for i in numbers]
            ours_s = np.array([one[""].solve_s for one in solved])
            for peer in peers:
                pairs = [(one[""], one[peer]) for one in solved]
                gap = max(_gap(cases[i], pair) for i, pair in zip(numbers, pairs, strict=True))
                if gap > COST_TOLERANCE:
                    yield Absent(work, f"{peer} or we end above the minimum, by {gap:.1e} of the cost")
                    continue
                solve_s, build_s = (np.array([getattr(p, part) for _, p in pairs]) for part in ("solve_s", "build_s"))
                timings = [(peer, solve_s, _AIMS.get((peer, landmarks, views)))]
                if peer == CERES:
                    timings.append((f"{CERES}, its problem built as well", build_s + solve_s, None))
                for name, peer_s, aim in timings:
                    ratios, ours = peer_s / ours_s, float(np.median(ours_s))
                    note = (
                        f"costs equal to {gap:.0e}; {ratios.min():.3g} to {ratios.max():.3g} in {len(ratios)} windows"
                    )
                    yield Ratio(work, name, "cpu", ours, float(np.median(ratios)) * ours, aim, note)
    yield from absent


def _peers(cases: Sequence[Case], stack: ExitStack, absent: list[Absent]) -> dict[str, Solver]:
    """Return the peers that are installed, by name; each solves a case by its number."""
    found: dict[str, Solver] = {}
    try:
        load_gtsam()
        found[GTSAM] = lambda number: solved_by_gtsam(*cases[number])
    except BoresightError as error:
        absent.append(Absent("adjustment of a window", f"left out: {error}"))
    try:
        program = stack.enter_context(ceres(cases))
        found[CERES] = lambda number: program.solve(number, _REPETITIONS)
    except BoresightError as error:
        absent.append(Absent("adjustment of a window", f"left out: {error}"))
    return found


def _solved(case: Case, number: int, peers: Mapping[str, Solver]) -> dict[str, PeerSolution]:
    """Return our solution of a case, named "", and the peers', each with its least times."""
    solvers = {"": lambda _: _our_solution(*case), **peers}
    turns = [{name: solve(number) for name, solve in solvers.items()} for _ in range(1 + _ROUNDS)][1:]
    return {
        name: replace(
            turns[0][name],
            build_s=min(turn[name].build_s for turn in turns),
            solve_s=min(turn[name].solve_s for turn in turns),
        )
        for name in solvers
    }


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


def smoother_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time whole frames of fixed-lag smoothers on one core beside gtsam's updates alone, and with what feeds them.

    Frames count from the one on at which the window is full; the least time of each frame in some rounds.
    """
    try:
        engines = [GtsamFixedLag.from_options({"rounds": updates}) for updates in UPDATES]
    except BoresightError as error:
        yield Absent("frame of fixed-lag", f"left out: {error}")
        return
    # The engine believes all associations as well.
    smoother = FixedLagSmoother.from_options({"associations": "all"})
    with one_core(), threadpool_limits(limits=1):
        for landmarks in LANDMARKS:
            sequence = _draw(landmarks, CYCLE_FRAMES, 0)[1]
            turns = [
                [our_cycles(sequence, smoother), *(_their_cycles(sequence, one) for one in engines)]
                for _ in range(1 + settings.rounds)
            ]
            ours, *peers = zip(*turns[1:], strict=True)  # by engine, its turns but the first, which is to warm up
            ours_s = _least(ours, "whole_s")
            for updates, theirs in zip(UPDATES, peers, strict=True):
                apart = [_sigmas(a.estimate, b.estimate) for a, b in zip(ours[0], theirs[0], strict=True)]
                note = f"{np.sqrt(np.mean(np.square(apart))):.3f} sigma apart"
                told = [(f"gtsam's update alone, {updates} a frame", "update_s", None)]
                if updates == UPDATES[0]:
                    told = [(told[0][0], "update_s", _UPDATE_AIM), ("gtsam, fed and read in Python", "whole_s", None)]
                for peer, part, aim in told:
                    median_s = float(np.median(ours_s))
                    peer_s = float(np.median(_least(theirs, part) / ours_s)) * median_s
                    yield Ratio(f"frame of fixed-lag, {landmarks} landmarks", peer, "cpu", median_s, peer_s, aim, note)


@dataclass(frozen=True, slots=True)
class _Cycle:
    """A frame, and the processor time of all of it and of gtsam's updates in it."""

    estimate: FrameEstimate
    whole_s: float
    update_s: float = 0.0


def our_cycles(sequence: TrackSequence, smoother: FixedLagSmoother) -> list[_Cycle]:
    """Follow a sequence by our smoother; its frames since the window is full."""
    follower, cycles = smoother.follower(sequence), []
    for frame in sequence.frames:
        began = time.process_time()
        estimate = follower.advance(frame)
        cycles.append(_Cycle(estimate, time.process_time() - began))
    return cycles[_FULL:]


def _their_cycles(sequence: TrackSequence, engine: GtsamFixedLag) -> list[_Cycle]:
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


def _least(turns: Sequence[Sequence[_Cycle]], part: str) -> Any:
    """Return the least time (F,) of each frame over all turns."""
    return np.min([[getattr(cycle, part) for cycle in turn] for turn in turns], axis=0)


def _sigmas(ours: FrameEstimate, theirs: FrameEstimate) -> float:
    if ours.covariance_m2 is None:
        return float("nan")
    gap = ours.position_m - theirs.position_m
    return float(np.sqrt(gap @ np.linalg.solve(ours.covariance_m2, gap)))


def kernel_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time an adjustment by compiled kernels beside their reference in numpy.

    Raises
    ------
    BoresightError
        If the two do not end at one cost.
    """
    problem, start = make_window(25, 9, 0)
    rule, times = StoppingRule(1e-4), 20
    costs = minimise(problem, start, rule).cost, numpy_adjustment.minimise(problem, start, rule).cost
    gap = abs(costs[0] - costs[1]) / costs[1]
    if gap > COST_TOLERANCE:
        raise BoresightError(f"compiled kernels and numpy end at costs that differ by {gap:.1e}")
    with threadpool_limits(limits=1):
        ours, theirs = in_turn(
            5 * settings.rounds,
            timed(lambda: [minimise(problem, start, rule) for _ in range(times)]),
            timed(lambda: numpy_adjustment.minimise(problem, start, rule)),
        )
    work, note = "adjustment of 25 landmarks in 9 views", f"equal costs to {gap:.0e}"
    yield Ratio(work, "our numpy", "cpu", ours.cpu / times, theirs.cpu, agreement=note)


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
