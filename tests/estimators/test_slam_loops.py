"""Loop closure: compatible pairs against a full search, covariances against scipy, whole loops against the truth."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2
from slam_sequences import CAMERA, ORBIT_M, RADIUS_M, Truth, look_down, with_track_errors

from boresight.estimators.slam.adjustment.global_map import GlobalMap
from boresight.estimators.slam.adjustment.problem import Distances, PixelMeasurements, State
from boresight.estimators.slam.adjustment.solver import (
    Retained,
    StoppingRule,
    kept_covariance,
    marginalise_outside,
    minimise,
    view_covariance,
)
from boresight.estimators.slam.smoothing.loop_smoother import LoopSmoother, compatible_pairs
from boresight.estimators.slam.smoothing.smoother import FixedLagSmoother
from boresight.scenarios.observation import TrackFrame, TrackRange, TrackSequence

FRAMES = 75
STEP_RAD = np.radians(5.0)
LIFE = 4


def loop(seed: int, noise_px: float = 0.67, wrong: float = 0.0) -> tuple[TrackSequence, np.ndarray, np.ndarray]:
    """A little more than a revolution: tracks live for some frames, and landmarks that were seen before are recognised.

    Returns the sequence, the camera positions, and the landmark of each track.
    """
    rng = np.random.default_rng(seed)
    angles = STEP_RAD * np.arange(FRAMES)
    positions = ORBIT_M * np.stack([np.cos(angles), np.sin(angles), np.zeros(FRAMES)], axis=1)
    points = rng.standard_normal((70, 3))
    points *= RADIUS_M / np.linalg.norm(points, axis=1, keepdims=True)
    track_of, born, owners, last = {}, {}, [], {}
    frames = []
    for k, position in enumerate(positions):
        visible = np.flatnonzero(points @ position > RADIUS_M**2 * 1.3)
        again = []
        for landmark in list(track_of):
            if landmark not in visible or (k - born[landmark] >= 2 * LIFE and rng.random() < 0.5):
                last[landmark] = track_of.pop(landmark)
        for landmark in visible.tolist():
            if landmark not in track_of:
                track_of[landmark], born[landmark] = len(owners), k
                if rng.random() < wrong and last:
                    again.append((len(owners), last[int(rng.choice(list(last)))]))
                elif landmark in last and owners[last[landmark]] == landmark:
                    again.append((len(owners), last[landmark]))
                owners.append(landmark)
        seen = sorted(track_of.items(), key=lambda item: item[1])
        lines = points[[landmark for landmark, _ in seen]] - position
        R = look_down(position)
        uv = CAMERA.project(lines @ R.T) + noise_px * rng.standard_normal((len(seen), 2))
        tracks = np.array([track for _, track in seen], dtype=np.int64)
        ranges = (TrackRange(int(tracks[0]), float(np.linalg.norm(lines[0])), 0.05),) if k == 0 else ()
        moved = position - positions[k - 1] if k else np.zeros(3)
        sigma = 0.3 * np.linalg.norm(moved) + 1e-3
        error = sigma * rng.standard_normal(3) * (noise_px > 0) if k else 0.0
        pairs = np.array(again, dtype=np.int64).reshape(-1, 2)
        frames.append(
            TrackFrame(
                100.0 * k, R, tracks, uv, max(noise_px, 1e-2), moved + error, sigma**2 * np.eye(3), ranges, again=pairs
            )
        )
    return TrackSequence(CAMERA, tuple(frames), positions[0], np.zeros((3, 3))), positions, points[owners]


def test_pairs_that_agree_are_the_largest_compatible_set() -> None:
    """Against all subsets: the joint chi-square of the set within its gate, the largest one, the smallest square."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        drift = 30.0 * rng.standard_normal(3)
        good = rng.random(7) < 0.6
        covariance = np.kron(np.full((7, 7), 900.0), np.eye(3)) + 0.25 * np.eye(21)
        differences = drift + 0.5 * rng.standard_normal((7, 3))
        differences[~good] += 60.0 * rng.standard_normal((int((~good).sum()), 3))
        best: tuple[int, float, tuple[int, ...]] = (0, 0.0, ())
        for size in range(1, 8):
            for subset in combinations(range(7), size):
                rows = (3 * np.array(subset)[:, None] + np.arange(3)).ravel()
                d = differences[list(subset)].ravel()
                square = float(d @ np.linalg.solve(covariance[np.ix_(rows, rows)], d))
                if square <= chi2.ppf(0.999, 3 * size) and (size, -square) > best[:2]:
                    best = (size, -square, subset)
        if good.sum() >= 3:
            assert tuple(compatible_pairs(differences, covariance, 0.999)) == best[2] == tuple(np.flatnonzero(good))


