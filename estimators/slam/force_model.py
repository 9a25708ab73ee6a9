"""Force model of equation (6) of Delpech et al. (2015), and propagation with state transition matrix.

The units make all unknowns metres: with the distance L at the first frame and T = sqrt(L^3 / gm), a velocity is given
as v T, the gravity parameter as L times its ratio to the prior value, and the factor on solar radiation pressure as L
times it. An error of one metre in any of them moves an orbit by about a metre within a revolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import Forces

LONGEST_STEP = 0.01
"""Longest integration step, T: 0.6 deg of a circular orbit, with a Runge-Kutta error of 1e-12 L a step."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceModel:
    """Point-mass gravity and constant solar radiation pressure.

    ``length_m`` and ``time_s`` are L and T, ``gm_m3_s2`` is the prior gravity parameter, and ``radiation_m`` (3,) the
    acceleration by solar radiation pressure times T^2, inertial axes.
    """

    length_m: float
    time_s: float
    gm_m3_s2: float
    radiation_m: FloatArray

    @classmethod
    def of(cls, forces: Forces, distance_m: float) -> ForceModel:
        """Return the model with units by the distance from the body's centre."""
        time = float(np.sqrt(distance_m**3 / forces.gm_m3_s2))
        return cls(distance_m, time, forces.gm_m3_s2, np.asarray(forces.radiation_m_s2 * time**2, dtype=np.float64))

    @property
    def known(self) -> FloatArray:
        """(2,) prior values of the parameters, m: ratio and factor are 1."""
        return np.full(2, self.length_m)

    def sigmas(self, forces: Forces) -> FloatArray:
        """(2,) prior standard deviations of the parameters, m; that of the factor is 0 without radiation pressure."""
        pressure = float(np.linalg.norm(forces.radiation_m_s2))
        return self.length_m * np.array(
            [forces.gm_sigma_m3_s2 / forces.gm_m3_s2, forces.radiation_sigma_m_s2 / pressure if pressure else 0.0]
        )

    def acceleration(self, positions_m: FloatArray, parameters_m: FloatArray) -> FloatArray:
        """(k, 3) at positions (k, 3) in inertial axes, m per T^2."""
        # Eq. (6) with the sign of attraction. gm T^2 = L^3 times the ratio to the prior value, and the parameter is L
        # times that ratio: gm r / r^3 becomes (L^2 / r^3) r times the parameter.
        light = self.radiation_m * (parameters_m[1] / self.length_m)
        return np.asarray(light - self._weight(positions_m) * positions_m * parameters_m[0], dtype=np.float64)

    def derivatives(self, positions_m: FloatArray, parameters_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3, 3) and (k, 3, 2) derivatives of `acceleration` by position and parameters.

        The former is the gravity gradient gm (3 r r' / r^5 - I / r^3).
        """
        weight = self._weight(positions_m)[:, :, None]
        squares = np.einsum("ki,ki->k", positions_m, positions_m)[:, None, None]
        # weight is L^2 / r^3; the parameter supplies the third L.
        tidal = weight * (3.0 * positions_m[:, :, None] * positions_m[:, None, :] / squares - np.eye(3))
        by_parameters = np.empty((len(positions_m), 3, 2))
        # The acceleration is linear in both parameters.
        by_parameters[:, :, 0] = -weight[:, 0] * positions_m
        by_parameters[:, :, 1] = self.radiation_m / self.length_m
        return parameters_m[0] * tidal, by_parameters

    def _weight(self, positions_m: FloatArray) -> FloatArray:
        """(k, 1) L^2 / r^3."""
        squares = np.einsum("ki,ki->k", positions_m, positions_m)[:, None]
        return np.asarray(self.length_m**2 * squares**-1.5, dtype=np.float64)


def propagate(field: ForceModel, states_m: FloatArray, parameters_m: FloatArray, durations: FloatArray) -> FloatArray:
    """(k, 6) positions and velocities after (k,) durations from (k, 6), inertial axes, units of the model."""
    return _integrate(field, states_m[:, :, None], parameters_m, durations)[:, :, 0]


def propagate_with_derivatives(
    field: ForceModel, states_m: FloatArray, parameters_m: FloatArray, durations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the propagated states, and (k, 6, 8) their derivatives by the 6 initial values and the 2 parameters.

    The variational equations of the state transition matrix and the sensitivities are integrated with the state.
    """
    start = np.zeros((len(states_m), 6, 9))
    start[:, :, 0] = states_m
    # Column 0 the state, 1 to 6 the state transition matrix, 7 and 8 the sensitivities, zero at the start.
    start[:, :, 1:7] = np.eye(6)
    end = _integrate(field, start, parameters_m, durations)
    return end[:, :, 0], end[:, :, 1:]


def _integrate(field: ForceModel, start: FloatArray, parameters_m: FloatArray, durations: FloatArray) -> FloatArray:
    """Integrate by the classical fourth-order Runge-Kutta method, all arcs with the same number of steps."""
    # One number of steps for all arcs, so that they are integrated as arrays.
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


def _rate(field: ForceModel, y: FloatArray, parameters_m: FloatArray) -> FloatArray:
    """Return the time derivative of (k, 6, 1 + m): the state, then the derivatives, the parameters' in the last two."""
    rate = np.empty_like(y)
    rate[:, :3] = y[:, 3:]
    positions = y[:, :3, 0]
    rate[:, 3:, 0] = field.acceleration(positions, parameters_m)
    if y.shape[2] > 1:
        by_position, by_parameters = field.derivatives(positions, parameters_m)
        # d(Phi)/dt = A Phi, and for the sensitivities A S + da/dp.
        rate[:, 3:, 1:] = by_position @ y[:, :3, 1:]
        rate[:, 3:, -2:] += by_parameters
    return rate
