"""Motion about the body from one frame to the next, with its derivatives by where it began and by the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.dynamics.field import Field

FloatArray = NDArray[np.float64]

LONGEST_STEP = 0.01
"""Of the integrator, in units of T: on a circular orbit 0.6 deg, where the classical method errs by 1e-12 L a step."""


def propagated(field: Field, states_m: FloatArray, parameters_m: FloatArray, durations: FloatArray) -> FloatArray:
    """(k, 6) positions and velocities after (k,) durations from (k, 6), inertial axes, units of the field."""
    return _integrated(field, states_m[:, :, None], parameters_m, durations)[:, :, 0]


def propagated_with_derivatives(
    field: Field, states_m: FloatArray, parameters_m: FloatArray, durations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what `propagated` does, and (k, 6, 8) its derivatives by the 6 of the start and the 2 parameters.

    The state transition matrix and the sensitivities follow their variational equations in the same integration.
    """
    start = np.zeros((len(states_m), 6, 9))
    start[:, :, 0] = states_m
    start[:, :, 1:7] = np.eye(6)
    end = _integrated(field, start, parameters_m, durations)
    return end[:, :, 0], end[:, :, 1:]


def _integrated(field: Field, start: FloatArray, parameters_m: FloatArray, durations: FloatArray) -> FloatArray:
    """Integrate by the classical Runge-Kutta method of fourth order, all arcs in as many steps."""
    steps = max(1, int(np.ceil(np.max(durations, initial=0.0) / LONGEST_STEP)))
    h = (durations / steps)[:, None, None]
    y = start
    for _ in range(steps):
        k1 = _rate(field, y, parameters_m)
        k2 = _rate(field, y + 0.5 * h * k1, parameters_m)
        k3 = _rate(field, y + 0.5 * h * k2, parameters_m)
        k4 = _rate(field, y + h * k3, parameters_m)
        y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return y


def _rate(field: Field, y: FloatArray, parameters_m: FloatArray) -> FloatArray:
    """Return the time derivative of (k, 6, 1 + m): the state, then the derivatives, the parameters' in the last two."""
    rate = np.empty_like(y)
    rate[:, :3] = y[:, 3:]
    positions = y[:, :3, 0]
    rate[:, 3:, 0] = field.acceleration(positions, parameters_m)
    if y.shape[2] > 1:
        by_position, by_parameters = field.derivatives(positions, parameters_m)
        rate[:, 3:, 1:] = by_position @ y[:, :3, 1:]
        rate[:, 3:, -2:] += by_parameters
    return rate
