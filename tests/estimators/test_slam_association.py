"""Outlier rejection in a window: the predicted covariance of the gate, and estimators on tracks with outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from slam_sequences import Recipe, make_sequence, position_errors_m

from boresight.estimators.slam.adjustment.problem import (
    AdjustedWindow,
    Adjustment,
    Distances,
    Motions,
    PixelMeasurements,
    QuadraticPrior,
    State,
)
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import StoppingRule
from boresight.estimators.slam.association.gating import gate_frame
from boresight.estimators.slam.association.outliers import OutlierGate, all_within_gate
from boresight.estimators.slam.association.prediction import SharedUncertainty, predict_lines
from boresight.estimators.slam.keyframes.bundle import BundleSlam
from boresight.estimators.slam.options import SmootherOptions
from boresight.estimators.slam.smoothing.smoother import (
    _WEAK_RATIO,
    BatchAdjustment,
    FixedLagSmoother,
    WindowSmoother,
    _with_weak_lines,
)
from boresight.scenarios.observation import TrackRange, TrackSequence

SHARE = 0.05


def thrown(sequence: TrackSequence, seed: int) -> tuple[TrackSequence, list[set[int]]]:
    """Put some pixels, but the first of no track, anywhere in the image; also return which."""
    rng = np.random.default_rng(seed)
    frames, wrong, older = [sequence.frames[0]], [set[int]()], sequence.frames[0].tracks
    for frame in sequence.frames[1:]:
        off = (rng.random(len(frame.tracks)) < SHARE) & np.isin(frame.tracks, older)
        uv = np.where(off[:, None], rng.uniform(0.0, 1024.0, frame.uv_px.shape), frame.uv_px)
        frames.append(replace(frame, uv_px=uv))
        wrong.append(set(frame.tracks[off].tolist()))
        older = frame.tracks
    return replace(sequence, frames=tuple(frames)), wrong


def misplaced_gauge(sequence: TrackSequence) -> TrackSequence:
    """Misplace the pixel of the ranged landmark in the second frame."""
    gauge = sequence.frames[0].ranges[0].track
    second = sequence.frames[1]
    uv = np.where((second.tracks == gauge)[:, None], second.uv_px + np.array([120.0, -70.0]), second.uv_px)
    return replace(sequence, frames=(sequence.frames[0], replace(second, uv_px=uv), *sequence.frames[2:]))


@pytest.mark.parametrize(
    ("estimator", "options"), [(FixedLagSmoother, {"lag": 6}), (BundleSlam, {}), (BatchAdjustment, {})]
)
def test_wrong_associations_cost_little(estimator: type[FixedLagSmoother], options: dict[str, object]) -> None:
    """5 % outliers: used, they increase the error many times; refused, hardly."""
    frames = 10 if estimator is BatchAdjustment else 30
    sequence, truth = make_sequence(np.random.default_rng(8), Recipe(frames=frames, landmarks=20))
    spoilt, _ = thrown(sequence, 77)
    clean = position_errors_m(estimator.from_options({**options, "associations": "all"}).follow(sequence), truth).mean()
    believing = estimator.from_options({**options, "associations": "all"}).follow(spoilt)
    assert believing.status == "failed" or position_errors_m(believing, truth).mean() > 5.0 * clean
    estimate = estimator.from_options({**options, "associations": "consensus"}).follow(spoilt)
    assert estimate.status == "ok", estimate.reason
    assert position_errors_m(estimate, truth).mean() < 1.5 * clean + 0.3


def test_gate_refuses_the_wrong_and_few_of_the_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """One correct pixel in a thousand is refused; 12 sequences of 19 frames have about 4000."""
    gates: list[OutlierGate] = []
    original = OutlierGate.drop_view

    def remember(self: OutlierGate, view: int) -> None:
        gates.append(self)
        last[id(self), view] = set(self.refused.get(view, set()))
        original(self, view)

    last: dict[tuple[int, int], set[int]] = {}
    monkeypatch.setattr(OutlierGate, "drop_view", remember)
    missed = wrongly = total = 0
    for trial in range(12):
        last.clear()
        sequence, _ = make_sequence(np.random.default_rng([5, trial]), Recipe(frames=25, landmarks=18))
        spoilt, wrong = thrown(sequence, trial)
        assert FixedLagSmoother.from_options({"lag": 6}).follow(spoilt).status == "ok"
        for (_, view), refused in last.items():
            missed += len(wrong[view] - refused)
            wrongly += len(refused - wrong[view])
            total += len(wrong[view])
    assert total > 100
    assert missed <= 0.06 * total  # some fall within the noise, others on a track that ends at once
    assert wrongly < 30


def test_cheap_judgement_of_a_frame_is_that_by_the_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a frame passes the fast test, the gate with the full covariance refuses no outlier and few correct pixels."""
    judged = {"at once": 0, "frames": 0, "right": 0, "wrong": 0, "pixels": 0}
    wrong: list[set[int]] = []

    def both(self: OutlierGate, view: int, before: AdjustedWindow | None, rule: StoppingRule, depth_m: float) -> None:
        place(self, view, before, rule, depth_m)
        if before is None:
            return
        self.slam_map.place(view, rule)  # as before the gate
        matches = self._match_frame(view, before, depth_m)
        judged["frames"] += 1
        if not self.refused.get(view) and all_within_gate(
            self.slam_map, matches, (before.problem, before.state), self.limit
        ):
            judged["at once"] += 1
            seen = predict_lines(self.slam_map, matches, before)
            frame = self.raw_frames[view]
            noise_px2 = np.full(len(seen.rows), frame.sigma_px**2)
            fit = gate_frame(self.slam_map.camera, frame, seen, noise_px2, self.false_alarm, self.limit)
            otherwise = set(self.raw_frames[view].tracks[seen.rows[~fit]].tolist())
            judged["wrong"] += len(otherwise & wrong[view])
            judged["right"] += len(otherwise - wrong[view])
            judged["pixels"] += len(fit)

    place = OutlierGate.place
    monkeypatch.setattr(OutlierGate, "place", both)
    for trial in range(8):
        sequence, _ = make_sequence(np.random.default_rng([5, trial]), Recipe(frames=25, landmarks=18))
        spoilt, thrown_off = thrown(sequence, trial)
        for data, wrong in ((sequence, [set[int]()] * 25), (spoilt, thrown_off)):  # noqa: B007
            assert FixedLagSmoother.from_options({"lag": 6}).follow(data).status == "ok"
    assert judged["at once"] > 0.4 * judged["frames"]
    assert judged["wrong"] == 0
    assert judged["right"] <= 0.002 * judged["pixels"]


