"""Trajectories of the camera about the body: states from a table, from SPICE kernels or of a made-up flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import orbit_axes, spherical_direction
from boresight.scenarios.spec.base import SpecModel, optional, rule
from boresight.scenarios.spec.camera import BodyKernelsSpec
from boresight.scenarios.spec.distribution import Direction, Row3
from boresight.scenarios.spec.tables import REF_FRAME, Table, columns_of, read_table

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


_DAY_S = 86400.0
_QUATERNION = ("qw", "qx", "qy", "qz")
_SUN = ("sun_x", "sun_y", "sun_z")
# Beginnings of the names of inertial frames; ICRF2 and ICRF3 begin so too.
_INERTIAL = ("B1950", "ECLIPJ2000", "EME2000", "GCRF", "ICRF", "J2000", "MCI", "MOD", "TEME", "TOD")
LEAST_HORIZONTAL = 1e-6  # of a velocity, below which its horizontal part has no direction
_UNITS = {"m": 1.0, "km": 1000.0}
_POSITION = tuple(f"{axis}_{unit}" for unit in _UNITS for axis in "xyz")
_VELOCITY = tuple(f"v{axis}_{unit}_s" for unit in _UNITS for axis in "xyz")
_KNOWN = ("time_s", *_POSITION, *_VELOCITY, *_QUATERNION, *_SUN, REF_FRAME)


class RotationSpec(SpecModel):
    """Rotation of the body by the angles of the IAU: pole, prime meridian at time 0, and rate."""

    pole_ra_deg: float = Field(description="Right ascension of the pole in the inertial frame")
    pole_dec_deg: float = Field(ge=-90, le=90, description="Declination of the pole")
    meridian_deg: float = Field(0.0, description="W: angle of the prime meridian at time 0")
    rate_deg_day: float = Field(ge=-1e9, le=1e9, description="Rate of W; negative for a retrograde rotation")

    def matrices(self, time_s: FloatArray) -> FloatArray:
        """(n, 3, 3) rotations from inertial to body axes at times (n,): Rz(W) Rx(90 deg - dec) Rz(90 deg + ra)."""
        ra, dec = np.radians([self.pole_ra_deg, self.pole_dec_deg])
        meridian = np.radians(self.meridian_deg + self.rate_deg_day * time_s / _DAY_S)
        node = np.array([-np.sin(ra), np.cos(ra), 0.0])  # where the body's equator crosses the inertial one
        pole = spherical_direction(ra, dec)
        across, c, s = np.cross(pole, node), np.cos(meridian)[:, None], np.sin(meridian)[:, None]
        rows = [c * node + s * across, c * across - s * node, np.broadcast_to(pole, (len(time_s), 3))]
        return np.asarray(np.stack(rows, axis=1), dtype=np.float64)


class StatesSpec(SpecModel):
    """States of the camera in body axes, one for each epoch, as `FlownSpec` reads them."""

    time_s: tuple[float, ...] = Field(min_length=1, max_length=MOST_STATES, description="Epochs")
    position_m: tuple[Row3, ...] = Field(description="Camera from the body's origin")
    velocity_m_s: tuple[Row3, ...] | None = Field(None, description="Inertial velocity about the body's origin")
    attitude: tuple[tuple[float, float, float, float], ...] | None = Field(
        None, description="Quaternions w, x, y, z from body to camera axes"
    )
    sun_dir: tuple[Row3, ...] | None = Field(None, description="Unit vectors towards the Sun")
    spin_rad_s: Row3 | None = optional("Angular velocity of the body at the first epoch, for sequences")

    def __len__(self) -> int:
        return len(self.time_s)

    @rule
    def _one_of_each(self) -> None:
        columns = (self.position_m, self.velocity_m_s, self.attitude, self.sun_dir)
        if any(column is not None and len(column) != len(self) for column in columns):
            raise ValueError("states are of unlike number")

    def velocity(self, state: int) -> FloatArray | None:
        """Return the velocity (3,) of a state; None if the states have none."""
        return None if self.velocity_m_s is None else np.array(self.velocity_m_s[state])

    @property
    def has_planes(self) -> bool:
        """True if position and velocity span a plane at every epoch, not by their last digits alone."""
        if self.velocity_m_s is None:
            return False
        across = np.linalg.norm(np.cross(self.position_m, self.velocity_m_s), axis=1)
        sizes = np.linalg.norm(self.position_m, axis=1) * np.linalg.norm(self.velocity_m_s, axis=1)
        return bool((across > LEAST_HORIZONTAL * sizes).all())


class SpiceTrajectorySpec(BodyKernelsSpec):
    """States of a spacecraft from SPICE kernels, at equal steps of time."""

    observer: str = Field(min_length=1, description="NAIF's name of the spacecraft")
    camera_frame: str | None = Field(
        None,
        min_length=1,
        description="NAIF's name of the camera's frame (x right, y down, z along the boresight), for attitudes from a"
        " CK; left out: the boresight is on the body's origin, or on targets",
    )
    start_utc: str = Field(min_length=1, description="First epoch, as SPICE reads it: 2005-10-07T19:33:00")
    stop_utc: str = Field(min_length=1, description="Last epoch")
    step_s: float = Field(ge=1e-3, description="Time from state to state")


class FlownSpec(SpecModel):
    """States of the camera from one source, read once, in body axes."""

    alternatives: ClassVar = (("table", "spice", "flyby", "hover", "descent"),)
    reads_spin: ClassVar[bool] = False

    table: str | None = Field(
        None, min_length=1, description="CSV, Parquet, OEM or TUM file of states, in increasing order of time"
    )
    spice: SpiceTrajectorySpec | None = optional("States from SPICE kernels, instead of table")
    flyby: FlybySpec | None = optional("A hyperbola, instead of table")
    hover: HoverSpec | None = optional("A point that is kept, instead of table")
    descent: DescentSpec | None = optional("A straight way down at a constant rate, instead of table")
    rotation: RotationSpec | None = Field(
        None, description="Rotation of the body, for states in inertial axes; left out: states are in body axes"
    )
    read_states: StatesSpec | None = optional("Filled in from table, kernels or flight; not written by hand")

    @rule
    def _kernels_have_the_rotation(self) -> None:
        if self.spice is not None and self.rotation is not None:
            raise ValueError("rotation has no part where kernels have it: leave it out")

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        context = info.context or {}
        if self.read_states is not None:
            if context:  # of a file; a stored scenario has them
                raise ValueError("read_states are filled in from the table, the kernels or the flight: leave them out")
            return self
        source = self.table or next(key for key in type(self).alternatives[0] if getattr(self, key) is not None)
        try:
            states = self._of_source(context.get("folders", ()), context.get("surface_m"))
        except (BoresightError, ImportError, OSError, ValueError, TypeError) as error:
            raise ValueError(f"{source} cannot be used: {error}") from None
        return self.model_copy(update={"read_states": states})

    def _of_source(self, folders: Sequence[Path], surface_m: Callable[[FloatArray], float] | None) -> StatesSpec:
        """Read or compute the states; ``surface_m`` returns the distance of the body's surface along a unit vector."""
        if self.spice is not None:
            from boresight.scenarios.spice import spice_states  # spiceypy is not always installed

            return spice_states(self.spice, folders, spin=self.reads_spin)
        if self.descent is not None:
            if surface_m is None:
                raise ValueError("its heights are above the body of a scenario: read it from a file")

            def below_m(time_s: float, up: FloatArray) -> float:
                return surface_m(up if self.rotation is None else self.rotation.matrices(np.array([time_s]))[0] @ up)

            return states_of(self.descent.states(below_m), self.rotation)
        flight = self.flyby or self.hover
        return states_of(read_table(str(self.table), folders) if flight is None else flight.states(), self.rotation)

    @property
    def states(self) -> StatesSpec:
        """The states."""
        if self.read_states is None:
            raise ValueError("a trajectory is read when its scenario is")
        return self.read_states