def test_pairs_that_are_all_impossible_leave_nothing() -> None:
    assert compatible_pairs(np.full((3, 3), 100.0), np.eye(9), 0.999) == []


@pytest.fixture(scope="module")
def global_map() -> GlobalMap:
    """Twelve frames, near the truth."""
    sequence, positions, points = loop(1)
    known = GlobalMap(sequence, motion=True)
    for number in range(12):
        known.add(number, sequence.frames[number])
    known.slam_map.positions_m = dict(enumerate(positions))
    known.slam_map.points_m = dict(enumerate(points))
    return known


def test_what_is_told_from_outside_stands_for_it(global_map: GlobalMap) -> None:
    problem, tracks = global_map.problem()
    views = list(range(12))
    state = minimise(problem, global_map.slam_map.state(views, tracks), StoppingRule(1e-9)).state
    inside = np.arange(12) >= 8
    lost = np.array([min(global_map.seen[t]) < 8 and 11 not in global_map.seen[t] for t in tracks])
    assert 0 < lost.sum() < len(lost)
    seen, moved, measured = problem.pixels, problem.motions, problem.distances
    stays = inside[seen.view] & ~lost[seen.point] & (np.arange(len(seen.view)) % 7 > 0)  # any may go
    arcs = inside[moved.start] & inside[moved.end]
    far = inside[measured.view] & ~lost[measured.point]
    prior = marginalise_outside(problem, state, Retained(inside, ~lost, stays, far))
    rest = replace(
        problem,
        pixels=PixelMeasurements(seen.view[stays], seen.point[stays], seen.uv_px[stays], seen.sigma_px[stays]),
        distances=Distances(measured.view[far], measured.point[far], measured.range_m[far], measured.sigma_m[far]),
        motions=type(moved)(moved.start[arcs], moved.end[arcs], moved.displacement_m[arcs], moved.information[arcs]),
        free_views=inside,
        free_points=~lost,
        prior=prior,
    )
    for view in (8, 9, 11):
        np.testing.assert_allclose(view_covariance(rest, state, view), view_covariance(problem, state, view), rtol=1e-5)
    away = State(state.positions_m + 0.01 * inside[:, None], state.points_m)
    back = minimise(rest, away, StoppingRule(1e-9)).state
    np.testing.assert_allclose(back.positions_m[inside], state.positions_m[inside], atol=1e-4)


def test_covariance_of_landmarks_is_that_of_scipy(global_map: GlobalMap) -> None:
    """Independent residuals, with derivatives by scipy's differences."""
    problem, tracks = global_map.problem(kept=global_map.seen)
    views = list(range(12))
    state = minimise(problem, global_map.slam_map.state(views, tracks), StoppingRule(1e-9)).state
    frames = [global_map.slam_map.frames[view] for view in views]
    count = 3 * 11

    def residuals(x: np.ndarray) -> np.ndarray:
        positions = np.concatenate([state.positions_m[:1], x[:count].reshape(-1, 3)])
        points = dict(zip(tracks, x[count:].reshape(-1, 3), strict=True))
        rows = []
        for k, (frame, position) in enumerate(zip(frames, positions, strict=True)):
            for track, uv in zip(frame.tracks.tolist(), frame.uv_px, strict=True):
                if track in points:
                    x_cam = frame.R_cam_body @ (points[track] - position)
                    seen = CAMERA.fx_px * x_cam[:2] / x_cam[2] + [CAMERA.cx_px, CAMERA.cy_px]
                    rows.extend((seen - uv) / frame.sigma_px)
            rows.extend((np.linalg.norm(points[r.track] - position) - r.range_m) / r.sigma_m for r in frame.ranges)
            if k:
                error = position - positions[k - 1] - frame.motion_m
                rows.extend(error / np.sqrt(frame.motion_covariance_m2[0, 0]))
        return np.array(rows)

    start = np.concatenate([state.positions_m[1:].ravel(), state.points_m.ravel()])
    foreign = least_squares(residuals, start, jac="3-point", x_scale="jac", xtol=1e-12, ftol=1e-12)
    whole = np.linalg.inv(foreign.jac.T @ foreign.jac)[count:, count:]
    chosen = np.array([0, 3, 7])
    rows = (3 * chosen[:, None] + np.arange(3)).ravel()
    scale = np.sqrt(np.diag(whole)[rows])
    joint, _, slots = kept_covariance(problem, state)
    at = (3 * slots[chosen][:, None] + np.arange(3)).ravel()
    found = joint[np.ix_(at, at)] / np.outer(scale, scale)
    np.testing.assert_allclose(found, whole[np.ix_(rows, rows)] / np.outer(scale, scale), atol=1e-3)


