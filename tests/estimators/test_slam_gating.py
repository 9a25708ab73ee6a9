"""Innovation gates: false-alarm rates, and outliers found with a wrong predicted position."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.stats import binom, chi2, multivariate_normal

from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Adjustment, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.association.gating import gate_frame, gate_pixels, snooped
from boresight.estimators.slam.association.outliers import OutlierGate
from boresight.estimators.slam.association.prediction import PredictedLines
from boresight.estimators.slam.options import OutlierOptions
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame

COMMON_PX = 30.0
OWN_PX = 0.7


def covariance(n: int) -> np.ndarray:
    """All pixels move together with the camera, and each has an error of its own."""
    common = np.kron(np.ones((n, n)), COMMON_PX**2 * np.eye(2))
    return common + OWN_PX**2 * np.eye(2 * n)


def drawn(rng: np.random.Generator, n: int) -> np.ndarray:
    return COMMON_PX * rng.standard_normal(2) + OWN_PX * rng.standard_normal((n, 2))


@pytest.mark.parametrize("gate", ["individual", "one-point"])
def test_right_pixels_are_refused_as_often_as_asked(gate: Literal["individual", "one-point"]) -> None:
    """One pixel a time is chi-square of two degrees; the bounds are left by chance once in a thousand."""
    rng = np.random.default_rng(1)
    refused = sum(not gate_pixels(drawn(rng, 1), covariance(1), gate, 0.05)[0] for _ in range(2000))
    assert binom.ppf(0.0005, 2000, 0.05) <= refused <= binom.ppf(0.9995, 2000, 0.05)


def test_consensus_refuses_few_right_pixels_of_many() -> None:
    """Each is refused with at most the given probability, sometimes because the hypothesis itself is poor."""
    rng = np.random.default_rng(2)
    kept = [gate_pixels(drawn(rng, 20), covariance(20), "one-point", 0.001) for _ in range(200)]
    assert np.mean(kept) > 0.997


@pytest.mark.parametrize("wrong", [1, 3, 7])
def test_consensus_finds_what_gates_one_by_one_let_pass(wrong: int) -> None:
    """Outliers of up to 20 px within a common error of 30 px: each pixel passes its individual gate."""
    rng = np.random.default_rng(wrong)
    missed_alone = 0
    for _ in range(50):
        residual = drawn(rng, 15)
        residual[:wrong] += 8.0 * np.sign(rng.standard_normal((wrong, 2))) * rng.uniform(1.0, 2.0, (wrong, 2))
        alone = gate_pixels(residual, covariance(15), "individual", 0.001)
        together = gate_pixels(residual, covariance(15), "one-point", 0.001)
        missed_alone += int(alone[:wrong].sum())
        assert not together[:wrong].any()
        assert together[wrong:].sum() >= 15 - wrong - 1
    assert missed_alone > 25 * wrong


def test_no_gate_believes_all() -> None:
    assert gate_pixels(np.full((3, 2), 1e6), covariance(3), "none", 0.001).all()
    assert gate_pixels(np.zeros((0, 2)), np.zeros((0, 0)), "one-point", 0.001).shape == (0,)


FALSE_ALARM = 0.01
LIMIT = chi2.isf(FALSE_ALARM, 2)
AROUND = [(0.99, True), (1.01, False)]
CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))


@pytest.mark.parametrize(("share", "passes"), AROUND)
@pytest.mark.parametrize("gate", ["individual", "one-point"])
def test_limit_of_one_pixel_is_that_of_scipy(
    gate: Literal["individual", "one-point"], share: float, passes: bool
) -> None:
    spread = np.array([[4.0, 1.0], [1.0, 9.0]])
    residual = np.sqrt(share * LIMIT) * np.linalg.cholesky(spread) @ [0.6, -0.8]
    assert gate_pixels(residual[None], spread, gate, FALSE_ALARM)[0] == passes


def contradicting(share: float, n: int = 8) -> np.ndarray:
    """Residuals of which the first contradicts all others by a share of the limit; scipy conditions the field."""
    residual, joint = np.zeros(2 * n), covariance(n)
    gain = joint[:2, 2:] @ np.linalg.inv(joint[2:, 2:])
    spread = joint[:2, :2] - gain @ joint[2:, :2]
    residual[:2] = np.sqrt(share * LIMIT) * np.linalg.cholesky(spread) @ [0.8, 0.6]
    # The density of the whole over that of the others is the conditional one, -d2 / 2 and its constant.
    whole = multivariate_normal(np.zeros(2 * n), joint).logpdf(residual)
    density = whole - multivariate_normal(np.zeros(2 * n - 2), joint[2:, 2:]).logpdf(residual[2:])
    peak = multivariate_normal(np.zeros(2), spread).logpdf(np.zeros(2))
    assert density == pytest.approx(peak - 0.5 * share * LIMIT)
    return residual.reshape(n, 2)


@pytest.mark.parametrize(("share", "passes"), AROUND)
def test_pixel_that_the_others_contradict_is_refused_at_the_limit(share: float, passes: bool) -> None:
    """By data snooping and by the whole gate, whose hypotheses, core and readmission have the same limit."""
    residual, others = contradicting(share), np.arange(8) > 0
    for kept in (
        snooped(residual, covariance(8), np.ones(8, dtype=bool), LIMIT),
        gate_pixels(residual, covariance(8), "one-point", FALSE_ALARM),
    ):
        np.testing.assert_array_equal(kept, others | passes)


def test_of_two_pixels_that_contradict_each_other_one_passes() -> None:
    """Data snooping cannot choose between two: the limit of the hypotheses alone keeps them apart."""
    residual = np.array([[0.0, 0.0], [np.sqrt(3.0 * LIMIT), 0.0]]) * np.sqrt(2.0) * OWN_PX
    assert gate_pixels(residual, covariance(2), "one-point", FALSE_ALARM).sum() == 1


def frame_of(points_m: np.ndarray, camera_m: np.ndarray, noise_px: float = 0.5) -> TrackFrame:
    """A frame without noise, in axes of the body."""
    uv_px = CAMERA.project(points_m - camera_m)
    tracks = np.arange(len(points_m))
    return TrackFrame(1.0, np.eye(3), tracks, uv_px, noise_px, np.zeros(3), np.eye(3))


def lines_to(points_m: np.ndarray, covariance_m2: np.ndarray, known: np.ndarray, own_m2: float) -> PredictedLines:
    """Lines of sight from the origin; they share the error of the camera's position."""
    n = len(points_m)
    by_camera, own = np.tile(-np.eye(3), (n, 1, 1)), np.tile(own_m2 * np.eye(3), (n, 1, 1))
    return PredictedLines(np.arange(n), points_m, by_camera, covariance_m2, own, known)


