"""Made-up flights past a body in a few numbers: a flyby, a hover and a descent, as tables of states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydantic import Field

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import orbit_axes
from boresight.scenarios.spec.base import SpecModel, rule
from boresight.scenarios.spec.distribution import Direction, Row3
from boresight.scenarios.spec.tables import Table

MOST_STATES = 20_000
_LEAST_EXCESS = 1e-6  # of the eccentricity over 1, below which a hyperbola has no digits
_NEWTON_STEPS = 60


def _epochs(start_s: float, duration_s: float, step_s: float, multiple: int = 1) -> FloatArray:
    """(n,) epochs from start to end, at the longest equal steps that ``step_s`` allows, a multiple of them."""
    # Rounding must not make a step more of a whole number of them.
    steps = multiple * max(1.0, np.ceil(duration_s / step_s / multiple - 1e-9))
    if steps >= MOST_STATES:
        raise ValueError(f"{steps + 1:.3g} states are more than {MOST_STATES}: take longer steps")
    return np.asarray(start_s + duration_s * np.arange(int(steps) + 1) / steps, dtype=np.float64)


def _columns(time_s: FloatArray, position_m: FloatArray, velocity_m_s: FloatArray | None = None) -> Table:
    columns = {"time_s": time_s, **dict(zip(("x_m", "y_m", "z_m"), position_m.T, strict=True))}
    if velocity_m_s is not None:
        columns |= zip(("vx_m_s", "vy_m_s", "vz_m_s"), velocity_m_s.T, strict=True)
    return {name: values.tolist() for name, values in columns.items()}


class FlybySpec(SpecModel):
    """A hyperbola about a point mass; time 0 is that of the periapsis, in the middle.

    The periapsis is the point of the orbit's plane nearest to the x axis, or to the y axis if the normal is along x.
    """

    periapsis_m: float = Field(gt=0, le=1e12, description="Least distance from the body's origin")
    v_infinity_m_s: float = Field(gt=0, le=1e6, description="Speed far from the body")
    gm_m3_s2: float = Field(ge=1e-9, le=1e20, description="Gravity of the body")
    duration_s: float = Field(gt=0, le=1e9, description="From the first to the last state")
    step_s: float = Field(ge=1e-3, description="Longest time from state to state; all are equal")
    normal: Direction = Field((0.0, 0.0, 1.0), description="Normal of the plane: periapsis x velocity there")

    @rule
    def _is_a_hyperbola(self) -> None:
        if self._excess < _LEAST_EXCESS:
            raise ValueError(f"v_infinity_m_s {self.v_infinity_m_s:g} makes a parabola: raise it")

    @property
    def _excess(self) -> float:
        """Eccentricity less 1."""
        return self.periapsis_m * self.v_infinity_m_s**2 / self.gm_m3_s2

    def states(self) -> Table:
        """Solve Kepler's equation of the hyperbola, e sinh H - H = n t, at every epoch by Newton's method."""
        time_s = _epochs(-0.5 * self.duration_s, self.duration_s, self.step_s, 2)  # with the periapsis
        semi_m, rate = self.gm_m3_s2 / self.v_infinity_m_s**2, self.v_infinity_m_s**3 / self.gm_m3_s2
        e, mean = 1.0 + self._excess, rate * time_s
        # Two bounds of the solution: e sinh H - H is above (e - 1) sinh H and e H^3 / 6. From there Newton's method
        # approaches it from one side.
        h = np.sign(mean) * np.minimum(np.arcsinh(np.abs(mean) / self._excess), np.cbrt(6.0 * np.abs(mean) / e))
        for _ in range(_NEWTON_STEPS):
            h = h - (e * np.sinh(h) - h - mean) / (e * np.cosh(h) - 1.0)
        minor = semi_m * np.sqrt(self._excess * (e + 1.0))
        # a (e - cosh H), without the loss of digits where a is small.
        along = self.periapsis_m - 2.0 * semi_m * np.sinh(0.5 * h) ** 2
        first, second, _ = orbit_axes(np.array(self.normal))
        speed = (rate / (e * np.cosh(h) - 1.0))[:, None]
        position = np.outer(along, first) + np.outer(minor * np.sinh(h), second)
        velocity = speed * (np.outer(-semi_m * np.sinh(h), first) + np.outer(minor * np.cosh(h), second))
        return _columns(time_s, position, velocity)


class HoverSpec(SpecModel):
    """A point that the camera keeps, or about which it drifts in a box at constant speed, thrown back at its walls."""

    position_m: Row3 = Field(description="The point, from the body's origin")
    duration_s: float = Field(gt=0, le=1e9, description="From the first to the last state")
    step_s: float = Field(ge=1e-3, description="Longest time from state to state; all are equal")
    box_m: float = Field(0.0, ge=0, le=1e12, description="Half a side of the box of station keeping; 0 for none")
    drift_m_s: float = Field(0.0, ge=0, le=1e6, description="Speed of the drift in the box")

    @rule
    def _a_box_is_drifted_in(self) -> None:
        if bool(self.box_m) != bool(self.drift_m_s):
            raise ValueError("box_m and drift_m_s belong together: give both or none")

    def states(self) -> Table:
        """Place the camera at every epoch; in the box its way is from the middle towards a corner first."""
        time_s = _epochs(0.0, self.duration_s, self.step_s)
        position = np.tile(np.array(self.position_m), (len(time_s), 1))
        if self.box_m:
            # Speeds whose ratios are irrational, so that the way does not close.
            parts = 1.0 / np.sqrt([1.0, 2.0, 3.0])
            phase = np.outer(time_s * self.drift_m_s / self.box_m, parts / np.linalg.norm(parts))
            # A triangle wave from 0 upwards, of amplitude 1 and period 4.
            position += self.box_m * (np.abs((phase - 1.0) % 4.0 - 2.0) - 1.0)
        return _columns(time_s, position)


class DescentSpec(SpecModel):
    """A straight way down towards the body's origin at a constant rate.

    Heights are above the true surface, craters and boulders included, below the last state.
    """

    direction: Direction = Field(description="From the body's origin to the camera")
    from_altitude_m: float = Field(gt=0, le=1e12, description="First height")
    to_altitude_m: float = Field(gt=0, description="Last height")
    rate_m_s: float = Field(gt=0, le=1e6, description="Rate of the descent")
    step_s: float = Field(ge=1e-3, description="Longest time from state to state; all are equal")

    @rule
    def _leads_down(self) -> None:
        if self.to_altitude_m >= self.from_altitude_m:
            raise ValueError(
                f"to_altitude_m {self.to_altitude_m:g} is not below from_altitude_m {self.from_altitude_m:g}"
            )

    def states(self, surface_m: Callable[[float, FloatArray], float]) -> Table:
        """Place the camera at every epoch.

        ``surface_m`` returns the distance of the surface from the origin, m, at an epoch along a unit vector (3,).
        """
        time_s = _epochs(0.0, (self.from_altitude_m - self.to_altitude_m) / self.rate_m_s, self.step_s)
        up = np.array(self.direction) / np.linalg.norm(self.direction)
        ranges_m = surface_m(float(time_s[-1]), up) + self.from_altitude_m - self.rate_m_s * time_s
        return _columns(time_s, np.outer(ranges_m, up))