class TrajectorySpec(FlownSpec):
    """States of the camera, one view each: from a table, from SPICE kernels or of a made-up flight.

    A table is CSV or Parquet with the columns ``time_s`` and ``x_m``, ``y_m``, ``z_m``, the camera from the body's
    origin. It may have ``vx_m_s``, ``vy_m_s``, ``vz_m_s``, the inertial velocity; ``qw``, ``qx``, ``qy``, ``qz``, the
    rotation from the table's axes to those of the camera (x right, y down, z along the boresight); and ``sun_x``,
    ``sun_y``, ``sun_z``, the direction to the Sun. In place of metres there may be kilometres (``x_km``, ``vx_km_s``).
    Or it is an Orbit Ephemeris Message of the CCSDS as text, ``.oem``, or a trajectory of poses, ``.tum``. Without an
    attitude the boresight is on the body's origin, or on ``targets``; without a Sun its direction is drawn by
    ``lighting``.
    """

    prose: ClassVar = frozenset({"table", "rotation", "spice", "flyby", "hover", "descent"})

    order: Literal["in-turn", "random"] = Field(
        "in-turn", description="Trial t has state t, beginning again after the last, or one drawn at random"
    )


class SequenceTrajectorySpec(FlownSpec):
    """States of the camera, one frame of a sequence each, from the sources of ``viewpoint.trajectory``.

    Without attitudes the boresight is on the body's origin, and x along the horizontal velocity; where there are no
    velocities, or they are vertical, north is up. Inertial axes are the body's axes at the first frame. With
    ``rotation`` or kernels the body rotates as they say, with kernels uniformly at the rate of the first frame; else as
    ``body_motion`` says.
    """

    # The rotation and the gravity of a flyby decide more than the states.
    prose: ClassVar = frozenset({"table", "spice", "hover", "descent"})
    reads_spin: ClassVar[bool] = True

    sun_dir: Direction | None = optional(
        "Direction to the Sun in the axes of the states, at the first frame and fixed in space; left out:"
        " that of the table or the kernels, else behind the first camera"
    )

    @rule
    def _one_sun_and_two_frames(self) -> None:
        if len(self.states) < 2:
            raise ValueError("a sequence needs two states at least")
        if self.sun_dir is not None and self.states.sun_dir is not None:
            raise ValueError("sun_dir has no part where the states have the Sun: leave it out")


