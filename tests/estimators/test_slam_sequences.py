"""Sequence estimators on a small world: the truth without noise, consistency, reasons of failure."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from slam_orbits import Drive, make_orbit_sequence
from slam_sequences import Recipe, make_sequence, position_errors_m

from boresight.estimators.registry import sequence_estimator_class, sequence_estimator_names
from boresight.estimators.slam.contract import FrameEstimate
from boresight.estimators.slam.filters.ekf import ConsistentEkfSlam, EkfSlam, IteratedEkfSlam
from boresight.estimators.slam.keyframes.bundle import BundleSlam
from boresight.estimators.slam.smoothing.dynamic_smoother import DynamicSmoother
from boresight.estimators.slam.smoothing.loop_smoother import LoopSmoother
from boresight.estimators.slam.smoothing.smoother import BatchAdjustment, FixedLagSmoother
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.observation import TrackRange, TrackSequence

QUIET = Recipe(frames=40, noise_px=0.0, repeatability=0.95)
ALL = [
    BundleSlam,
    EkfSlam,
    IteratedEkfSlam,
    ConsistentEkfSlam,
    FixedLagSmoother,
    LoopSmoother,
    DynamicSmoother,
    BatchAdjustment,
]


def changed(sequence: TrackSequence, number: int, **values: object) -> TrackSequence:
    frames = list(sequence.frames)
    frames[number] = replace(frames[number], **values)
    return replace(sequence, frames=tuple(frames))


def lonely(sequence: TrackSequence, number: int) -> TrackSequence:
    """All tracks but two are lost at a frame, and new ones come."""
    frames = list(sequence.frames)
    for k in range(number, len(frames)):
        old = np.sort(frames[number - 1].tracks)[2:]
        tracks = np.where(np.isin(frames[k].tracks, old), frames[k].tracks + 100000, frames[k].tracks)
        frames[k] = replace(frames[k], tracks=tracks)
    return replace(sequence, frames=tuple(frames))


def thrown(sequence: TrackSequence, share: float) -> TrackSequence:
    """Put a share of the pixels, but the first of no track, anywhere in the image."""
    rng = np.random.default_rng(77)
    frames, older = [], sequence.frames[0].tracks
    for frame in sequence.frames:
        wrong = (rng.random(len(frame.tracks)) < share) & np.isin(frame.tracks, older)
        anywhere = rng.uniform(0.0, 1024.0, frame.uv_px.shape)
        first = frame is sequence.frames[0]
        frames.append(frame if first else replace(frame, uv_px=np.where(wrong[:, None], anywhere, frame.uv_px)))
        older = frame.tracks
    return replace(sequence, frames=tuple(frames))


@pytest.mark.parametrize(
    ("estimator", "options"),
    [
        (BundleSlam, {}),
        (BundleSlam, {"steps": "full"}),
        (BundleSlam, {"strategy": "offset", "offset_frames": 3}),
        (FixedLagSmoother, {"motion": False}),
        (FixedLagSmoother, {"motion": False, "first_estimates": False, "lag": 5}),
        (BatchAdjustment, {"motion": False}),
    ],
)
def test_noise_free_sequence_returns_the_truth(estimator: type[BundleSlam], options: dict[str, object]) -> None:
    """Predicted motions have errors of half the displacement."""
    sequence, truth = make_sequence(np.random.default_rng(11), QUIET)
    estimate = estimator.from_options({"tolerance": 1e-10, **options}).follow(sequence)
    assert estimate.status == "ok", estimate.reason
    assert len(estimate.frames) == len(sequence.frames)
    assert position_errors_m(estimate, truth).max() < 1e-9 * 790.0
    last = estimate.frames[-1]
    true = np.array([truth.points_m[track] for track in last.tracks.tolist()])
    np.testing.assert_allclose(last.points_m, true, atol=1e-9 * 790.0)


@pytest.mark.parametrize("estimator", [EkfSlam, IteratedEkfSlam, ConsistentEkfSlam])
def test_filter_returns_the_truth_where_nothing_is_guessed(estimator: type[EkfSlam]) -> None:
    """A filter that linearises at guessed distances is not exact; with all ranges and motions there are none."""
    recipe = replace(QUIET, motion_error=0.0, range_all=True)
    sequence, truth = make_sequence(np.random.default_rng(11), recipe)
    estimate = estimator.from_options({}).follow(sequence)
    assert estimate.status == "ok", estimate.reason
    assert position_errors_m(estimate, truth).max() < 1e-9 * 790.0


@pytest.mark.parametrize(
    ("estimator", "options"),
    [
        (BatchAdjustment, {"motion": False}),
        (FixedLagSmoother, {"motion": False, "lag": 5}),
        (BundleSlam, {"strategy": "offset", "offset_frames": 1, "views": 5}),
    ],
)
def test_window_of_all_frames_is_the_minimum_of_scipy(estimator: type[BundleSlam], options: dict[str, object]) -> None:
    """All frames, with residuals that are independent of the product's."""
    sequence, truth = make_sequence(np.random.default_rng(2), Recipe(frames=5, landmarks=8))
    estimate = estimator.from_options(options).follow(sequence)
    tracks = estimate.frames[-1].tracks.tolist()
    slots = {track: slot for slot, track in enumerate(tracks)}

    def residuals(x: np.ndarray) -> np.ndarray:
        positions = np.concatenate([sequence.position_m[None], x[:12].reshape(-1, 3)])
        points = x[12:].reshape(-1, 3)
        rows = []
        for frame, position in zip(sequence.frames, positions, strict=True):
            for track, uv in zip(frame.tracks.tolist(), frame.uv_px, strict=True):
                if track in slots:
                    x_cam = frame.R_cam_body @ (points[slots[track]] - position)
                    seen = sequence.camera.fx_px * x_cam[:2] / x_cam[2] + [sequence.camera.cx_px, sequence.camera.cy_px]
                    rows.extend((seen - uv) / frame.sigma_px)
            for item in frame.ranges:
                length = np.linalg.norm(points[slots[item.track]] - position)
                rows.append((length - item.range_m) / item.sigma_m)
        return np.array(rows)

    true = np.array([truth.points_m[track] for track in tracks])
    start = np.concatenate([truth.positions_m[1:].ravel(), true.ravel()])
    foreign = least_squares(residuals, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    np.testing.assert_allclose(estimate.frames[-1].position_m, foreign.x[9:12], atol=2e-3)
    if estimator is BundleSlam:
        return
    covariance = np.linalg.inv(foreign.jac.T @ foreign.jac)[9:12, 9:12]
    np.testing.assert_allclose(estimate.frames[-1].covariance_m2, covariance, rtol=1e-2, atol=1e-4)


def test_errors_of_the_smoother_are_what_its_covariance_says_also_with_a_small_prior() -> None:
    """The sum of 12 normalised squared errors is chi-square of 36; the bounds are left by chance once in 10000.

    A prior of four landmarks of about ten knows less: no measurement is used twice.
    """
    totals = np.zeros(2)
    for trial in range(12):
        sequence, truth = make_sequence(np.random.default_rng([21, trial]), Recipe(frames=25, landmarks=20))
        whole, capped = (
            FixedLagSmoother.from_options({"lag": 6, **more}).follow(sequence) for more in ({}, {"prior_landmarks": 4})
        )
        assert capped.diagnostics["prior_variables"] <= 4 + 6 < whole.diagnostics["prior_variables"]
        covariances = [estimate.frames[-1].covariance_m2 for estimate in (whole, capped)]
        assert np.trace(covariances[1]) > 1.02 * np.trace(covariances[0])
        for k, estimate in enumerate((whole, capped)):
            error = estimate.frames[-1].position_m - truth.positions_m[-1]
            totals[k] += error @ np.linalg.solve(covariances[k], error)
    assert ((totals > 11.9) & (totals < 79.0)).all()


def test_long_lag_is_the_batch() -> None:
    sequence, _ = make_sequence(np.random.default_rng(4), Recipe(frames=8))
    batch = BatchAdjustment.from_options({}).follow(sequence).frames[-1]
    smoother = FixedLagSmoother.from_options({"lag": 8}).follow(sequence).frames[-1]
    np.testing.assert_allclose(smoother.position_m, batch.position_m, atol=1e-6)
    short = FixedLagSmoother.from_options({"lag": 3}).follow(sequence).frames[-1]
    assert batch.covariance_m2 is not None
    sigma = np.sqrt(np.trace(batch.covariance_m2))
    assert 0.0 < np.linalg.norm(short.position_m - batch.position_m) < sigma


@pytest.mark.parametrize("estimator", ALL)
def test_later_range_corrects_the_scale(estimator: type[FixedLagSmoother]) -> None:
    """The first range has an error of 1 %, its standard deviation; the one at frame 12 is exact."""
    drive = Drive(noise_m_s2=1e-5, velocity_sigma_m_s=0.05, spinning=False)
    sequence, truth = make_orbit_sequence(np.random.default_rng(11), QUIET, drive)
    sequence = replace(sequence, frames=tuple(replace(frame, sigma_px=0.67) for frame in sequence.frames))
    first, later = sequence.frames[0], sequence.frames[12]
    wrong = replace(first.ranges[0], range_m=1.01 * first.ranges[0].range_m, sigma_m=6.0)
    track = int(np.intersect1d(sequence.frames[11].tracks, later.tracks)[0])
    distance = float(np.linalg.norm(truth.points_m[track] - truth.positions_m[12]))
    misled = changed(sequence, 0, ranges=(wrong,))
    righted = changed(misled, 12, ranges=(TrackRange(track, distance, 0.01),))
    for given, low, high in ((misled, 0.005, 0.05), (righted, 0.0, 0.001)):
        estimate = estimator.from_options({}).follow(replace(given, frames=given.frames[:14]))
        assert estimate.status == "ok", estimate.reason
        frame = estimate.frames[13]
        slot = int(np.flatnonzero(frame.tracks == track)[0])
        found = np.linalg.norm(frame.points_m[slot] - frame.position_m)
        assert low <= abs(found / np.linalg.norm(truth.points_m[track] - truth.positions_m[13]) - 1.0) < high


@pytest.mark.parametrize("estimator", [EkfSlam, FixedLagSmoother, BatchAdjustment])
def test_error_of_the_first_position_shifts_all(estimator: type[FixedLagSmoother]) -> None:
    """Bearings and ranges do not determine the body's centre: the error of the first position stays."""
    sequence, _ = make_sequence(np.random.default_rng(9), Recipe(frames=12))
    shift = np.array([3.0, -2.0, 1.0])
    unsure = replace(sequence, position_m=sequence.position_m + shift, position_covariance_m2=4.0 * np.eye(3))
    options = {"lag": 5} if estimator is FixedLagSmoother else {}
    sure_last = estimator.from_options(options).follow(sequence).frames[-1]
    last = estimator.from_options(options).follow(unsure).frames[-1]
    np.testing.assert_allclose(last.position_m, sure_last.position_m + shift, atol=1e-4)
    assert last.covariance_m2 is not None
    assert sure_last.covariance_m2 is not None
    np.testing.assert_allclose(last.covariance_m2, sure_last.covariance_m2 + 4.0 * np.eye(3), atol=1e-4)


def same_but_for_the_time(one: FrameEstimate, other: FrameEstimate) -> None:
    """All values of two estimates of a frame, to the last bit."""
    for name in (field.name for field in fields(FrameEstimate) if field.name != "seconds"):
        first, second = getattr(one, name), getattr(other, name)
        assert (first is None) == (second is None), name
        if first is not None:
            np.testing.assert_array_equal(first, second, err_msg=name)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, {}) for name in sequence_estimator_names()),
        ("ba-slam", {"strategy": "offset", "offset_frames": 2}),
        ("ba-slam", {"associations": "consensus"}),
        ("ba-slam", {"motion": "constant-gain"}),
        ("ekf-slam", {"camera": "pose", "gate": "one-point"}),
        ("fixed-lag", {"lag": 4, "attitude": "noisy", "prior_landmarks": 4}),
    ],
)
def test_estimate_does_not_know_later_frames(name: str, options: dict[str, object]) -> None:
    """The estimate of a frame does not depend on later frames, nor on whether there are any."""
    if name.startswith("gtsam-"):
        pytest.importorskip("gtsam", reason="gtsam is not installed")
    sequence, _ = make_orbit_sequence(np.random.default_rng(6), Recipe(frames=21))
    sequence = thrown(sequence, 0.05) if options.get("associations") or options.get("gate") else sequence
    found = sequence_estimator_class(name)
    assert found.name == name
    whole = found.from_options(options).follow(sequence)
    assert whole.status == "ok", whole.reason
    for seen in (2, 8, 15):
        ended = replace(sequence, frames=sequence.frames[:seen])
        blank = [replace(frame, tracks=frame.tracks[:0], uv_px=frame.uv_px[:0]) for frame in sequence.frames[seen:]]
        blinded = replace(sequence, frames=(*ended.frames, *blank))
        for other in (ended, blinded):
            part = found.from_options(options).follow(other)
            assert len(part.frames) >= seen
            for one, two in zip(part.frames[:seen], whole.frames, strict=False):
                same_but_for_the_time(one, two)


