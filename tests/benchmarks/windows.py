"""What adjustments and smoothers of sequences cost beside those of other engines, on one core and in one run.

Only ratios are told: a time says as much of the machine as of the program. Every adjustment is checked to end at the
same cost, from the same start.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers import PeerSolution, solved_by_ceres, solved_by_gtsam
from estimators.slam.problem import Adjustment, Distances, State
from estimators.slam.registry import sequence_estimator_class
from estimators.slam.slam_map import SlamMap
from estimators.slam.solver import StoppingRule, minimise
from scenarios.errors import BoresightError
from scenarios.geometry import Camera
from scenarios.sequences import SequenceTruth, SphereGround, draw_sequence
from scenarios.spec.sequence import SequenceSpec
from scenarios.tracks import TrackSequence

FloatArray = NDArray[np.float64]
Peer = Callable[[Adjustment, State], PeerSolution]

PEERS: tuple[tuple[str, Peer], ...] = (("gtsam", solved_by_gtsam), ("pyceres", solved_by_ceres))
WINDOWS = ((10, 3), (10, 9), (15, 5), (25, 3), (25, 9), (100, 5), (300, 5), (500, 9))
LANDMARKS = (10, 20, 100, 300)
COST_TOLERANCE = 1e-6
_SEED = 20150615
# Parts of the distance: loose as the peers' rules are, and as theirs far below the tolerance of the cost.
_STEP = 1e-6
_BEST_OF = 3


@dataclass(frozen=True, slots=True)
class WindowRatio:
    """A peer's time over ours, median of some windows: all of it, and its solver's alone over all of ours.

    ``cost_gap`` is the largest relative difference of the two costs; ``ours_s`` the median time that ours takes.
    """

    peer: str
    landmarks: int
    views: int
    windows: int
    ours_s: float
    whole: float
    solve_alone: float
    cost_gap: float


@dataclass(frozen=True, slots=True)
class CycleRatio:
    """Median time of a frame of gtsam's fixed-lag smoother over ours, and the rms distance of the two in sigma."""

    landmarks: int
    frames: int
    ours_s: float
    ratio: float
    apart_sigma: float


def window_ratios(windows: int, tell: Callable[[str], None]) -> Iterator[WindowRatio]:
    """Time full adjustments of windows of all sizes; a peer that is not installed is told of and left out."""
    peers = [peer for peer in PEERS if _present(peer, tell)]
    for landmarks, views in WINDOWS if peers else ():
        cases = [make_window(landmarks, views, trial) for trial in range(windows)]
        ours = [min(_our_time(*case) for _ in range(1 + _BEST_OF)) for case in cases]
        for name, solve in peers:
            found = [min((solve(*case) for _ in range(_BEST_OF)), key=_whole) for case in cases]
            gaps = [abs(f.cost - cost) / cost for f, (_, cost) in zip(found, ours, strict=True)]
            whole = [_whole(f) / seconds for f, (seconds, _) in zip(found, ours, strict=True)]
            alone = [f.solve_s / seconds for f, (seconds, _) in zip(found, ours, strict=True)]
            yield WindowRatio(
                name, landmarks, views, windows, float(np.median([seconds for seconds, _ in ours])),
                float(np.median(whole)), float(np.median(alone)), max(gaps),
            )  # fmt: skip


def cycle_ratios(frames: int, tell: Callable[[str], None]) -> Iterator[CycleRatio]:
    """Time whole cycles of the fixed-lag smoothers, from the frame on at which the window is full."""
    try:
        theirs = sequence_estimator_class("gtsam-fixed-lag").from_options({})
    except BoresightError as error:
        tell(f"left out: {error}")
        return
    ours = sequence_estimator_class("fixed-lag").from_options(
        {"associations": "all"}
    )  # the engine believes all as well
    for landmarks in LANDMARKS:
        sequence = _draw(landmarks, frames, 0)[1]
        one, other = ours.follow(sequence), theirs.follow(sequence)
        pairs = list(zip(one.frames, other.frames, strict=False))[12:]
        apart = [_sigmas(a.position_m - b.position_m, a.covariance_m2) for a, b in pairs]
        mine = float(np.median([a.seconds for a, _ in pairs]))
        ratio = float(np.median([b.seconds for _, b in pairs])) / mine
        yield CycleRatio(landmarks, len(pairs), mine, ratio, float(np.sqrt(np.mean(np.square(apart)))))


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


def _present(peer: tuple[str, Peer], tell: Callable[[str], None]) -> bool:
    try:
        peer[1](*make_window(10, 3, 0))
    except BoresightError as error:
        tell(f"left out: {error}")
        return False
    return True


def _our_time(problem: Adjustment, start: State) -> tuple[float, float]:
    """Processor time, s, and cost of our adjustment, all that it writes down included."""
    depth_m = float(np.median(np.linalg.norm(start.points_m - start.positions_m[0], axis=1)))
    began = time.process_time()
    found = minimise(problem, start, StoppingRule(_STEP * depth_m))
    return time.process_time() - began, found.cost


def _whole(found: PeerSolution) -> float:
    return found.build_s + found.solve_s


def _sigmas(gap: FloatArray, covariance_m2: FloatArray | None) -> float:
    if covariance_m2 is None:
        return float("nan")
    return float(np.sqrt(gap @ np.linalg.solve(covariance_m2, gap)))