def test_united_landmarks_go_by_the_older_number(global_map: GlobalMap) -> None:
    sequence, _, _ = loop(1)
    known = GlobalMap(sequence, motion=True)
    for number, frame in enumerate(sequence.frames[:20]):
        known.add(number, frame)
    pairs = [(int(a), int(b)) for frame in sequence.frames[:20] for a, b in frame.again]
    new, old = pairs[0]
    assert known.may_merge(new, old)
    before = known.seen[new] | known.seen[old]
    known.merge([(new, old)])
    assert known.of(new) == old
    assert known.seen[old] == before
    assert all(new not in frame.tracks for frame in known.slam_map.frames.values())
    assert sum(old in frame.tracks for frame in known.slam_map.frames.values()) == len(before)
    together = [track for track in sequence.frames[0].tracks.tolist() if track != old]
    assert not known.may_merge(together[0], together[1])


def last_errors(estimator, wrong: float, trials: int) -> tuple[np.ndarray, float, int]:
    errors, square, united = [], 0.0, 0
    for seed in range(trials):
        sequence, positions, _ = loop(seed, wrong=wrong)
        estimate = estimator.follow(sequence)
        assert estimate.status == "ok", estimate.reason
        last = estimate.frames[-1]
        error = last.position_m - positions[-1]
        square += error @ np.linalg.solve(last.covariance_m2, error)
        errors.append(np.linalg.norm(error))
        united += int(estimate.diagnostics.get("united", 0))
    return np.array(errors), square, united


def test_a_merged_landmark_goes_on_under_its_track_in_view_or_else_its_newest() -> None:
    """Its other tracks are absorbed, and so are all where only the prior holds it."""
    sequence, _, _ = loop(5)
    options = {"lag": 20, "closure_frames": 3, "closure_pairs": 1, "associations": "all"}
    window = LoopSmoother.from_options(options).follower(sequence)
    counts = {"in view": 0, "newest": 0, "none": 0}
    for frame in sequence.frames[:40]:
        closures = window.closures
        window.advance(frame)
        if window.closures == closures:
            continue
        for landmark, members in window.global_map.members.items():
            seen, kept = members & set(frame.tracks.tolist()), members - window.absorbed
            if seen:
                assert kept == seen
                counts["in view"] += 1
            elif kept:
                assert kept == {max(members)}
                assert min(window.global_map.seen[landmark]) >= window.views[0]
                counts["newest"] += 1
            else:
                counts["none"] += 1
    assert min(counts.values()) > 5


def test_closed_loops_are_predicted_without_the_pairs_that_are_wrong() -> None:
    """The errors of six runs are chi-square, with bounds that chance leaves once in 1000; covariances agree to 5 %."""
    square, method = 0.0, LoopSmoother()
    for seed in range(6):
        sequence, positions, points = loop(seed)
        covariance = method.predict(sequence, positions, points)
        last = method.follow(sequence).frames[-1]
        error = last.position_m - positions[-1]
        square += error @ np.linalg.solve(covariance, error)
        assert np.trace(last.covariance_m2) == pytest.approx(np.trace(covariance), rel=0.05)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 18)
    assert low < square < high
    alone = FixedLagSmoother().predict(sequence, positions, points)
    assert np.trace(covariance) < 0.25 * np.trace(alone)
    frames = list(sequence.frames)
    frames[20] = replace(frames[20], again=np.append(frames[20].again, [[frames[20].tracks[-1], 0]], axis=0))
    mistaken = method.predict(replace(sequence, frames=tuple(frames)), positions, points)
    np.testing.assert_array_equal(mistaken, covariance)
    never = LoopSmoother.from_options({"closure_frames": 100})
    np.testing.assert_array_equal(never.predict(sequence, positions, points), alone)


def test_closed_loops_are_better_and_consistent_also_with_wrong_recognitions() -> None:
    """The sum of squared normalised errors is chi-square; its bounds are left by chance once in 10000."""
    trials = 4
    open_errors, _, _ = last_errors(FixedLagSmoother.from_options({}), 0.0, trials)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 3 * trials)
    for wrong, room in ((0.0, 200), (0.3, 200), (0.0, 5)):  # also with a small limit of the prior
        options = {"closure_frames": 10, "prior_landmarks": room}
        errors, square, united = last_errors(LoopSmoother.from_options(options), wrong, trials)
        assert united > 5 * trials
        assert np.median(errors) < 0.5 * np.median(open_errors)
        assert low < square < high


