"""The motion propagator of BA-SLAM: scipy's integrator, Kepler's orbit, the gain of a converged Kalman filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from slam_orbits import GM, INTERVAL_S, LIGHT, RATE, Drive, make_orbit_sequence
from slam_sequences import ORBIT_M, Recipe, make_sequence

from boresight.estimators.slam.force_model import ForceModel
from boresight.estimators.slam.keyframes.bundle import BundleSlam
from boresight.estimators.slam.keyframes.motion_filter import MotionFilter, steady_gain
from boresight.scenarios.observation import Forces

CIRCLE = np.array([0.0, ORBIT_M * RATE, 0.0])


def motion(radiation: np.ndarray, velocity: np.ndarray) -> MotionFilter:
    forces = Forces(GM, 0.0, radiation, 0.0, 1e-7, velocity, np.zeros((3, 3)))
    field = ForceModel.of(forces, ORBIT_M)
    return MotionFilter(field, 100.0, np.array([ORBIT_M, 0.0, 0.0]), velocity)


def test_motion_is_that_of_scipy() -> None:
    """Gravity attracts, unlike in equation (6) as printed, and sunlight repels."""
    start = motion(LIGHT, 1.1 * CIRCLE + [0.001, 0.0, 0.002])

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], -GM * y[:3] / np.linalg.norm(y[:3]) ** 3 + LIGHT])

    first = np.concatenate([start.position_m, start.velocity_m_s])
    span = (100.0, 100.0 + 20.0 * INTERVAL_S)
    foreign = solve_ivp(rate, span, first, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    found = start
    for number in range(20):
        found = found.predicted(100.0 + (number + 1) * INTERVAL_S)
    np.testing.assert_allclose(found.position_m, foreign[:3], atol=1e-6)
    np.testing.assert_allclose(found.velocity_m_s, foreign[3:], atol=1e-9)


def test_orbit_closes_after_the_period_of_kepler() -> None:
    """Start at apoapsis: the vis-viva equation gives the semi-major axis, Kepler's third law the period."""
    start = motion(np.zeros(3), 0.9 * CIRCLE)
    speed = float(np.linalg.norm(start.velocity_m_s))
    half_axis = 1.0 / (2.0 / ORBIT_M - speed**2 / GM)
    period = 2.0 * np.pi * np.sqrt(half_axis**3 / GM)
    half = start.predicted(100.0 + 0.5 * period)
    np.testing.assert_allclose(half.position_m, [ORBIT_M - 2.0 * half_axis, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(half.predicted(100.0 + period).position_m, start.position_m, atol=1e-4)


def test_gain_is_what_a_filter_ends_with() -> None:
    """The covariance recursion of a Kalman filter with the same noise."""
    duration, push, sigma = INTERVAL_S, 1e-6, 0.7
    F = np.array([[1.0, duration], [0.0, 1.0]])
    g = push * np.array([0.5 * duration**2, duration])
    P = np.diag([100.0, 1.0])
    for _ in range(5000):
        P = F @ P @ F.T + np.outer(g, g)
        K = P[:, 0] / (P[0, 0] + sigma**2)
        variance = P[0, 0] + sigma**2
        P = P - np.outer(K, P[0])
    gain = steady_gain(duration, push, sigma)
    np.testing.assert_allclose([gain.position, gain.velocity_s, gain.innovation_m2], [*K, variance], rtol=1e-6)


@pytest.mark.parametrize("spinning", [False, True])
def test_adjustment_with_the_propagator_tells_the_velocity(spinning: bool) -> None:
    """The given displacements are wrong by their own length, and not used; the first velocity is wrong by 5 mm/s."""
    drive = Drive(gm_sigma=0.0, radiation_sigma=0.0, spinning=spinning)
    sequence, truth = make_orbit_sequence(
        np.random.default_rng(5), Recipe(frames=60, landmarks=25, motion_error=1.0), drive
    )
    assert sequence.forces is not None
    wrong = replace(sequence.forces, velocity_m_s=truth.states[0, 3:] + [0.003, 0.0, -0.004])
    options = {"motion": "constant-gain", "motion_position_sigma_m": 0.5, "motion_noise_m_s2": 1e-6}
    estimate = BundleSlam.from_options(options).follow(replace(sequence, forces=wrong))
    assert estimate.status == "ok", estimate.reason
    velocities = np.array([frame.velocity_m_s for frame in estimate.frames])
    errors = np.linalg.norm(velocities - truth.states[:, 3:], axis=1)
    assert errors[0] == pytest.approx(0.005)
    assert np.median(errors[20:]) < 0.001
    given = BundleSlam.from_options({}).follow(sequence)
    assert given.frames[-1].velocity_m_s is None


def test_propagator_without_forces_or_noise_says_so() -> None:
    blind, _ = make_sequence(np.random.default_rng(5), Recipe(frames=3))
    estimate = BundleSlam.from_options({"motion": "constant-gain"}).follow(blind)
    assert (estimate.status, estimate.frames) == ("failed", ())
    assert "tells no forces" in estimate.reason
    sequence, _ = make_orbit_sequence(np.random.default_rng(5), Recipe(frames=3), Drive(noise_m_s2=0.0))
    estimate = BundleSlam.from_options({"motion": "constant-gain"}).follow(sequence)
    assert estimate.status == "failed"
    assert "set motion_noise_m_s2" in estimate.reason
