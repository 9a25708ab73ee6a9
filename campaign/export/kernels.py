"""SPICE kernels of stored runs: the motion of a camera as SPK of type 13, its attitude as CK of type 3.

The estimate has the NAIF name BORESIGHT_CAMERA, the truth BORESIGHT_TRUE_CAMERA; each is a spacecraft and a frame. The
text kernel ``boresight.tf`` defines the names, the frames and the clock of the CK. Positions are from the body's centre
in the inertial axes of the run, which are written as J2000; those of single images are in body axes, which are a frame
of their own. Velocities that a method does not estimate are those of a cubic spline through its positions. Between
states SPICE interpolates by Hermite polynomials of degree 7, and attitudes turn at a constant rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import spiceypy
from scipy.interpolate import CubicSpline

from boresight.campaign.inspection.show import Flight, PosedFrame
from boresight.scenarios.atomic import write_atomically, write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spice import loaded_kernels

BODY_ID = 9999999
"""NAIF identifier of the body if none is given; no body of NAIF has it."""

BODY_AXES = "BORESIGHT_BODY_FIXED"
_AXES = {
    f"FRAME_{BODY_AXES}": "1999999",
    "FRAME_1999999_NAME": f"'{BODY_AXES}'",
    "FRAME_1999999_CLASS": "4",
    "FRAME_1999999_CLASS_ID": "1999999",
    "FRAME_1999999_CENTER": "399",  # of no account for axes that do not turn against J2000, and known to SPICE
    "TKFRAME_1999999_RELATIVE": "'J2000'",
    "TKFRAME_1999999_SPEC": "'MATRIX'",
    "TKFRAME_1999999_MATRIX": "( 1 0 0 0 1 0 0 0 1 )",
}

_TICKS_PER_S = 65536  # a power of two, so that epochs keep every bit
_SECONDS = 1 << 32  # range of the clock
_DEGREE = 7  # of the Hermite polynomials between states
_M_PER_KM = 1e3
_FEWEST_STATES = 2  # states that make a trajectory


@dataclass(frozen=True, slots=True)
class _Identity:
    spacecraft: int
    name: str

    @property
    def frame(self) -> int:
        return 1000 * self.spacecraft - 1


_IDENTITIES = {"estimate": _Identity(-999, "BORESIGHT_CAMERA"), "truth": _Identity(-998, "BORESIGHT_TRUE_CAMERA")}


@dataclass(frozen=True, slots=True)
class Origin:
    """NAIF identifier of the body at the centre, and ET, s past J2000 TDB, at which the time of a run is 0.

    ``clock_s`` is the time of the run at which the clock of the CK is 0. It has no time before. ``axes`` is the frame
    that positions and attitudes refer to: J2000, or `BODY_AXES`.
    """

    body: int = BODY_ID
    et: float = 0.0
    clock_s: int = 0
    axes: str = "J2000"

    def before(self, flights: Iterable[Mapping[str, Flight]]) -> Origin:
        """Return the origin with a clock that begins at a whole second before all flights, and not after time 0."""
        first_s = min((flight.attitude_times_s[0] for each in flights for flight in each.values()), default=0.0)
        return replace(self, clock_s=min(int(np.floor(first_s)), 0))


def flights_of(frames: Sequence[PosedFrame]) -> dict[str, Flight]:
    """Return truth and estimate of the frames of a flight, in the axes of their poses; none without frames."""
    if not frames:
        return {}
    times_s = np.array([frame.time_s for frame in frames])
    poses = {"truth": [frame.true for frame in frames], "estimate": [frame.estimated for frame in frames]}
    return {
        which: Flight(
            times_s,
            np.array([pose.camera_position_m for pose in own]),
            None,
            times_s,
            np.array([pose.rotation for pose in own]),
        )
        for which, own in poses.items()
    }


def write_kernels(name: str, flights: Mapping[str, Flight], origin: Origin, out: Path) -> list[Path]:
    """Write ``NAME.WHICH.bsp`` and ``NAME.WHICH.bc`` of flights by ``WHICH``, truth or estimate; return the files.

    A flight of a single state is no trajectory and has no SPK. Raise BoresightError if SPICE refuses the values.
    """
    written = []
    for which, flight in flights.items():
        stem, own = out / f"{name}.{which}", _IDENTITIES[which]
        if len(flight.times_s) >= _FEWEST_STATES:
            written.append(stem.with_name(f"{stem.name}.bsp"))
            write_atomically(written[-1], partial(_write_spk, flight, own, origin))
        if len(flight.attitude_times_s):
            written.append(stem.with_name(f"{stem.name}.bc"))
            write_atomically(written[-1], partial(_write_ck, flight, own, origin))
    return written


def _write_spk(flight: Flight, own: _Identity, origin: Origin, path: Path) -> None:
    epochs = origin.et + flight.times_s
    if not (np.diff(epochs) > 0.0).all():
        raise BoresightError("an SPK needs times that ascend, also after --start-et: export this run with --to tum")
    velocities = flight.velocities_m_s
    if velocities is None:
        velocities = CubicSpline(flight.times_s, flight.positions_m, axis=0)(flight.times_s, 1)
    states_km = np.hstack([flight.positions_m, velocities]) / _M_PER_KM
    with _new_file(path, own, spiceypy.spkopn, spiceypy.spkcls) as handle:
        spiceypy.spkw13(
            handle, own.spacecraft, origin.body, origin.axes, epochs[0], epochs[-1], own.name,
            min(_DEGREE, 2 * len(epochs) - 1), len(epochs), states_km, epochs,
        )  # fmt: skip


def _write_ck(flight: Flight, own: _Identity, origin: Origin, path: Path) -> None:
    """Write attitudes that turn at a constant rate from one to the next."""
    times_s, first = np.unique(flight.attitude_times_s, return_index=True)
    ticks = _TICKS_PER_S * (times_s - origin.clock_s)
    with _new_file(path, own, spiceypy.ckopn, spiceypy.ckcls) as handle:
        quat_wxyz = np.array([spiceypy.m2q(matrix) for matrix in flight.R_cam_inertial[first]])
        spiceypy.ckw03(
            handle, ticks[0], ticks[-1], own.frame, origin.axes, False, own.name, len(ticks), ticks, quat_wxyz,
            np.zeros((len(ticks), 3)), 1, ticks[:1],
        )  # fmt: skip


@contextmanager
def _new_file(
    path: Path, own: _Identity, begin: Callable[[str, str, int], int], end: Callable[[int], None]
) -> Iterator[int]:
    """Open a file for writing and close it, with the body's axes known; errors of SPICE become BoresightErrors."""
    # Without kernels, the context only keeps other threads from SPICE and converts its errors.
    with loaded_kernels([]), ExitStack() as forgotten:
        spiceypy.lmpool([f"{name} = {value}" for name, value in _AXES.items()])
        for name in _AXES:
            forgotten.callback(spiceypy.dvpool, name)
        handle = begin(str(path), own.name, 0)
        try:
            yield handle
        except BaseException:
            spiceypy.dafcls(handle)  # the closing routines of kernels refuse an empty file
            raise
        end(handle)


