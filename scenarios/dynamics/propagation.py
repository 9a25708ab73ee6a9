"""Orbit propagation with adaptive steps, for the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.sequence import ForcesSpec

Acceleration = Callable[[float, FloatArray], FloatArray]
"""(3,) m/s2 at a time, s, and a position (3,) m, inertial axes."""

SUNLIGHT_N_M2 = 1361.0 / 299_792_458.0
"""Pressure of absorbed sunlight at 1 au: total solar irradiance over the speed of light."""

_TOLERANCE = 1e-12  # of the scaled state, relative and absolute


class OrbitLostError(BoresightError):
    """An orbit impacts on the body or diverges."""


def radiation_pressure(forces: ForcesSpec, sun_dir: FloatArray) -> FloatArray:
    """(3,) acceleration by solar radiation pressure, m/s2, away from the Sun: cannonball model without shadow."""
    size = SUNLIGHT_N_M2 * forces.reflectivity * forces.area_to_mass_m2_kg / forces.sun_distance_au**2
    return np.asarray(-size * sun_dir, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PiecewiseAcceleration:
    """Accelerations (P, 3), inertial axes, each constant between two of the ascending ``edges_s`` (P + 1,).

    The edges go from 0 to the end of the motion or later.
    """

    edges_s: FloatArray
    acceleration_m_s2: FloatArray

    @classmethod
    def none(cls, end_s: float) -> PiecewiseAcceleration:
        """Make one interval of zero acceleration."""
        return cls(np.array([0.0, max(end_s, 1.0)]), np.zeros((1, 3)))

    def piece(self, times_s: FloatArray) -> NDArray[np.int64]:
        """(n,) index of the interval of each time; a limit belongs to the interval that it ends."""
        # left: a time that equals a limit gets the interval before it.
        found = np.searchsorted(self.edges_s, times_s, side="left") - 1
        return np.clip(found, 0, len(self.acceleration_m_s2) - 1)


def propagate(
    acceleration: Acceleration, lowest_m: float, state: FloatArray, times_s: FloatArray, pushes: PiecewiseAcceleration
) -> FloatArray:
    """Propagate an orbit to states (T, 6) at ascending times (T,).

    The method is that of Dormand and Prince of eighth order (DOP853). ``state`` (6,) is position, m, and velocity, m/s,
    at time 0, inertial axes. ``pushes`` are added to the ``acceleration`` by the modelled forces. Lengths and speeds
    are scaled by their initial values, to which the tolerances of 1e-12 refer. Raise OrbitLostError if the distance
    from the origin falls to ``lowest_m`` before the end of the interval with the last time, or the integrator fails.
    """
    length, speed = float(np.linalg.norm(state[:3])), float(np.linalg.norm(state[3:]))
    # One absolute tolerance holds for positions and velocities only if both are near 1.
    unit = np.repeat([length, speed], 3)
    found, now = np.empty((len(times_s), 6)), state / unit
    time = length / speed
    piece = pushes.piece(times_s)

    def height(_: float, y: FloatArray) -> float:
        return float(np.linalg.norm(y[:3]) - lowest_m / length)

    height.terminal = True  # type: ignore[attr-defined]  # how solve_ivp is told to stop there
    # Interval by interval: the steps of the integrator must not cross a jump of the acceleration.
    for p, push in enumerate(pushes.acceleration_m_s2):
        begin, end = pushes.edges_s[p : p + 2]
        rows = np.flatnonzero(piece == p)

        def change(t: float, y: FloatArray, push: FloatArray = push) -> FloatArray:
            pull = acceleration(time * t, length * y[:3]) + push
            # d(v / speed) / d(t / time) = a time / speed, with time = length / speed.
            return np.concatenate([y[3:], pull * time / speed])

        # The end of the interval is added: the next one starts there.
        at, place = np.unique(np.append(times_s[rows], end) / time, return_inverse=True)
        between = (float(begin) / time, float(end) / time)
        solved = solve_ivp(change, between, now, "DOP853", t_eval=at, events=height, rtol=_TOLERANCE, atol=_TOLERANCE)
        if solved.status != 0:
            ends = solved.t_events[0] if solved.t_events is not None and len(solved.t_events[0]) else [between[1]]
            hours = float(ends[0]) * time / 3600.0
            raise OrbitLostError(
                f"the orbit leads into the body, which reaches {lowest_m:.4g} m from its centre, after {hours:.3g} h:"
                " begin farther away or lower the forces"
            )
        found[rows] = solved.y[:, place[:-1]].T * unit
        now = solved.y[:, -1]
        # No requested time lies in a later interval.
        if not (piece > p).any():
            break
    return found
