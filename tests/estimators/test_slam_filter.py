"""The filter's landmarks and its updates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from slam_sequences import CAMERA, ORBIT_M, STEP_RAD, Recipe, central_differences, look_down, make_sequence

from boresight.estimators.slam.filters.ekf import EkfSlam
from boresight.estimators.slam.filters.ekf_state import FilterState, landmark_jacobians, landmark_points
from boresight.estimators.slam.filters.ekf_update import (
    FrameMeasurements,
    iterated_update,
    kalman_update,
)
from boresight.scenarios.observation import TrackFrame

NO_RANGES = (np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


@pytest.fixture
def state() -> FilterState:
    """Three landmarks anchored at the first position, and the camera two degrees further on the orbit."""
    rng = np.random.default_rng(3)
    first = np.array([ORBIT_M, 0.0, 0.0])
    start = FilterState.of_camera(first, 0.01 * np.eye(3), frame_at(first, first))
    elements = np.column_stack([rng.uniform(300, 700, (3, 2)), np.full(3, 1.0 / 620.0)])
    noise = np.tile([0.4, 0.4, (0.1 / 620.0) ** 2], (3, 1))
    joined = start.augmented(np.array([4, 7, 9]), elements, noise)
    return joined.predicted(CAMERA, frame_at(_second(), first))


def frame_at(position_m: np.ndarray, before_m: np.ndarray) -> TrackFrame:
    """A frame that looks down, without tracks; its predicted motion is uncertain by 2 m."""
    none = np.zeros(0, dtype=np.int64)
    moved = position_m - before_m
    return TrackFrame(480.0, look_down(position_m), none, np.zeros((0, 2)), 0.7, moved, 4.0 * np.eye(3))


def _second() -> np.ndarray:
    return ORBIT_M * np.array([np.cos(STEP_RAD), np.sin(STEP_RAD), 0.0])


def measured(state: FilterState, rows: list[int], shift_px: np.ndarray, sigma_px: float = 0.7) -> FrameMeasurements:
    """Pixels predicted by the state at the second position, plus a shift."""
    lines = state.points(CAMERA)[rows] - state.position_m
    uv = CAMERA.project(lines @ look_down(_second()).T) + shift_px
    return FrameMeasurements(CAMERA, np.array(rows), uv, sigma_px, *NO_RANGES)


def square_root(covariance: np.ndarray) -> np.ndarray:
    """The joint covariance is singular, since three landmarks share one anchor: as many columns as it has rank."""
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-18
    return vectors[:, keep] * np.sqrt(values[keep])


def test_landmark_lies_on_its_first_ray(state: FilterState) -> None:
    points = state.points(CAMERA)
    anchor = state.landmarks[:, 3:]
    lines = points - anchor
    np.testing.assert_allclose(np.linalg.norm(lines, axis=1), 620.0, rtol=1e-12)
    np.testing.assert_allclose(CAMERA.project(lines @ state.R_cam_body[0].T), state.landmarks[:, :2], atol=1e-9)


def test_derivatives_are_those_of_central_differences(state: FilterState) -> None:
    steps = np.array([1e-2, 1e-2, 1e-7, 1e-3, 1e-3, 1e-3])
    for landmark, rotation in zip(state.landmarks, state.R_cam_body, strict=True):
        numeric = central_differences(
            lambda x, R=rotation: landmark_points(CAMERA, x[None], R[None])[0], landmark, steps
        )
        analytic = landmark_jacobians(CAMERA, landmark[None], rotation[None])[0]
        np.testing.assert_allclose(analytic, numeric, rtol=1e-6, atol=1e-6)


def test_innovation_derivatives_are_those_of_central_differences(state: FilterState) -> None:
    """Of pixels and of distances."""
    seen = replace(
        measured(state, [2, 0], np.zeros((1, 2))),
        range_rows=np.array([1, 2]),
        range_m=np.full(2, 600.0),
        range_sigma_m=np.ones(2),
    )
    steps = np.concatenate([np.full(3, 1e-3), np.tile([1e-2, 1e-2, 1e-8, 1e-3, 1e-3, 1e-3], 3)])
    numeric = central_differences(lambda x: -seen.residual(replace(state, x=x)), state.x, steps)
    scale = steps / 1e-3  # in units of the steps, so that metres and inverse metres compare
    np.testing.assert_allclose(seen.innovation(state).jacobian * scale, numeric * scale, atol=1e-5)


def test_update_is_that_of_the_least_squares(state: FilterState) -> None:
    """The update solves the weighted least-squares problem of prior and linearised measurements."""
    innovation = measured(state, [0, 1, 2], np.array([[0.5, -1.0]])).innovation(state)
    after, squared = kalman_update(state, innovation)
    root = square_root(state.covariance)
    rows_of_noise = innovation.jacobian @ root / 0.7
    stacked = np.concatenate([rows_of_noise, np.eye(root.shape[1])])
    target = np.concatenate([innovation.residual / 0.7, np.zeros(root.shape[1])])
    z, residual, _, _ = np.linalg.lstsq(stacked, target)
    np.testing.assert_allclose(after.position_m - state.position_m, (root @ z)[:3], atol=1e-7)
    assert squared == pytest.approx(residual[0], rel=1e-6)
    expected = root @ np.linalg.inv(stacked.T @ stacked) @ root.T
    np.testing.assert_allclose(after.covariance[:3, :3], expected[:3, :3], rtol=1e-5, atol=1e-9)


def test_covariance_of_the_update_is_that_of_the_form_of_joseph(state: FilterState) -> None:
    innovation = measured(state, [0, 1, 2], np.array([[0.5, -1.0]])).innovation(state)
    H, P, R = innovation.jacobian, state.covariance, np.diag(innovation.variance)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    left = np.eye(len(P)) - K @ H
    joseph = left @ P @ left.T + K @ R @ K.T
    scale = np.sqrt(np.diag(P))
    found = kalman_update(state, innovation)[0].covariance
    np.testing.assert_allclose(found / np.outer(scale, scale), joseph / np.outer(scale, scale), atol=1e-9)


def test_iterated_update_is_the_minimum_of_scipy(state: FilterState) -> None:
    """Distances wrong by 30 % and a position by metres: one step of the plain filter does not reach the minimum."""
    unsure = replace(state, covariance=state.covariance * 100.0)
    seen = measured(state, [0, 1, 2], np.array([[60.0, -25.0], [75.0, -20.0], [50.0, -30.0]]))
    root = square_root(unsure.covariance)

    def residuals(z: np.ndarray) -> np.ndarray:
        moved = replace(unsure, x=unsure.x + root @ z)
        return np.concatenate([seen.residual(moved) / 0.7, z])

    foreign = least_squares(residuals, np.zeros(root.shape[1]), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    found, squared = iterated_update(unsure, seen, steps=50, tolerance=1e-12)
    np.testing.assert_allclose(found.position_m, (unsure.x + root @ foreign.x)[:3], atol=1e-4)
    assert squared == pytest.approx(2.0 * foreign.cost, rel=1e-6)
    once, _ = kalman_update(unsure, seen.innovation(unsure))
    assert np.linalg.norm(once.position_m - found.position_m) > 0.1
    expected = (root @ np.linalg.inv(foreign.jac.T @ foreign.jac) @ root.T)[:3, :3]
    np.testing.assert_allclose(found.covariance[:3, :3], expected, rtol=1e-3, atol=1e-6)


def test_one_step_of_the_iterated_update_moves_as_the_plain_one(state: FilterState) -> None:
    seen = measured(state, [0, 1, 2], np.array([[0.5, -1.0]]))
    one, _ = iterated_update(state, seen, steps=1)
    np.testing.assert_allclose(one.x, kalman_update(state, seen.innovation(state))[0].x, atol=1e-9)


def test_settled_landmarks_tell_nothing_of_the_scale(state: FilterState) -> None:
    """Bearing Jacobians at two positions and estimates have a common null space: the scale about any point."""
    settled = state.with_fixed_linearisation(1.0)
    assert not np.isnan(settled.settled).any()
    later = replace(settled, x=settled.x * np.tile([1.02, 0.97, 1.01], len(settled.x) // 3))
    first = measured(state, [0, 1, 2], np.zeros((1, 2)))
    for moved, learns in ((later, False), (replace(later, settled=np.full((3, 4), np.nan)), True)):
        growth = np.zeros(len(state.x)).reshape(-1, 3)
        growth[0] = moved.position_m  # the camera's own position is known anew at each frame
        landmarks = np.column_stack([np.zeros((3, 2)), -state.landmarks[:, 2], state.landmarks[:, 3:]])
        growth[1:] = landmarks.reshape(-1, 3)
        seen = np.abs(first.innovation(moved).jacobian @ growth.ravel()).max()
        assert (seen > 1e-3) == learns, seen


def test_new_landmark_shares_the_error_of_its_anchor(state: FilterState) -> None:
    joined = state.augmented(np.array([11]), np.array([[500.0, 400.0, 1 / 600]]), np.array([[1.0, 1.0, 1e-8]]))
    np.testing.assert_array_equal(joined.covariance[-3:, :3], state.covariance[:3, :3])
    np.testing.assert_array_equal(joined.covariance[-3:, -3:], state.covariance[:3, :3])
    without = joined.without(np.array([True, True, True, False]))
    assert without.tracks.tolist() == [11]
    assert without.covariance.shape == (9, 9)


def test_prediction_adds_the_whole_covariance_of_the_motion(state: FilterState) -> None:
    """0.01 m^2 at the start and 4 m^2 of the motion; landmarks and their correlations stay."""
    first = np.array([ORBIT_M, 0.0, 0.0])
    uneven = np.diag([1.0, 4.0, 9.0]) + 0.5
    frame = replace(frame_at(first, _second()), motion_covariance_m2=uneven)
    moved = state.predicted(CAMERA, frame)
    np.testing.assert_allclose(state.covariance[:3, :3], 4.01 * np.eye(3))
    np.testing.assert_allclose(moved.covariance[:3, :3], 4.01 * np.eye(3) + uneven)
    np.testing.assert_array_equal(moved.covariance[3:], state.covariance[3:])


def test_product_of_both_errors_widens_the_innovation(state: FilterState) -> None:
    """A pixel moves with the camera's error times one plus the relative error of the inverse distance."""
    points, rotation = state.points(CAMERA), look_down(_second())
    found = measured(state, [0, 2], np.zeros((1, 2))).second_order(state)
    assert not found[:2, 2:].any()
    for block, row in ((found[:2, :2], 0), (found[2:, 2:], 2)):
        by_camera = central_differences(
            lambda x, row=row: CAMERA.project((points[row] - x)[None] @ rotation.T)[0], state.position_m, np.ones(3)
        )
        relative = np.sqrt(state.covariance[5 + 6 * row, 5 + 6 * row]) / state.landmarks[row, 2]
        np.testing.assert_allclose(block, relative**2 * by_camera @ state.covariance[:3, :3] @ by_camera.T, rtol=1e-4)


def test_new_landmarks_have_the_relative_sigma_of_the_option_or_of_their_range() -> None:
    sequence, _ = make_sequence(np.random.default_rng(4), Recipe(frames=1, landmarks=10))
    follower = EkfSlam.from_options({"depth_sigma": 0.2}).follower(sequence)
    follower.advance(sequence.frames[0])
    measured_range = sequence.frames[0].ranges[0]
    ranged = follower.state.tracks == measured_range.track
    assert np.count_nonzero(~ranged) > 3
    np.testing.assert_allclose(follower.state.inverse_sigmas[~ranged], 0.2)
    np.testing.assert_allclose(follower.state.inverse_sigmas[ranged], measured_range.sigma_m / measured_range.range_m)