@pytest.mark.parametrize("estimator", ALL)
@pytest.mark.parametrize(
    ("spoil", "frames", "reason"),
    [
        (lambda s: changed(s, 6, tracks=s.frames[6].tracks[:0], uv_px=s.frames[6].uv_px[:0]), 6, "the frame is empty"),
        (lambda s: changed(s, 6, time_s=s.frames[5].time_s), 6, "frames must be in order"),
        (lambda s: changed(s, 0, ranges=()), 0, "the scale is unobservable"),
        (lambda s: lonely(s, 6), 6, "tracks are lost"),
        (lambda s: changed(s, 6, uv_px=np.full_like(s.frames[6].uv_px, np.nan)), 6, "not finite"),
        (lambda s: replace(s, frames=()), 0, "no frame"),
    ],
)
def test_bad_sequence_ends_with_a_reason_and_the_frames_before(
    estimator: type[BundleSlam], spoil, frames: int, reason: str
) -> None:
    sequence, _ = make_orbit_sequence(np.random.default_rng(8), Recipe(frames=10), Drive(spinning=False))
    estimate = estimator.from_options({}).follow(spoil(sequence))
    assert estimate.status == "failed"
    assert reason in estimate.reason
    assert len(estimate.frames) == frames


@pytest.mark.parametrize("estimator", [EkfSlam, IteratedEkfSlam, ConsistentEkfSlam])
def test_filter_declares_its_divergence(estimator: type[EkfSlam]) -> None:
    """Bearings are far noisier than the filter assumes; the estimates before the failure are kept."""
    sequence, _ = make_sequence(np.random.default_rng(8), Recipe(frames=30, noise_px=6.0))
    wrong = replace(sequence, frames=tuple(replace(frame, sigma_px=0.5) for frame in sequence.frames))
    estimate = estimator.from_options({}).follow(wrong)
    assert estimate.status == "failed"
    assert "the filter diverges" in estimate.reason
    assert 0 < len(estimate.frames) < 30
    assert np.isfinite(estimate.frames[-1].position_m).all()