def test_closed_loops_are_consistent_with_errors_that_add_up_along_tracks() -> None:
    """Bounds as above."""
    trials, told, untold, errors, opened = 4, 0.0, 0.0, [], []
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 3 * trials)
    for trial in range(trials):
        sequence, positions, points = loop(10 + trial)
        rng = np.random.default_rng(trial)
        given = with_track_errors(rng, sequence, Truth(positions, dict(enumerate(points))), 0.5, 2e-4)
        silent = replace(
            given, frames=tuple(replace(f, walk_px=0.0, contraction=0.0, drift_px=0.0) for f in given.frames)
        )
        squares = []
        for one in (given, silent):
            estimate = LoopSmoother.from_options({"closure_frames": 10}).follow(one)
            assert estimate.diagnostics["united"] > 5
            last = estimate.frames[-1]
            error = last.position_m - positions[-1]
            squares.append(error @ np.linalg.solve(last.covariance_m2, error))
            errors += [np.linalg.norm(error)] if one is given else []
        told, untold = told + squares[0], untold + squares[1]
        last = FixedLagSmoother.from_options({}).follow(given).frames[-1]
        opened.append(np.linalg.norm(last.position_m - positions[-1]))
    assert low < told < high < untold
    assert np.median(errors) < 0.5 * np.median(opened)


def test_without_recognitions_it_is_the_fixed_lag_smoother() -> None:
    sequence, _, _ = loop(2)
    frames = tuple(replace(frame, again=np.zeros((0, 2), dtype=np.int64)) for frame in sequence.frames[:20])
    blind = replace(sequence, frames=frames)
    one = LoopSmoother.from_options({}).follow(blind)
    other = FixedLagSmoother.from_options({}).follow(blind)
    for mine, plain in zip(one.frames, other.frames, strict=True):
        np.testing.assert_array_equal(mine.position_m, plain.position_m)


def test_noise_free_loop_is_the_truth() -> None:
    sequence, positions, points = loop(5, noise_px=0.0)
    estimate = LoopSmoother.from_options({"motion": False}).follow(sequence)
    assert estimate.diagnostics["closures"] >= 2
    assert estimate.diagnostics["refused"] == 0
    last = estimate.frames[-1]
    np.testing.assert_allclose(last.position_m, positions[-1], atol=1e-8)
    np.testing.assert_allclose(last.points_m, points[last.tracks], atol=1e-7)


def test_recognitions_wait_until_enough_are_there() -> None:
    sequence, _, _ = loop(5)
    many, few = (
        LoopSmoother.from_options({"closure_frames": 1, "closure_pairs": pairs}).follow(sequence).diagnostics
        for pairs in (1, 20)
    )
    assert few["closures"] < many["closures"]
    assert many["united"] - 20 < few["united"] <= many["united"]


def test_error_of_the_first_position_shifts_all() -> None:
    """A loop closure does not determine the body's centre: the error of the first position stays in the covariance."""
    sequence, _, _ = loop(5)
    shift = np.array([3.0, -2.0, 1.0])
    unsure = replace(sequence, position_m=sequence.position_m + shift, position_covariance_m2=4.0 * np.eye(3))
    sure_last, last = (LoopSmoother.from_options({}).follow(given).frames[-1] for given in (sequence, unsure))
    np.testing.assert_allclose(last.position_m, sure_last.position_m + shift, atol=1e-3)
    assert last.covariance_m2 is not None
    assert sure_last.covariance_m2 is not None
    np.testing.assert_allclose(last.covariance_m2, sure_last.covariance_m2 + 4.0 * np.eye(3), atol=1e-3)


def test_loops_are_closed_without_knowledge_of_later_frames() -> None:
    """A sequence that ends after some closures gives its frames the estimates that they have in the longer one."""
    sequence, _, _ = loop(4)
    short, long = (
        LoopSmoother.from_options({"closure_frames": 3}).follow(replace(sequence, frames=sequence.frames[:n]))
        for n in (32, 48)
    )
    assert 0 < short.diagnostics["closures"] < long.diagnostics["closures"]
    for one, other in zip(short.frames, long.frames, strict=False):
        np.testing.assert_array_equal(one.position_m, other.position_m)
        np.testing.assert_array_equal(one.covariance_m2, other.covariance_m2)
        np.testing.assert_array_equal(one.tracks, other.tracks)
        np.testing.assert_array_equal(one.points_m, other.points_m)
