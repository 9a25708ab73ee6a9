"""Orbit propagation: with adaptive steps for the truth, with variational equations in fixed steps for filters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853, solve_ivp

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics import inner, kernel
from boresight.scenarios.dynamics.field import FlatField, HarmonicField, differentiate
from boresight.scenarios.errors import UndrawableError
from boresight.scenarios.spec.orbit import SunEarthSpec
from boresight.scenarios.spec.sequence import ForcesSpec

Acceleration = Callable[[float, FloatArray], FloatArray]
"""(3,) m/s2 at a time, s, and a position (3,) m, inertial axes."""

SUNLIGHT_N_M2 = 1361.0 / 299_792_458.0
"""Pressure of absorbed sunlight at 1 au: total solar irradiance over the speed of light."""

_TOLERANCE = 1e-12  # of the scaled state, relative and absolute


class OrbitLostError(UndrawableError):
    """An orbit impacts on the body or diverges."""


def radiation_pressure(forces: ForcesSpec | SunEarthSpec, sun_dir: FloatArray) -> FloatArray:
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


LONGEST_STEP_S = 1800.0
"""Longest step: a tenth of Eros's rotation period; the rotating harmonics change fastest at 200 km."""


def propagate_states(
    field: HarmonicField, state: FloatArray, times_s: FloatArray, pushes: PiecewiseAcceleration
) -> FloatArray:
    """(T, 6) states at (T,) ascending times from the state (6,) at time 0, by `propagate`.

    Raise OrbitLostError if the orbit comes nearer the origin than the field's reference radius.
    """
    return propagate(field.acceleration, field.harmonics.radius_m, state, times_s, pushes)


@dataclass(frozen=True, slots=True, eq=False)
class OrbitPartials:
    """States (T, 6), m and m/s, with partial derivatives; those by the accelerations of later intervals are zero.

    ``by_state`` (T, 6, 6) is the state transition matrix from the epoch, ``by_parameters`` (T, 6, p) are derivatives by
    the field's parameters, ``by_pushes`` (T, 6, 3 P) by the piecewise accelerations.
    """

    states: FloatArray
    by_state: FloatArray
    by_parameters: FloatArray
    by_pushes: FloatArray


def propagate_partials(
    field: HarmonicField, state: FloatArray, times_s: FloatArray, pushes: PiecewiseAcceleration
) -> OrbitPartials:
    """Propagate an orbit with its partial derivatives by DOP853 in fixed steps that end at each requested time.

    Derivatives by a piecewise acceleration are integrated over its interval. After its end they are the state
    transition matrix times the equivalent change of the state at the epoch, ``Phi^-1 Gamma`` at the end. Raise
    OrbitLostError if the orbit comes nearer the origin than the field's reference radius, or diverges.
    """
    flat, p = field.flat, field.parameters
    stages = DOP853.n_stages
    # The stages of the solution alone: fixed steps need neither its error estimate nor dense output.
    tableau = (
        np.ascontiguousarray(DOP853.A[:stages, :stages]),
        np.array(DOP853.B),
        np.array(DOP853.C[:stages]),
    )
    seen, ended = _integrate(
        flat, np.array(state), np.array(times_s), pushes.edges_s, pushes.acceleration_m_s2, LONGEST_STEP_S, *tableau
    )
    if not (np.isfinite(seen).all() and np.isfinite(ended).all()):
        raise OrbitLostError("the orbit leads into the body or beyond all bounds")
    return OrbitPartials(
        seen[:, :, 0], seen[:, :, 1:7], seen[:, :, 7 : 7 + p], _by_pushes(seen, ended, pushes, times_s)
    )


def _by_pushes(seen: FloatArray, ended: FloatArray, pushes: PiecewiseAcceleration, times_s: FloatArray) -> FloatArray:
    """(T, 6, 3 P) derivatives by each acceleration, from those at the end of its interval."""
    pieces = len(pushes.acceleration_m_s2)
    # Velocities in units of speed over distance, which makes the matrix well-conditioned.
    scale = np.repeat([1.0, np.linalg.norm(ended[0, :3, 0]) / np.linalg.norm(ended[0, 3:, 0])], 3)
    transition = ended[:, :, 1:7] * scale[:, None] / scale
    at_epoch = np.linalg.solve(transition, ended[:, :, -3:] * scale[:, None]) / scale[:, None]
    found = np.zeros((len(seen), 6, pieces, 3))
    piece = pushes.piece(times_s)
    for p in range(pieces):
        later = piece > p
        if p < len(at_epoch):
            # Phi(t, 0) Phi(t_p, 0)^-1 Gamma(t_p) for times after the end t_p of the interval.
            found[later, :, p] = seen[later, :, 1:7] @ at_epoch[p]
        now = piece == p
        found[now, :, p] = seen[now, :, -3:]
    return found.reshape(len(seen), 6, 3 * pieces)


