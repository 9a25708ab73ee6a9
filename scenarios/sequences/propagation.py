"""An orbit under forces: gravity, solar radiation pressure and what is not modelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from scenarios.errors import BoresightError
from scenarios.sequences.gravity import Gravity, PointMass
from scenarios.sequences.rotation import Attitude
from scenarios.spec.motion import ForcesSpec

FloatArray = NDArray[np.float64]

SUNLIGHT_N_M2 = 1361.0 / 299_792_458.0
"""Pressure of absorbed sunlight at 1 au: total solar irradiance over the speed of light."""

_TOLERANCE = 1e-12


def radiation_pressure(forces: ForcesSpec, sun_dir: FloatArray) -> FloatArray:
    """(3,) acceleration of a ball by sunlight (cannonball model), m/s2, away from the Sun; nothing casts a shadow."""
    size = SUNLIGHT_N_M2 * forces.reflectivity * forces.area_to_mass_m2_kg / forces.sun_distance_au**2
    return np.asarray(-size * sun_dir, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Acceleration about a body, inertial axes.

    Parameters
    ----------
    gravity
        Of the body, in its own axes.
    attitude
        R_body_inertial by time.
    radiation_m_s2
        (3,) constant acceleration by sunlight.
    """

    gravity: Gravity
    attitude: Attitude
    radiation_m_s2: FloatArray

    def acceleration(self, time_s: float, position_m: FloatArray) -> FloatArray:
        """(3,) m/s2: equation (6) of Delpech et al. (2015) without its noise."""
        if isinstance(self.gravity, PointMass):
            return self.gravity.acceleration(position_m) + self.radiation_m_s2
        turn = self.attitude(np.array([time_s]))[0]
        return np.asarray(turn.T @ self.gravity.acceleration(turn @ position_m) + self.radiation_m_s2)


class OrbitEndsError(BoresightError):
    """An orbit comes down to the body."""


def propagate(
    field: Field,
    start: tuple[FloatArray, FloatArray],
    times_s: FloatArray,
    unmodelled_m_s2: FloatArray,
    reach_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Follow an orbit: (F, 3) positions, m, and (F, 3) velocities, m/s, at the times, inertial axes.

    Parameters
    ----------
    field
        The modelled forces.
    start
        Position and velocity, (3,) each, at the first time.
    times_s
        (F,) increasing.
    unmodelled_m_s2
        (F - 1, 3) further acceleration, constant between two times.
    reach_m
        Largest distance of the body's surface from its centre.

    Raises
    ------
    OrbitEndsError
        If the orbit comes as near the centre as the body reaches.
    """
    length, speed = float(np.linalg.norm(start[0])), float(np.linalg.norm(start[1]))
    time = length / speed

    def height(_: float, state: FloatArray) -> float:
        return float(np.linalg.norm(state[:3]) - reach_m / length)

    height.terminal = True  # type: ignore[attr-defined]  # how solve_ivp is told to stop there
    states = np.empty((len(times_s), 6))
    states[0] = np.concatenate([start[0] / length, start[1] / speed])
    for i, extra in enumerate(unmodelled_m_s2):

        def change(t: float, state: FloatArray, extra: FloatArray = extra) -> FloatArray:
            pull = field.acceleration(time * t, length * state[:3]) + extra
            return np.concatenate([state[3:], pull * time / speed])

        begin, end = times_s[i : i + 2] / time
        options = {"rtol": _TOLERANCE, "atol": _TOLERANCE, "first_step": end - begin}
        found = solve_ivp(change, (begin, end), states[i], "DOP853", events=height, **options)
        if found.status != 0:
            raise OrbitEndsError(
                f"sequence.orbit: {found.t[-1] * time / 3600.0:.3g} h after the first frame it comes down to the body,"
                f" which reaches {reach_m:.4g} m from its centre: raise radius_m or lower the forces"
            )
        states[i + 1] = found.y[:, -1]
    return length * states[:, :3], speed * states[:, 3:]