def gated(frame: TrackFrame, seen: PredictedLines) -> np.ndarray:
    return gate_frame(CAMERA, frame, seen, np.full(len(seen.rows), frame.sigma_px**2), FALSE_ALARM, LIMIT)


@pytest.mark.parametrize(("share", "passes"), AROUND)
def test_guessed_distance_widens_the_gate_by_the_product_of_both_errors(share: float, passes: bool) -> None:
    """A pixel f dt / (d (1 + e)) with e of 0.3: variance (1 + 0.3^2) (f sigma / d)^2, and that of its noise."""
    point, sigma_m = np.array([[0.0, 0.0, 400.0]]), 5.0
    variance_px2 = 1.09 * (CAMERA.fx_px * sigma_m / 400.0) ** 2 + 0.5**2
    frame = frame_of(point, np.array([0.0, np.sqrt(share * LIMIT * variance_px2) * 400.0 / CAMERA.fx_px, 0.0]))
    seen = lines_to(point, sigma_m**2 * np.eye(3), np.zeros(1, dtype=bool), 0.0)
    assert gated(frame, seen)[0] == passes


def test_mapped_landmarks_correct_the_camera_before_the_others_are_gated() -> None:
    """The camera is 20 m off its prediction: pixels of new landmarks move with it, or are wrong."""
    points = np.array([[x, y, 400.0] for x in (-60.0, 0.0, 60.0) for y in (-60.0, 60.0)] + [[30.0, 10.0, 420.0]] * 2)
    camera_m = np.array([12.0, -16.0, 0.0])
    frame = frame_of(points, camera_m)
    frame.uv_px[7] = CAMERA.project(points[7:])[0]  # as if the prediction were right
    seen = lines_to(points, 15.0**2 * np.eye(3), np.arange(8) < 6, 1e-4)
    np.testing.assert_array_equal(gated(frame, seen), np.arange(8) < 7)