@kernel
def _integrate(
    field: FlatField,
    state: FloatArray,
    times: FloatArray,
    edges: FloatArray,
    pushes: FloatArray,
    longest: float,
    a: FloatArray,
    b: FloatArray,
    c: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Integrate; return (T, 6, n) at the times and (P', 6, n) at the interval ends before the last time."""
    # State, derivatives by the initial state, by GM and solar pressure, by the coefficients, and by the push.
    columns = 1 + 6 + 2 + field.parts.shape[2] // 3 + 3
    y = np.zeros((6, columns))
    for i in range(6):
        # The state transition matrix starts as the identity, all other derivatives as 0.
        y[i, 0], y[i, 1 + i] = state[i], 1.0
    seen, ended = np.empty((len(times), 6, columns)), np.empty((len(pushes), 6, columns))
    slopes = np.empty((len(b), 6, columns))
    work = np.empty((2, max(field.pull.shape[1], field.tide.shape[1], field.parts.shape[1])))
    now, row = 0.0, 0
    for p in range(len(pushes)):
        last = p == len(pushes) - 1
        wanted = True
        while wanted:
            # Each of the times, then the end. As in `PiecewiseAcceleration.piece`, a limit belongs to the interval that
            # it ends.
            wanted = row < len(times) and (times[row] <= edges[p + 1] or last)
            end = times[row] if wanted else edges[p + 1]
            _integrate_interval(field, y, now, end, pushes[p], longest, a, b, c, slopes, work)
            now = end
            if wanted:
                _copy(seen[row], y)
                row += 1
        _copy(ended[p], y)
        # The next push is another parameter, which has not acted yet.
        y[:, columns - 3 :] = 0.0
        if row == len(times):
            return seen, ended[: p + 1]
    return seen, ended


@inner
def _integrate_interval(
    field: FlatField,
    y: FloatArray,
    begin: float,
    end: float,
    push: FloatArray,
    longest: float,
    a: FloatArray,
    b: FloatArray,
    c: FloatArray,
    slopes: FloatArray,
    work: FloatArray,
) -> None:
    """Integrate from one time to another in equal steps, in place; NaN after an impact."""
    if end <= begin:
        return
    # Equal steps that end at the requested time: no interpolation, and the same steps in each call.
    steps = int(np.ceil((end - begin) / longest))
    h = (end - begin) / steps
    at = np.empty_like(y)
    for step in range(steps):
        t = begin + step * h
        for i in range(len(b)):
            _copy(at, y)
            for j in range(i):
                if a[i, j] != 0.0:
                    _add(at, slopes[j], h * a[i, j])
            # Inside the reference radius the harmonics need not converge.
            if not _time_derivative(field, t + c[i] * h, at, push, work, slopes[i]):
                y[:] = np.nan
                return
        for i in range(len(b)):
            _add(y, slopes[i], h * b[i])


@inner
def _copy(out: FloatArray, values: FloatArray) -> None:
    """Write an array; Numba compiles an assignment of arrays ten times as slowly."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = values[i, j]


@inner
def _add(total: FloatArray, added: FloatArray, factor: float) -> None:
    """Add a multiple of an array in place."""
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            total[i, j] += factor * added[i, j]


@inner
def _time_derivative(
    field: FlatField, time: float, y: FloatArray, push: FloatArray, work: FloatArray, out: FloatArray
) -> bool:
    """Write the time derivative of state and partials to ``out``; return False inside the reference radius."""
    if not y[0, 0] ** 2 + y[1, 0] ** 2 + y[2, 0] ** 2 > field.radius_m**2:
        return False
    columns, count = y.shape[1], 2 + field.parts.shape[2] // 3
    tide, by, position = np.empty((3, 3)), np.empty((3, count)), np.empty(3)
    for i in range(3):
        position[i] = y[i, 0]
    differentiate(field, time, position, work, tide, by)
    for i in range(3):
        for k in range(columns):
            # r' = v, for the state and for all derivatives.
            out[i, k] = y[3 + i, k]
        # by[:, 0] is the derivative by the ratio of GM: gravity itself.
        out[3 + i, 0] = by[i, 0] + field.light_m_s2[i] + push[i]
        for k in range(1, columns):
            # Variational equations: (dv/dp)' = (da/dr)(dr/dp) + da/dp.
            out[3 + i, k] = tide[i, 0] * y[0, k] + tide[i, 1] * y[1, k] + tide[i, 2] * y[2, k]
        for k in range(count):
            out[3 + i, 7 + k] += by[i, k]
        out[3 + i, columns - 3 + i] += 1.0
    return True