def test_gate_that_refuses_most_declares_the_divergence() -> None:
    """Pixels that pass a gate always fit: the share of refusals shows the divergence."""
    sequence, _ = make_sequence(np.random.default_rng(8), Recipe(frames=30, noise_px=6.0))
    wrong = replace(sequence, frames=tuple(replace(frame, sigma_px=0.1) for frame in sequence.frames))
    estimate = ConsistentEkfSlam.from_options({"gate": "one-point"}).follow(wrong)
    assert estimate.status == "failed"
    assert "pixels of the last frames do not fit" in estimate.reason
    assert len(estimate.frames) > 0


@pytest.mark.parametrize("estimator", [EkfSlam, IteratedEkfSlam, ConsistentEkfSlam])
def test_gated_filter_survives_wrong_associations(estimator: type[EkfSlam]) -> None:
    """5 % of the pixels are anywhere in the image; without a gate the filter diverges."""
    sequence, truth = make_sequence(np.random.default_rng(8), Recipe(frames=40, landmarks=20))
    clean = estimator.from_options({}).follow(sequence)
    spoilt = thrown(sequence, 0.05)
    assert estimator.from_options({}).follow(spoilt).status == "failed"
    estimate = estimator.from_options({"gate": "one-point"}).follow(spoilt)
    assert estimate.status == "ok", estimate.reason
    assert position_errors_m(estimate, truth).max() < 1.5 * position_errors_m(clean, truth).max() + 0.5
    assert estimate.diagnostics["refused_pixels"] > 0.04 * sum(len(frame.tracks) for frame in sequence.frames[1:])


@pytest.mark.parametrize(
    ("estimator", "options"),
    [(BundleSlam, {}), (FixedLagSmoother, {"motion": False}), (BatchAdjustment, {"motion": False})],
)
def test_gauge_with_a_track_of_one_view_loses_the_scale(estimator: type[BundleSlam], options: dict[str, bool]) -> None:
    sequence, _ = make_sequence(np.random.default_rng(8), Recipe(frames=6))
    gauge = sequence.frames[0].ranges[0].track
    frames = [sequence.frames[0]]
    for frame in sequence.frames[1:]:
        kept = frame.tracks != gauge
        frames.append(replace(frame, tracks=frame.tracks[kept], uv_px=frame.uv_px[kept]))
    estimate = estimator.from_options(options).follow(replace(sequence, frames=tuple(frames)))
    assert estimate.status == "failed"
    assert "scale is" in estimate.reason
    assert len(estimate.frames) == 1


def test_wrong_option_is_refused() -> None:
    with pytest.raises(BoresightError, match="ba-slam: views"):
        BundleSlam.from_options({"views": 1})
