"""Errors that add up along tracks: smoother and filter against dense least squares with all of them as unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from slam_sequences import CAMERA, Recipe, central_differences, make_sequence, with_track_errors

from boresight.estimators.registry import sequence_estimator_class
from boresight.estimators.slam.adjustment.problem import QuadraticPrior, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule, marginalise_view, minimise, view_covariance
from boresight.estimators.slam.adjustment.track_errors import COMMON
from boresight.scenarios.observation import TrackFrame

WALK_PX, CONTRACTION, DRIFT_PX = 0.4, 1e-3, 0.1
POSITION_M = 0.5
SILENT = {"walk_px": 0.0, "contraction": 0.0, "drift_px": 0.0}


class Dense:
    """The frames as one least-squares problem with each step of each walk, contraction and drift as unknowns.

    ``across`` are tracks whose step into frame 1 is a displacement of the landmark across the line of sight there.
    """

    def __init__(self, slam_map: SlamMap, tracks: list[int], frames: list[int], across: set[int]) -> None:
        self.map, self.tracks, self.frames, self.across = slam_map, tracks, frames, across
        self.began = {track: min(k for k in frames if track in slam_map.frames[k].tracks) for track in tracks}
        self.places = {track: slam_map.points_m[track].copy() for track in tracks}
        self.camera_1 = slam_map.positions_m[frames[1]].copy()
        self.steps = [(track, k) for track in tracks for k in frames if k > self.began[track]]
        cameras = [slam_map.positions_m[k] for k in frames]
        self.start = np.concatenate([*cameras, *self.places.values(), np.zeros(3 + 2 * len(self.steps))])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        count = len(self.frames)
        cameras = dict(zip(self.frames, x[: 3 * count].reshape(-1, 3), strict=True))
        points = dict(zip(self.tracks, x[3 * count :][: 3 * len(self.tracks)].reshape(-1, 3), strict=True))
        rest = x[3 * (count + len(self.tracks)) :]
        common, steps = (
            rest[:3] * [CONTRACTION, DRIFT_PX, DRIFT_PX],
            dict(zip(self.steps, rest[3:].reshape(-1, 2), strict=True)),
        )
        first = self.map.positions_m[self.frames[0]]
        found = [(cameras[self.frames[0]] - first) / POSITION_M, rest[:3], rest[3:] / WALK_PX]
        for before, k in zip(self.frames, self.frames[1:], strict=False):
            frame = self.map.frames[k]
            root = np.linalg.cholesky(np.linalg.inv(frame.motion_covariance_m2)).T
            found.append(root @ (cameras[k] - cameras[before] - frame.motion_m))
        for k in self.frames:
            frame = self.map.frames[k]
            found += [
                [(np.linalg.norm(points[item.track] - cameras[k]) - item.range_m) / item.sigma_m]
                for item in frame.ranges
                if item.track in points
            ]
            rows = [row for row, track in enumerate(frame.tracks.tolist()) if track in points]
            moved = [self._moved(track, k, points[track], common, steps) for track in frame.tracks[rows].tolist()]
            there, biases = (np.array(part) for part in zip(*moved, strict=True))
            pixels = CAMERA.project((there - cameras[k]) @ frame.R_cam_body.T) + biases
            found.append(((pixels - frame.uv_px[rows]) / frame.sigma_px).ravel())
        return np.concatenate(found)

    def _moved(self, track, k, point, common, steps) -> tuple[np.ndarray, np.ndarray]:
        """Position of a landmark at the time of a frame, m, and the error of its pixel, px."""
        point, bias = point.copy(), np.zeros(2)
        for now in range(self.began[track] + 1, k + 1):
            then = self.map.frames[now]
            (at,) = then.uv_px[then.tracks == track]
            bias += common[1:] - common[0] * (at - [CAMERA.cx_px, CAMERA.cy_px])
            if track in self.across and now == 1:
                R = self.map.frames[1].R_cam_body
                J = CAMERA.jacobian((R @ (self.places[track] - self.camera_1))[None])[0] @ R
                point += np.linalg.pinv(J) @ steps[track, now]
            else:
                bias += steps[track, now]
        return point, bias

    def solve(self) -> tuple[np.ndarray, np.ndarray]:
        """The last camera's position and its covariance."""
        done = least_squares(self.residuals, self.start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        rows = slice(3 * len(self.frames) - 3, 3 * len(self.frames))
        return done.x[rows], np.linalg.inv(done.jac.T @ done.jac)[rows, rows]


@pytest.fixture(scope="module")
def small():
    """Six frames with track errors; the map at the truth."""
    rng = np.random.default_rng(3)
    sequence, truth = make_sequence(rng, Recipe(frames=6, landmarks=9, repeatability=0.85))
    sequence = with_track_errors(rng, sequence, truth, WALK_PX, CONTRACTION)
    slam_map = SlamMap(CAMERA)
    for frame in sequence.frames:
        slam_map.errors.add(frame)
    slam_map.frames = dict(enumerate(sequence.frames))
    slam_map.positions_m = {**dict(enumerate(truth.positions_m)), COMMON: np.zeros(3)}
    slam_map.points_m = dict(truth.points_m)
    tracks = sorted(track for track, by in slam_map.seen_by(range(6)).items() if len(by) >= 2)
    return slam_map, tracks, sequence


def adjustment(slam_map: SlamMap, tracks: list[int], views: list[int], prior: QuadraticPrior | None):
    problem = replace(slam_map.problem(views, tracks), motions=slam_map.motions(views), prior=prior)
    return slam_map.errors.extended(problem, views, tracks)


def first_prior(slam_map: SlamMap) -> QuadraticPrior:
    prior = slam_map.errors.prior(QuadraticPrior.of_first_position(slam_map.positions_m[0], POSITION_M**2 * np.eye(3)))
    assert prior is not None
    return prior


def test_an_adjustment_equals_dense_least_squares_with_every_step_as_an_unknown(small):
    slam_map, tracks, _ = small
    views = list(range(6))
    prior = replace(first_prior(slam_map), views=np.array([0, 6]))
    wanted, spread = Dense(slam_map, tracks, views, set()).solve()
    for kept in (None, np.arange(len(tracks)) % 3 == 0):
        problem = replace(adjustment(slam_map, tracks, views, prior), kept_points=kept)
        found = minimise(problem, slam_map.state([*views, COMMON], tracks), StoppingRule(1e-10))
        covariance = view_covariance(problem, found.state, 5)
        np.testing.assert_allclose(found.state.positions_m[5], wanted, atol=1e-4 * np.sqrt(spread.max()))
        np.testing.assert_allclose(covariance, spread, rtol=2e-4, atol=1e-5 * spread.max())


def test_what_common_errors_add_to_the_covariance_is_their_effect_on_the_answer_by_differences(small):
    """P' = P + S V S': S of an adjustment that takes them for zero; V what is left unknown of them."""
    slam_map, tracks, _ = small
    views = list(range(6))
    told = adjustment(slam_map, tracks, views, replace(first_prior(slam_map), views=np.array([0, 6])))
    state = slam_map.state([*views, COMMON], tracks)
    deaf = SlamMap(CAMERA)
    deaf.positions_m, deaf.points_m = slam_map.positions_m, slam_map.points_m
    exact = {
        k: CAMERA.project(
            (np.array([deaf.points_m[t] for t in f.tracks.tolist()]) - deaf.positions_m[k]) @ f.R_cam_body.T
        )
        for k, f in slam_map.frames.items()
    }
    prior = QuadraticPrior.of_first_position(slam_map.positions_m[0], POSITION_M**2 * np.eye(3))
    for frame in slam_map.frames.values():
        deaf.errors.add(replace(frame, contraction=0.0, drift_px=0.0))

    def last_m(shift: np.ndarray) -> np.ndarray:
        for k, frame in slam_map.frames.items():
            deaf.frames[k] = replace(frame, uv_px=exact[k] + slam_map.errors.moved(k, frame.tracks.tolist()) @ shift)
        return minimise(adjustment(deaf, tracks, views, prior), deaf.state(views, tracks), StoppingRule(1e-11)).state

    size = 1e-3 * slam_map.errors.common_m
    S = central_differences(lambda shift: last_m(shift).positions_m[5], np.zeros(3), np.full(3, size))
    known = view_covariance(adjustment(deaf, tracks, views, prior), deaf.state(views, tracks), 5)
    wanted = known + S @ view_covariance(told, state, 6) @ S.T
    np.testing.assert_allclose(view_covariance(told, state, 5), wanted, atol=1e-2 * wanted.max())
    assert np.trace(known) < 0.9 * np.trace(wanted)


def test_the_steps_of_a_track_add_up_from_its_second_sighting_on(small):
    slam_map, tracks, _ = small
    for track in tracks:
        total, seen = np.zeros((2, 3)), False
        for number, frame in slam_map.frames.items():
            if track not in frame.tracks:
                continue
            u, v = frame.uv_px[frame.tracks == track][0]
            step = [
                [CONTRACTION * (CAMERA.cx_px - u), DRIFT_PX, 0.0],
                [CONTRACTION * (CAMERA.cy_px - v), 0.0, DRIFT_PX],
            ]
            total, seen = total + seen * np.array(step), True
            found = slam_map.errors.moved(number, [track])[0] * slam_map.errors.common_m
            np.testing.assert_allclose(found, total, rtol=1e-12, atol=1e-15)


def followed(errors, number, R, tracks, uv_px, again=()) -> TrackFrame:
    """The next frame, with its recognised pairs, added to the errors so far."""
    frame = TrackFrame(
        100.0 * number, R, np.array(tracks, np.int64), uv_px, 0.5, np.zeros(3), np.eye(3),
        again=np.array(again, np.int64).reshape(-1, 2),
        walk_px=WALK_PX, contraction=CONTRACTION, drift_px=DRIFT_PX,
    )  # fmt: skip
    errors.add(frame)
    errors.resume(frame)
    return frame


def test_recognised_tracks_begin_with_the_errors_of_the_turn_since_the_first_view():
    """The camera circles by steps of 30 deg, two and a bit times, and another track is always in view."""
    seen = {1: 0, 2: 0, 5: 1, 6: 1, 12: 2, 14: 3, 26: 4}
    recognised = {5: [(1, 0), (99, 0), (1, 77)], 12: [(2, 1)], 14: [(3, 2)], 26: [(4, 3)]}
    slam_map = SlamMap(CAMERA)
    errors = slam_map.errors
    for k in range(27):
        R = Rotation.from_euler("y", 30.0 * k, degrees=True).as_matrix()
        tracks, uv = [50, seen[k]] if k in seen else [50], np.array([[700.0, 100.0], [300.0 + 5.0 * k, 400.0]])
        frame = followed(errors, k, R, tracks, uv[: len(tracks)], recognised.get(k, ()))
        slam_map.frames[k] = replace(frame, tracks=frame.tracks // 50)  # landmark 1 is the track that is always there
        slam_map.positions_m[k] = R.T @ [0.0, 0.0, -1000.0]
    slam_map.points_m = {0: np.zeros(3), 1: np.zeros(3)}
    views = list(range(27))
    pixels = errors.extended(slam_map.problem(views, [0, 1]), views, [0, 1], {0: set(range(5)), 1: {50}}).pixels
    pixels = pixels.subset(pixels.point == 0)
    assert pixels.added is not None
    np.testing.assert_array_equal(pixels.view, list(seen))
    np.testing.assert_array_equal(pixels.added.branch, [1, 1, 1, 1, 12, 12, 26])
    np.testing.assert_allclose(pixels.added.walk_px2 / WALK_PX**2, [0, 1, 4, 5, 1, 3, 1], rtol=1e-9, atol=1e-12)
    step = {k: np.array([CONTRACTION * (CAMERA.cx_px - 300.0 - 5.0 * k), DRIFT_PX]) for k in seen}
    on, back = step[2] + 3.0 * step[5], -step[12]
    moved = [0.0 * step[1], step[2], on, on + step[6], back, back + 2.0 * step[14], step[26]]
    np.testing.assert_allclose(pixels.added.moved[:, 0, :2] * errors.common_m, moved, rtol=1e-9, atol=1e-12)

    # About the landmark at frame 14, where its track is the one that was found at 12, a step off.
    errors.since = 14
    before = pixels.subset(pixels.view < 26)
    about, shared = errors.backwards(before, before.view, [3] * len(before.view), before.view != 2)
    assert about.added is not None
    np.testing.assert_array_equal(shared, [False] * 4 + [True] * 2)
    np.testing.assert_allclose(about.added.walk_px2 / WALK_PX**2, [3, 1, 7, 8, 2, 0], rtol=1e-9, atol=1e-12)


def test_a_view_that_stays_or_that_is_passed_again_is_told_by_the_boresights():
    """A track goes on while the camera hovers or its view turns on. On its way back the landmark is found anew."""
    for turns, wanted in (([0.0] * 8, 5.0), ([0, 1, 2, 3, 4, 5, 6, 7], 5.0), ([0, 1, 2, 3, 4, 3, 2, 1], 0.0)):
        errors = SlamMap(CAMERA).errors
        for k, turn in enumerate(turns):
            R = Rotation.from_euler("yz", [10.0 * turn, 2.0 * (k % 2) * bool(any(turns))], degrees=True).as_matrix()
            track = {1: 0, 2: 0, 7: 1}.get(k, 50)
            followed(errors, k, R, [track], np.array([[300.0, 400.0]]), [(1, 0)] if k == 7 else ())
        step = errors.moved(2, [0])[0]
        gone = errors.moved(7, [1])[0][1, 2] / step[1, 2]
        assert gone == pytest.approx(1.0 + wanted if wanted else 0.0, abs=0.25)


def test_what_a_window_hands_on_equals_dense_least_squares_of_all_frames(small):
    slam_map, tracks, sequence = small
    # Noise so small that the problem is linear.
    quiet = SlamMap(CAMERA)
    share, first = 1e-3, dict(slam_map.points_m)
    for frame in sequence.frames:
        there = slam_map.positions_m[len(quiet.frames)]
        exact = CAMERA.project((np.array([first[t] for t in frame.tracks.tolist()]) - there) @ frame.R_cam_body.T)
        uv = exact + share * (frame.uv_px - exact)
        motion = there - slam_map.positions_m[max(len(quiet.frames) - 1, 0)]
        moved = motion + share * (frame.motion_m - motion)
        frame = replace(frame, uv_px=uv, motion_m=moved)
        quiet.errors.add(frame)
        quiet.frames[len(quiet.frames)] = frame
    quiet.positions_m, quiet.points_m = dict(slam_map.positions_m), first
    views = list(range(6))
    problem = adjustment(quiet, tracks, views, replace(first_prior(quiet), views=np.array([0, 6])))
    state = quiet.state([*views, COMMON], tracks)
    last, oldest = set(quiet.frames[5].tracks.tolist()), set(quiet.frames[0].tracks.tolist())
    lost = np.array([track in oldest - last for track in tracks])
    local = marginalise_view(problem, state, 0, lost)
    names = np.array([*views, COMMON])
    prior = replace(local, views=names[local.views], points=np.array(tracks)[local.points])
    at = quiet.positions_m[1], quiet.frames[1].R_cam_body
    quiet.errors.since = 1
    prior = quiet.errors.carried(prior, 0, CAMERA, at)
    left = [track for track, gone in zip(tracks, lost.tolist(), strict=True) if not gone]
    kept = [*views[1:], COMMON]
    prior = replace(prior, views=np.searchsorted(kept, prior.views), points=np.searchsorted(left, prior.points))
    window = adjustment(quiet, left, views[1:], prior)
    found = minimise(window, State(state.positions_m[1:], quiet.state((), left).points_m), StoppingRule(1e-12))
    covariance = view_covariance(window, found.state, 4)
    carried = {track for track in left if track in oldest}
    assert len(carried) >= 3
    assert lost.sum() >= 2
    for across, tolerance in ((carried, 1e-3), (set(), 0.02)):
        # A step that moves the landmark, as in the window, and one that shifts every later pixel by as much.
        wanted, spread = Dense(quiet, tracks, views, across).solve()
        scale = np.sqrt(spread.max())
        np.testing.assert_allclose(covariance, spread, atol=tolerance * spread.max())
        np.testing.assert_allclose(found.state.positions_m[4], wanted, atol=3.0 * tolerance * share * scale)
    plain = replace(quiet.problem(views, tracks), motions=quiet.motions(views))
    prior = QuadraticPrior.of_first_position(quiet.positions_m[0], POSITION_M**2 * np.eye(3))
    spread = view_covariance(replace(plain, prior=prior), quiet.state(views, tracks), 5)
    assert np.trace(spread) < 0.8 * np.trace(covariance), "the errors of tracks have no part"


METHODS = [
    ("fixed-lag", {"associations": "all", "lag": 5}),
    ("batch", {}),
    ("loop-smoother", {"associations": "all", "lag": 5}),
    ("consistent-ekf-slam", {}),
]
ALONE = [(0.5, 0.0), (0.0, 3e-3)]


@pytest.mark.parametrize(
    ("name", "options", "declared"),
    [
        *((*one, (0.5, 3e-3)) for one in METHODS),
        *(pytest.param(*one, errors, marks=pytest.mark.long) for one in METHODS for errors in ALONE),
    ],
)
def test_covariances_describe_the_errors_of_tracks(name, options, declared):
    """With both errors the sum is too large also if half of the walk alone, or the drift alone, is not counted."""
    check_consistency(name, options, declared, 24)


def test_covariances_of_a_filter_of_poses_do_too():
    check_consistency("consistent-ekf-slam", {"camera": "pose"}, (0.5, 3e-3), 12)


def check_consistency(name, options, declared, runs):
    frames, told, untold = 14, [], []
    for seed in range(runs):
        rng = np.random.default_rng(100 + seed)
        sequence, truth = make_sequence(rng, Recipe(frames=frames, repeatability=0.9))
        sequence = with_track_errors(rng, sequence, truth, *declared)
        silent = replace(sequence, frames=tuple(replace(f, **SILENT) for f in sequence.frames))
        for one, squares in ((sequence, told), (silent, untold)):
            estimate = sequence_estimator_class(name).from_options(options).follow(one)
            assert estimate.status == "ok", estimate.reason
            last = estimate.frames[-1]
            error = last.position_m - truth.positions_m[-1]
            squares.append(float(error @ np.linalg.solve(last.covariance_m2, error)))
    # Two-sided 99.9 % bounds of the mean of so many chi-squares of 3 degrees of freedom.
    low, high = chi2.interval(0.999, 3 * runs)
    assert low < np.sum(told) < high
    assert np.sum(untold) > high