def test_wrong_range_landmark_in_the_second_frame_does_not_take_the_scale() -> None:
    """The one ranged landmark is misplaced once; the scale is recovered with its next pixel."""
    sequence, truth = make_sequence(np.random.default_rng(8), Recipe(frames=25, landmarks=20))
    estimate = FixedLagSmoother.from_options({}).follow(misplaced_gauge(sequence))
    assert estimate.status == "ok", estimate.reason
    clean = FixedLagSmoother.from_options({"associations": "all"}).follow(sequence)
    assert position_errors_m(estimate, truth)[2:].max() < 2.0 * position_errors_m(clean, truth).max() + 0.3


def test_covariance_of_what_is_expected_is_that_of_scipy() -> None:
    """Three views and four landmarks, all but one eliminated, against one dense least-squares problem."""
    rng = np.random.default_rng(4)
    sequence, truth = make_sequence(rng, Recipe(frames=3, landmarks=15))
    tracks = sorted(set.intersection(*(set(frame.tracks.tolist()) for frame in sequence.frames)))[:4]
    slam_map = SlamMap(sequence.camera)
    slam_map.frames.update(enumerate(sequence.frames))
    state = State(truth.positions_m[:3].copy(), np.array([truth.points_m[track] for track in tracks]))
    prior = QuadraticPrior(
        np.array([1]), np.array([2]), np.zeros((2, 3)), np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), np.zeros(6)
    )
    one = np.array([0])
    problem = Adjustment(
        camera=sequence.camera,
        R_cam_body=slam_map.attitudes([0, 1, 2]),
        pixels=slam_map.pixels([0, 1, 2], tracks),
        free_views=np.array([False, True, True]),
        free_points=np.ones(4, dtype=np.bool_),
        distances=Distances(one, one, np.array([600.0]), np.array([0.5])),
        motions=Motions(np.array([1]), np.array([2]), np.zeros((1, 3)), np.diag([0.1, 0.2, 0.3])[None]),
        prior=prior,
    )
    seen: PixelMeasurements = problem.pixels

    def residuals(x: np.ndarray) -> np.ndarray:
        positions = np.concatenate([state.positions_m[:1], x[:6].reshape(2, 3)])
        points = x[6:].reshape(4, 3)
        rows = []
        for view, point, sigma in zip(seen.view, seen.point, seen.sigma_px, strict=True):
            ray = problem.R_cam_body[view] @ (points[point] - positions[view])
            rows.extend(sequence.camera.fx_px * ray[:2] / ray[2] / sigma)
        rows.append(np.linalg.norm(points[0] - positions[0]) / 0.5)
        rows.extend(np.sqrt([0.1, 0.2, 0.3]) * (positions[2] - positions[1]))
        rows.extend(np.sqrt([1.0, 2.0, 3.0]) * positions[1])
        rows.extend(np.sqrt([4.0, 5.0, 6.0]) * points[2])
        return np.array(rows)

    x = np.concatenate([state.positions_m[1:].ravel(), state.points_m.ravel()])
    jacobian = least_squares(residuals, x, method="trf", max_nfev=1, jac="3-point").jac
    # one evaluation: derivatives at the initial state
    common = SharedUncertainty.of((problem, state), (0, 1, 2), np.zeros((3, 3)))
    by_landmark, own = common.by_landmarks(problem, state, (0, 1, 2), np.arange(4))
    rows = np.concatenate([common.by_view(1), common.by_view(2), *by_landmark])
    found = rows @ common.covariance @ rows.T
    for k in range(4):
        found[6 + 3 * k : 9 + 3 * k, 6 + 3 * k : 9 + 3 * k] += own[k]
    np.testing.assert_allclose(found, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(common.by_view(0), 0.0)


def test_refused_pixels_do_not_move_the_window_of_keyframes() -> None:
    """A landmark with a refused pixel counts as in view: the oldest view of the window stays."""
    for trial in range(3):
        sequence, _ = make_sequence(np.random.default_rng([6, trial]), Recipe(frames=60, landmarks=12))
        spoilt, wrong = thrown(sequence, trial)
        assert sum(map(len, wrong)) > 5
        clean = BundleSlam.from_options({}).follow(sequence).diagnostics
        gated = BundleSlam.from_options({"associations": "consensus"}).follow(spoilt).diagnostics
        assert gated["window_shifts"] == clean["window_shifts"] > 2


def test_bundle_waits_a_frame_where_the_gauge_is_refused() -> None:
    """The one ranged landmark is misplaced in the second frame: the scale is undetermined until the third."""
    sequence, truth = make_sequence(np.random.default_rng(8), Recipe(frames=25, landmarks=20))
    spoilt = misplaced_gauge(sequence)
    gated = BundleSlam.from_options({"associations": "consensus"}).follow(spoilt)
    assert gated.status == "ok", gated.reason
    clean = BundleSlam.from_options({}).follow(sequence)
    assert position_errors_m(gated, truth)[2:].max() < 2.0 * position_errors_m(clean, truth).max() + 0.3
    believing = BundleSlam.from_options({}).follow(spoilt)
    assert position_errors_m(believing, truth)[1] > 5.0 * position_errors_m(gated, truth)[1]


@pytest.mark.parametrize(("wrong", "reliable"), [(3, True), (5, False)])
def test_prediction_that_most_pixels_contradict_refuses_none(wrong: int, reliable: bool) -> None:
    """The camera stays where it was, and all distances are measured: some of eight pixels move."""
    rng = np.random.default_rng(6)
    sequence, _ = make_sequence(rng, Recipe(frames=1, landmarks=30, noise_px=0.0))
    frame = sequence.frames[0]
    rows = np.arange(len(frame.tracks)) < 8
    first = replace(frame, tracks=frame.tracks[rows], uv_px=frame.uv_px[rows])
    first = replace(first, ranges=tuple(TrackRange(track, 600.0, 0.01) for track in first.tracks.tolist()))
    uv_px = first.uv_px.copy()
    uv_px[:wrong] += rng.choice([-50.0, 50.0], (wrong, 2))
    moved = {"motion_m": np.zeros(3), "motion_covariance_m2": 1e-6 * np.eye(3)}
    second = replace(first, time_s=1.0, uv_px=uv_px, sigma_px=0.5, ranges=(), **moved)
    slam_map = SlamMap(sequence.camera)
    gate = OutlierGate(slam_map, SmootherOptions())
    gate.add_frame(0, replace(first, sigma_px=0.5))
    slam_map.positions_m[0] = sequence.position_m.copy()
    slam_map.first_estimate(np.zeros((3, 3)))
    gate.add_frame(1, second)
    gate.place(1, None, StoppingRule(1e-6), 600.0)
    assert gate.refused.get(1, set()) == (set(first.tracks[:wrong].tolist()) if reliable else set())


def test_weak_lines_hold_differences_from_the_first_view_alone() -> None:
    """A landmark alone gains its squared displacement over ten depths; a common translation gains nothing."""
    root = np.random.default_rng(2).standard_normal((12, 12))
    prior = QuadraticPrior(np.array([0, 1]), np.array([4, 5]), np.zeros((4, 3)), root @ root.T, np.zeros(12))
    added = _with_weak_lines(prior, np.array([False, True]), 50.0).information - prior.information
    along = np.array([0.0, 3.0, 4.0])
    common, alone = np.tile(along, 4), np.concatenate([np.zeros(9), along])
    assert common @ added @ common == pytest.approx(0.0, abs=1e-12)
    assert alone @ added @ alone == pytest.approx((5.0 / (_WEAK_RATIO * 50.0)) ** 2)
    np.testing.assert_array_equal(added, added.T)
    assert not added[3:9].any()


def test_noise_of_the_attitude_adds_to_that_of_the_pixels() -> None:
    """Independent errors: variances add, a small angle times the focal length."""
    sequence, _ = make_sequence(np.random.default_rng(1), Recipe(frames=1))
    frame = replace(sequence.frames[0], sigma_px=0.6, attitude_sigma_rad=0.8 / sequence.camera.fx_px)
    known, noisy = (WindowSmoother(sequence, SmootherOptions(attitude=name)) for name in ("known", "noisy"))
    assert known.weighted(frame).sigma_px == 0.6
    assert noisy.weighted(frame).sigma_px == pytest.approx(1.0)