def write_definitions(origin: Origin, out: Path) -> Path:
    """Write ``boresight.tf``: names, frames and the clock."""
    clock = _IDENTITIES["estimate"].spacecraft
    lines = ["KPL/FK", "", "Names, frames and clock of kernels that boresight exported.", "", r"\begindata"]
    if origin.body == BODY_ID:
        lines += ["NAIF_BODY_NAME += 'BORESIGHT_BODY'", f"NAIF_BODY_CODE += {BODY_ID}"]
    if origin.axes == BODY_AXES:
        lines += [f"{name} = {value}" for name, value in _AXES.items()]
    for one in _IDENTITIES.values():
        key = f"FRAME_{one.frame}"
        lines += [
            f"NAIF_BODY_NAME += '{one.name}'", f"NAIF_BODY_CODE += {one.spacecraft}",
            f"FRAME_{one.name} = {one.frame}", f"{key}_NAME = '{one.name}'", f"{key}_CLASS = 3",
            f"{key}_CLASS_ID = {one.frame}", f"{key}_CENTER = {one.spacecraft}",
            f"CK_{one.frame}_SCLK = {clock}", f"CK_{one.frame}_SPK = {one.spacecraft}",
        ]  # fmt: skip
    number = -clock
    lines += [
        f"SCLK_DATA_TYPE_{number} = ( 1 )", f"SCLK01_TIME_SYSTEM_{number} = ( 1 )",
        f"SCLK01_N_FIELDS_{number} = ( 2 )", f"SCLK01_MODULI_{number} = ( {_SECONDS} {_TICKS_PER_S} )",
        f"SCLK01_OFFSETS_{number} = ( 0 0 )", f"SCLK01_OUTPUT_DELIM_{number} = ( 1 )",
        f"SCLK_PARTITION_START_{number} = ( 0 )", f"SCLK_PARTITION_END_{number} = ( {_SECONDS * _TICKS_PER_S - 1} )",
        f"SCLK01_COEFFICIENTS_{number} = ( 0 {origin.et + origin.clock_s!r} 1 )", r"\begintext", "",
    ]  # fmt: skip
    path = out / "boresight.tf"
    write_text(path, "\n".join(lines))
    return path
