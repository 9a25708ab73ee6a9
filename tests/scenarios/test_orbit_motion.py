"""Propagation against Kepler's closed form, scipy, the energy integral, and central differences of the partials."""

import numpy as np
import pytest
from scipy.optimize import brentq

from boresight.scenarios.dynamics.field import HarmonicField, UniformRotation
from boresight.scenarios.dynamics.gravity import Harmonics
from boresight.scenarios.dynamics.propagation import (
    OrbitLostError,
    PiecewiseAcceleration,
    propagate_partials,
    propagate_states,
)

GM, DAY = 4.463e5, 86_400.0
REST = UniformRotation(np.eye(3), 0.0)
SPIN = UniformRotation(np.eye(3), 2 * np.pi / 18_972.0)


def _kepler(a, e, times):
    """In-plane positions and velocities from pericentre on."""
    n = np.sqrt(GM / a**3)
    E = np.array([brentq(lambda x, t=t: x - e * np.sin(x) - n * t, -1.0, 100.0, xtol=1e-14) for t in times])
    root = np.sqrt(1 - e**2)
    position = a * np.column_stack([np.cos(E) - e, root * np.sin(E), 0 * E])
    velocity = a * n * np.column_stack([-np.sin(E), root * np.cos(E), 0 * E]) / (1 - e * np.cos(E))[:, None]
    return np.hstack([position, velocity])


def _lumpy(light=(0.0, 0.0, 0.0), by_degree=0):
    c, s = np.zeros((2, 5, 5))
    c[0, 0], c[2, 0], c[2, 2], c[3, 1], s[2, 2], c[4, 2] = 1.0, -0.05, 0.08, 0.004, -0.03, -0.02
    return HarmonicField(Harmonics(GM, 16_000.0, c, s), SPIN, np.array(light), by_degree)


START = np.array([200_000.0, 0.0, 0.0, 0.0, 1.22, 0.857])


@pytest.mark.parametrize("way", ["adaptive", "fixed"])
def test_two_body_motion_is_keplerian(way):
    times = np.linspace(0.0, 24 * DAY, 50)
    exact = _kepler(200_000.0, 0.1, times)
    field, pushes = (
        HarmonicField(Harmonics.point(GM, 16_000.0), REST, np.zeros(3)),
        PiecewiseAcceleration.none(times[-1]),
    )
    found = (
        propagate_states(field, exact[0], times, pushes)
        if way == "adaptive"
        else propagate_partials(field, exact[0], times, pushes).states
    )
    assert np.abs(found - exact)[:, :3].max() < 1e-3  # of 200 km, after 2.5 revolutions


def test_solar_pressure_alone_is_a_constant_acceleration():
    far = np.array([1e9, 0.0, 0.0, 0.0, 0.5, 0.0])  # where gravity is 4e-13 m/s2
    light = np.array([0.0, 2e-8, -5e-8])
    field = HarmonicField(Harmonics.point(GM, 16_000.0), REST, light)
    times = np.array([0.0, 5 * DAY, 10 * DAY])
    moved = (
        propagate_partials(field, far, times, PiecewiseAcceleration.none(times[-1])).states[:, :3]
        - far[:3]
        - np.outer(times, far[3:])
    )
    np.testing.assert_allclose(moved, 0.5 * np.outer(times**2, light), atol=1.0)


def test_fixed_steps_are_as_good_as_the_adaptive_ones_of_scipy():
    field = _lumpy(light=(3e-8, -1e-8, 2e-8))
    times = np.sort(np.random.default_rng(1).uniform(0.0, 23 * DAY, 300))
    rng = np.random.default_rng(2)
    pushes = PiecewiseAcceleration(np.linspace(0.0, 23 * DAY, 24), 1e-9 * rng.normal(size=(23, 3)))
    apart = propagate_partials(field, START, times, pushes).states - propagate_states(field, START, times, pushes)
    assert np.abs(apart[:, :3]).max() < 1e-3


