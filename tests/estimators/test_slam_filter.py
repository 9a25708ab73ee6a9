"""The filter's landmarks and its update."""

from __future__ import annotations

import numpy as np
import pytest
from slam_sequences import CAMERA, ORBIT_M, STEP_RAD, look_down

from estimators.slam.ekf_state import FilterState, bearing_innovation, range_innovation, updated
from estimators.slam.inverse_depth import landmark_jacobians, landmark_points


@pytest.fixture
def state() -> FilterState:
    """Three landmarks anchored at the first position, the camera two degrees further on."""
    rng = np.random.default_rng(3)
    first = np.array([ORBIT_M, 0.0, 0.0])
    start = FilterState(first, 0.01 * np.eye(3), np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)))
    elements = np.column_stack([rng.uniform(300, 700, (3, 2)), np.full(3, 1.0 / 620.0)])
    noise = np.tile([0.4, 0.4, (0.1 / 620.0) ** 2], (3, 1))
    joined = start.joined(np.array([4, 7, 9]), elements, noise, look_down(first))
    return joined.predicted(_second() - first, 4.0 * np.eye(3))


def _second() -> np.ndarray:
    return ORBIT_M * np.array([np.cos(STEP_RAD), np.sin(STEP_RAD), 0.0])


def differences(function, x: np.ndarray, steps: np.ndarray) -> np.ndarray:
    columns = []
    for i, step in enumerate(steps):
        shift = np.zeros(len(x))
        shift[i] = step
        columns.append((function(x + shift) - function(x - shift)) / (2.0 * step))
    return np.stack(columns, axis=-1)


def test_landmark_lies_on_its_first_ray(state: FilterState) -> None:
    points = state.points(CAMERA)
    anchor = state.landmarks[:, 3:]
    lines = points - anchor
    np.testing.assert_allclose(np.linalg.norm(lines, axis=1), 620.0, rtol=1e-12)
    np.testing.assert_allclose(CAMERA.project(lines @ state.R_cam_body[0].T), state.landmarks[:, :2], atol=1e-9)


def test_derivatives_are_those_of_central_differences(state: FilterState) -> None:
    steps = np.array([1e-2, 1e-2, 1e-7, 1e-3, 1e-3, 1e-3])
    for landmark, rotation in zip(state.landmarks, state.R_cam_body, strict=True):
        numeric = differences(lambda x, R=rotation: landmark_points(CAMERA, x[None], R[None])[0], landmark, steps)
        analytic = landmark_jacobians(CAMERA, landmark[None], rotation[None])[0]
        np.testing.assert_allclose(analytic, numeric, rtol=1e-6, atol=1e-6)


def test_innovation_derivatives_are_those_of_central_differences(state: FilterState) -> None:
    rows, R = np.array([2, 0]), look_down(_second())
    steps = np.concatenate([np.full(3, 1e-3), np.tile([1e-2, 1e-2, 1e-8, 1e-3, 1e-3, 1e-3], 3)])

    def bearing(x: np.ndarray) -> np.ndarray:
        moved = FilterState(x, state.covariance, state.tracks, state.R_cam_body)
        return -bearing_innovation(moved, CAMERA, R, rows, np.zeros((2, 2)), 1.0).residual

    def distance(x: np.ndarray) -> np.ndarray:
        moved = FilterState(x, state.covariance, state.tracks, state.R_cam_body)
        return -range_innovation(moved, CAMERA, rows, np.zeros(2), np.ones(2)).residual

    at_bearing = bearing_innovation(state, CAMERA, R, rows, np.zeros((2, 2)), 1.0).jacobian
    at_distance = range_innovation(state, CAMERA, rows, np.zeros(2), np.ones(2)).jacobian
    scale = steps / 1e-3  # in units of the steps, so that metres and inverse metres compare
    np.testing.assert_allclose(at_bearing * scale, differences(bearing, state.x, steps) * scale, atol=1e-5)
    np.testing.assert_allclose(at_distance * scale, differences(distance, state.x, steps) * scale, atol=1e-5)


def test_update_is_that_of_the_least_squares(state: FilterState) -> None:
    """Joseph's form gives what the prior and the linearised measurements give as one weighted least-squares problem."""
    rows, R = np.array([0, 1, 2]), look_down(_second())
    uv = CAMERA.project((state.points(CAMERA) - state.position_m) @ R.T) + np.array([[0.5, -1.0]])
    innovation = bearing_innovation(state, CAMERA, R, rows, uv, 0.7)
    after, squared = updated(state, innovation)
    # The joint covariance is singular (three landmarks share one anchor): compare in its own square root.
    values, vectors = np.linalg.eigh(state.covariance)
    keep = values > 1e-18
    root = vectors[:, keep] * np.sqrt(values[keep])
    rows_of_noise = innovation.jacobian @ root / 0.7
    stacked = np.concatenate([rows_of_noise, np.eye(root.shape[1])])
    target = np.concatenate([innovation.residual / 0.7, np.zeros(root.shape[1])])
    z, residual, _, _ = np.linalg.lstsq(stacked, target)
    np.testing.assert_allclose(after.position_m - state.position_m, (root @ z)[:3], atol=1e-7)
    assert squared == pytest.approx(residual[0], rel=1e-6)
    expected = root @ np.linalg.inv(stacked.T @ stacked) @ root.T
    np.testing.assert_allclose(after.covariance[:3, :3], expected[:3, :3], rtol=1e-5, atol=1e-9)


def test_new_landmark_shares_the_error_of_its_anchor(state: FilterState) -> None:
    joined = state.joined(np.array([11]), np.array([[500.0, 400.0, 1 / 600]]), np.array([[1.0, 1.0, 1e-8]]), np.eye(3))
    np.testing.assert_array_equal(joined.covariance[-3:, :3], state.covariance[:3, :3])
    np.testing.assert_array_equal(joined.covariance[-3:, -3:], state.covariance[:3, :3])
    without = joined.without(np.array([True, True, True, False]))
    assert without.tracks.tolist() == [11]
    assert without.covariance.shape == (9, 9)