def states_of(table: Table, rotation: RotationSpec | None = None) -> StatesSpec:
    """Turn the columns of a table, as `TrajectorySpec` has them, into states in body axes.

    Raise ValueError or TypeError if a column is missing or wrong, or the table is not in the order of time.
    """
    if unknown := [name for name in table if name not in _KNOWN]:
        # A needed column that is missing is often there by another name.
        needed = (("time_s",), *((f"{axis}_m", f"{axis}_km") for axis in "xyz"))
        absent = [names[0] for names in needed if not any(name in table for name in names)]
        missing = f"{', '.join(absent)} {'is' if len(absent) == 1 else 'are'} missing; " if absent else ""
        told = (
            f"{missing}unknown columns {', '.join(map(repr, unknown))}: {'rename or ' if absent else ''}leave them out"
        )
        raise ValueError(f"{told}; known are {', '.join(_KNOWN)}")
    frame = str(table[REF_FRAME][0]) if len(table.get(REF_FRAME, ())) else None
    inertial = frame is not None and frame.upper().startswith(_INERTIAL)
    if inertial and rotation is None:
        raise ValueError(f"its states are in {frame}, inertial axes: give the body's rotation")
    if frame is not None and not inertial and rotation is not None:
        raise ValueError(f"its states are in {frame}, taken as body axes: rotation has no part, leave it out")
    times = columns_of(table, ("time_s",))[:, 0]
    if not 1 <= len(times) <= MOST_STATES:
        raise ValueError(f"{len(times)} states are not within [1, {MOST_STATES}]")
    steps = np.diff(times)
    if not (steps > 0.0).all():
        at = int(np.argmin(steps > 0.0)) + 1
        raise ValueError(f"time_s {times[at]:.10g} of row {at} (from 0) is not after the one before: sort the table")
    to_body = np.eye(3)[None] if rotation is None else rotation.matrices(times)
    position = _metres(table, "", "_{}")
    # One column of a group calls for all of it.
    # Those of a message in rotating axes are relative to them.
    has_velocity = any(name in table for name in _VELOCITY) and (frame is None or inertial)
    velocity = _metres(table, "v", "_{}_s") if has_velocity else None
    quaternions = columns_of(table, _QUATERNION) if any(name in table for name in _QUATERNION) else None
    sun = columns_of(table, _SUN) if any(name in table for name in _SUN) else None
    if not np.linalg.norm(position, axis=1).all():
        raise ValueError("a position is the body's origin")
    if quaternions is not None:
        quaternions = _unit(quaternions, "the quaternion")
        quaternions = np.where(quaternions[:, :1] < 0.0, -quaternions, quaternions)
        if rotation is not None:
            from scipy.spatial.transform import Rotation

            # From body to camera axes, of those from the table's axes.
            of_table = Rotation.from_quat(quaternions, scalar_first=True)
            from_body = of_table * Rotation.from_matrix(to_body).inv()
            quaternions = np.asarray(from_body.as_quat(canonical=True, scalar_first=True), dtype=np.float64)
    return StatesSpec(
        time_s=tuple(times.tolist()),
        position_m=rows_of(_turned(to_body, position)),
        velocity_m_s=None if velocity is None else rows_of(_turned(to_body, velocity)),
        attitude=None if quaternions is None else rows_of(quaternions),
        sun_dir=None if sun is None else rows_of(_turned(to_body, _unit(sun, "the direction to the Sun"))),
    )


def _metres(table: Table, prefix: str, suffix: str) -> FloatArray:
    """Return x, y and z, (n, 3), in metres or m/s, from columns in metres or kilometres."""
    given = [unit for unit in _UNITS if f"{prefix}x{suffix.format(unit)}" in table]
    if len(given) == 2:
        raise ValueError(f"{prefix}x is given in m and in km: leave one out")
    unit = given[0] if given else "m"
    return _UNITS[unit] * columns_of(table, tuple(f"{prefix}{axis}{suffix.format(unit)}" for axis in "xyz"))


def _unit(vectors: FloatArray, what: str) -> FloatArray:
    """Return vectors divided by their length, which must be 1 within a hundredth, as rounded digits leave it."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not (np.abs(lengths - 1.0) < 0.01).all():
        row = int(np.argmax(np.abs(lengths - 1.0)))
        raise ValueError(f"row {row} (from 0): {what} has the length {float(lengths[row, 0]):.4g}, not 1")
    return np.asarray(vectors / lengths, dtype=np.float64)


def _turned(to_body: FloatArray, vectors: FloatArray) -> FloatArray:
    turned = np.einsum("nij,nj->ni", np.broadcast_to(to_body, (len(vectors), 3, 3)), vectors)
    return np.asarray(turned, dtype=np.float64)


def rows_of(values: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Return the rows of an array, (n, m), as plain numbers."""
    return tuple(map(tuple, values.tolist()))