def test_the_jacobi_integral_is_constant():
    # Jacobi's integral: v^2 / 2 - U - w . (r x v), of a field that is at rest in axes that turn with w.
    field = _lumpy()
    states = propagate_partials(field, START, np.linspace(0, 10 * DAY, 30), PiecewiseAcceleration.none(10 * DAY)).states
    h = np.cross(states[:, :3], states[:, 3:])[:, 2]
    potential = [_potential(field, t, state[:3]) for t, state in zip(np.linspace(0, 10 * DAY, 30), states, strict=True)]
    jacobi = 0.5 * np.sum(states[:, 3:] ** 2, axis=1) - potential - SPIN.rate_rad_s * h
    assert np.ptp(jacobi) < 1e-9 * abs(jacobi[0])


def _potential(field, time, position):
    """Of the harmonics, by scipy's."""
    from scipy.special import sph_harm_y

    x = SPIN.at(np.array([time]))[0] @ position
    r, theta, phi = np.linalg.norm(x), np.arccos(x[2] / np.linalg.norm(x)), np.arctan2(x[1], x[0])
    total = 0.0
    for n in range(field.harmonics.degree + 1):
        for m in range(n + 1):
            y = (-1) ** m * sph_harm_y(n, m, theta, phi) * np.sqrt(4 * np.pi * (1 if m == 0 else 2))
            part = field.harmonics.c[n, m] * y.real + field.harmonics.s[n, m] * y.imag
            total += (field.harmonics.radius_m / r) ** n * part
    return GM / r * total


def test_derivatives_are_central_differences():
    field = _lumpy(light=(3e-8, -1e-8, 2e-8), by_degree=3)
    times = np.array([0.0, 0.3, 1.0, 2.5, 6.0, 12.0]) * DAY
    pushes = PiecewiseAcceleration(np.array([0.0, 1.0, 2.0, 4.0, 12.0]) * DAY, np.full((4, 3), 1e-10))
    found = propagate_partials(field, START, times, pushes)

    def states(state=START, changed=field, push=pushes.acceleration_m_s2):
        return propagate_partials(changed, state, times, PiecewiseAcceleration(pushes.edges_s, push)).states

    steps = np.repeat([10.0, 1e-4], 3)
    for j in range(6):
        step = steps[j] * np.eye(6)[j]
        difference = (states(START + step) - states(START - step)) / (2 * steps[j])
        np.testing.assert_allclose(found.by_state[:, :, j], difference, atol=1e-6 * np.abs(difference).max(), rtol=1e-5)
    for j in range(field.parameters):
        step = np.r_[1e-5, 1e-2, np.full(field.parameters - 2, 1e-3)][j] * np.eye(field.parameters)[j]
        ends = [states(changed=field.changed(1 + s[0], 1 + s[1], s[2:])) for s in (step, -step)]
        difference = (ends[0] - ends[1]) / (2 * step.sum())
        np.testing.assert_allclose(found.by_parameters[:, :, j], difference, atol=5e-5 * np.abs(difference).max())
    for j in range(12):
        step = 1e-9 * np.eye(12)[j].reshape(4, 3)
        ends = [states(push=pushes.acceleration_m_s2 + s) for s in (step, -step)]
        difference = (ends[0] - ends[1]) / 2e-9
        scale = np.abs(difference[:, :3]).max(), np.abs(difference[:, 3:]).max()
        np.testing.assert_allclose(found.by_pushes[:, :3, j], difference[:, :3], atol=1e-5 * scale[0])
        np.testing.assert_allclose(found.by_pushes[:, 3:, j], difference[:, 3:], atol=1e-5 * scale[1])


@pytest.mark.parametrize("way", [propagate_states, propagate_partials])
def test_an_impact_raises_an_error(way):
    falling = np.array([100_000.0, 0.0, 0.0, -0.5, 0.05, 0.0])
    with pytest.raises(OrbitLostError, match="into the body"):
        way(_lumpy(), falling, np.linspace(0, 5 * DAY, 10), PiecewiseAcceleration.none(5 * DAY))