@pytest.mark.parametrize(("share", "passes"), AROUND)
def test_limit_of_a_guessed_distance_is_that_of_its_pixel_alone(share: float, passes: bool) -> None:
    """With a certain camera only the noise of the pixel is left."""
    points = np.array([[x, y, 400.0] for x in (-60.0, 60.0) for y in (-60.0, 60.0)] + [[30.0, 10.0, 420.0]])
    frame = frame_of(points, np.zeros(3))
    frame.uv_px[4] += 0.5 * np.sqrt(share * LIMIT) * np.array([0.8, -0.6])
    seen = lines_to(points, 1e-12 * np.eye(3), np.arange(5) < 4, 1e-12)
    np.testing.assert_array_equal(gated(frame, seen), [True] * 4 + [passes])


def adjusted_window(points_m: np.ndarray) -> tuple[OutlierGate, AdjustedWindow]:
    """A gate and an adjusted window of one view at the origin, whose residuals are zero."""
    slam_map = SlamMap(CAMERA)
    options = OutlierOptions(associations="consensus", false_alarm=FALSE_ALARM)
    gate, tracks = OutlierGate(slam_map, options), np.arange(len(points_m))
    gate.add_frame(0, frame_of(points_m, np.zeros(3)))
    slam_map.positions_m[0], slam_map.points_m = np.zeros(3), dict(enumerate(points_m))
    free = np.ones(len(points_m), dtype=bool)
    problem = Adjustment(CAMERA, np.eye(3)[None], slam_map.pixels([0], tracks.tolist()), np.ones(1, dtype=bool), free)
    return gate, AdjustedWindow(problem, State(np.zeros((1, 3)), points_m), (0,), tracks)


@pytest.mark.parametrize(("ratio", "plausible"), [(2.97, True), (3.03, False), (1 / 2.97, True), (1 / 3.03, False)])
def test_distance_unlike_the_median_refuses_the_newest_pixel(ratio: float, plausible: bool) -> None:
    """Two wrong pixels of a landmark may fit each other: only its distance, against the median one, shows it."""
    rays = CAMERA.unproject(np.random.default_rng(0).uniform(200.0, 800.0, (7, 2)))
    points = 400.0 * rays
    points[2] *= ratio
    gate, adjusted = adjusted_window(points)
    assert gate.reject_outliers(adjusted) != plausible
    assert gate.refused.get(0, set()) == (set() if plausible else {2})
    assert (2 in gate.slam_map.points_m) == plausible


@pytest.mark.parametrize(("share", "again"), [(0.49, True), (0.51, False)])
def test_refused_pixel_is_readmitted_within_half_of_the_limit(share: float, again: bool) -> None:
    rays = CAMERA.unproject(np.random.default_rng(0).uniform(200.0, 800.0, (7, 2)))
    gate, adjusted = adjusted_window(400.0 * rays)
    gate.raw_frames[0].uv_px[3] += 0.5 * np.sqrt(share * LIMIT) * np.array([0.6, 0.8])
    gate.refused[0] = {3}
    gate.reject_outliers(replace_pixels(adjusted, np.arange(7) != 3))
    assert gate.refused[0] == (set() if again else {3})
    assert (3 in gate.slam_map.frames[0].tracks) or not again


def replace_pixels(adjusted: AdjustedWindow, rows: np.ndarray) -> AdjustedWindow:
    """Leave pixels out of an adjusted window."""
    problem = replace(adjusted.problem, pixels=adjusted.problem.pixels.subset(rows))
    return replace(adjusted, problem=problem)
