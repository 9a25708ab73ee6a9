"""SPICE kernels of missions: loading and checks, and the cameras, poses, Sun directions and states that they hold."""

from __future__ import annotations

import math
import re
import struct
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import spiceypy
from numpy.typing import NDArray
from spiceypy.utils.exceptions import NotFoundError, SpiceyError

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.data import find_data_file
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, OpenCVDistortion, Pose, RadialDistortion
from boresight.scenarios.geometry.lens import Lens
from boresight.scenarios.reading import LARGEST_NUMBER
from boresight.scenarios.spec.trajectory import MOST_STATES, SpiceTrajectorySpec, StatesSpec, rows_of

SPICE_ERRORS = (SpiceyError, NotFoundError)
# CSPICE has one kernel pool in a process and is not thread-safe.
_POOL = threading.Lock()

# Layout of binary kernels (NAIF's DAF Required Reading): records of 128 doubles. The file record holds the counts of
# doubles and integers in a summary, ND and NI, the first summary record, and the byte order.
_RECORD, _WORD = 1024, 8
_COUNTS = {b"DAF/SPK ": (2, 6), b"DAF/CK  ": (2, 6), b"DAF/PCK ": (2, 5)}
_ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}


def check_binary(path: Path) -> None:
    """Check that counts and pointers of a binary kernel stay within the file and do not loop; ignore text kernels.

    Raise OSError or ValueError if they do not, or the kernel is of a type that is not supported.
    """
    records, words = path.stat().st_size // _RECORD, path.stat().st_size // _WORD
    with path.open("rb") as file:
        head = file.read(_RECORD)
        if head[:4] not in (b"DAF/", b"DAS/", b"NAIF"):
            return
        counts, order = _COUNTS.get(head[:8]), _ORDERS.get(head[88:96])
        if counts is None or order is None or len(head) < _RECORD:
            raise ValueError("it is binary, but no SPK, CK or PCK of numbers in an order of today")
        if struct.unpack_from(f"{order}2i", head, 8) != counts:
            raise ValueError(f"its summaries are not of {counts[0]} doubles and {counts[1]} integers")
        for summaries in _summary_records(file, struct.unpack_from(f"{order}i", head, 76)[0], records, order):
            for begin, end in _arrays(summaries, order, counts):
                if not 1 <= begin <= end <= words:
                    raise ValueError(f"an array from {begin} to {end} does not lie in its {words} numbers")


def _summary_records(file: BinaryIO, record: int, records: int, order: str) -> Iterator[bytes]:
    """Yield the linked summary records up to the last."""
    seen: set[float] = set()
    number: float = record
    while number != 0.0:
        if number in seen or not 2 <= number <= records or number != int(number):
            raise ValueError(f"its list of arrays leads to record {number:g}, out of the file or round in it")
        seen.add(number)
        file.seek(_RECORD * (int(number) - 1))
        content = file.read(_RECORD)
        yield content
        # The first word of a summary record is the number of the next one, 0 in the last.
        (number,) = struct.unpack_from(f"{order}d", content)


def _arrays(summaries: bytes, order: str, counts: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield first and last word of each array in a summary record: the last two integers of its summary."""
    doubles, integers = counts
    # Two integers are packed in a double.
    size = doubles + (integers + 1) // 2
    # Control words: next record, previous record, number of summaries.
    _, _, number = struct.unpack_from(f"{order}3d", summaries)
    if not (0 <= number <= (_RECORD // _WORD - 3) // size and number == int(number)):
        raise ValueError(f"a record of its list of arrays cannot have {number:g} of them")
    for index in range(int(number)):
        place = _WORD * (3 + index * size + doubles) + 4 * (integers - 2)
        yield struct.unpack_from(f"{order}2i", summaries, place)


def find_kernels(names: Sequence[str], folders: Sequence[Path], key: str) -> list[Path]:
    """Find kernels in ``folders``, then in the data folder; ``key`` names them in messages, see `find_data_file`."""
    return [find_data_file(name, folders, "spice", key) for name in names]


@contextmanager
def loaded_kernels(paths: Sequence[Path]) -> Iterator[None]:
    """Load kernels in the given order, later ones overriding earlier ones, and unload them on exit.

    Meanwhile the kernel pool is locked for other threads; other processes have pools of their own. Errors of SPICE
    inside the context become a `BoresightError` of one line. Raise BoresightError if a kernel is missing or invalid, or
    SPICE signals an error inside the context.
    """
    with _POOL:
        done: list[Path] = []
        try:
            for path in paths:
                _load(path)
                done.append(path)
            yield
        except SPICE_ERRORS as error:
            raise BoresightError(f"SPICE: {spice_message(error)}") from error
        finally:
            for path in reversed(done):
                spiceypy.unload(str(path))


def _load(path: Path) -> None:
    if not path.is_file():
        raise BoresightError(f"{path}: no such kernel")
    if path.suffix.lower() == ".tm":
        raise BoresightError(
            f"{path}: name the kernels themselves instead of this meta-kernel, whose paths start where a program runs"
        )
    try:
        check_binary(path)
    except (OSError, ValueError) as error:
        raise BoresightError(f"{path}: not a kernel that SPICE reads: {error}") from error
    try:
        spiceypy.furnsh(str(path))
    except SpiceyError as error:
        raise BoresightError(f"{path}: not a kernel that SPICE reads: {spice_message(error)}") from error


def spice_message(error: Exception) -> str:
    """Return the message of a SPICE error as one line."""
    parts = (getattr(error, "short", ""), getattr(error, "long", ""))
    said = " ".join(" ".join(str(part).split()) for part in parts if part)
    return said or " ".join(str(error).split())


@dataclass(frozen=True, slots=True)
class Constants:
    """Constants of an instrument in the kernel pool, by its NAIF identifier."""

    kernel_id: int

    def has(self, name: str) -> bool:
        """Return whether a loaded kernel has ``INS<id>_<name>``."""
        return bool(spiceypy.expool(f"INS{self.kernel_id}_{name}"))

    def numbers(self, name: str, *counts: int) -> NDArray[np.float64]:
        """Return the numbers under ``INS<id>_<name>``, as many as one of ``counts``.

        Raise BoresightError if no loaded kernel has them, there are more or fewer, or one of them is too large.
        """
        key = f"INS{self.kernel_id}_{name}"
        try:
            values = np.array(spiceypy.gdpool(key, 0, 100), dtype=np.float64)
        except SPICE_ERRORS as error:
            raise BoresightError(f"{key}: not in the kernels: name the instrument kernel and its addendum") from error
        if len(values) not in counts or not (np.abs(values) <= LARGEST_NUMBER).all():
            said = " or ".join("one number" if count == 1 else f"{count} numbers" for count in counts)
            raise BoresightError(f"{key}: {values.tolist()} is not {said} of any use: check the instrument kernel")
        return values

    def number(self, name: str) -> float:
        """Return the one number under ``INS<id>_<name>``."""
        return float(self.numbers(name, 1)[0])

    def above_zero(self, name: str) -> float:
        """Return the one number under ``INS<id>_<name>``, which must be above 0; raise BoresightError if it is not."""
        return self.each_above_zero(name, 1)[0]

    def each_above_zero(self, name: str, *counts: int) -> list[float]:
        """Return the numbers under ``INS<id>_<name>``, see `numbers`; raise BoresightError if one is not above 0."""
        values: list[float] = self.numbers(name, *counts).tolist()
        for value in values:
            if not value > 0.0:
                at = f"INS{self.kernel_id}_{name}"
                raise BoresightError(f"{at}: {value:g} is not above 0: check the instrument kernel")
        return values


_AGREES = 0.05  # relative difference of two focal lengths that are the same but for their units
_STRAIGHT = 1e-6
_FOCAL_M, _PIXEL_M = (1e-3, 1.0), (1e-6, 1e-3, 1.0)


def read_camera(kernels: Sequence[str], instrument: str, size_px: tuple[int, int], folders: Sequence[Path]) -> Camera:
    """Read the camera of an instrument from its kernel and addenda.

    ``FOV_*`` give the field of view, ``PIXEL_SAMPLES`` and ``PIXEL_LINES`` the size, or else ``size_px``. With
    ``FOCAL_LENGTH`` and ``PIXEL_SIZE`` or ``PIXEL_PITCH`` the focal length is their ratio, in the units (m, mm, um) in
    which it agrees with the field of view; two sizes of a pixel are those across and down. ``OD_K`` is the distortion
    of ISIS: ideal = seen (1 - k0 - k1 r^2 - k2 r^4), r in mm. ``RAD_DIST_COEFF`` is that of Dawn's Framing Cameras,
    which goes the other way: seen = ideal (1 + e r^2). The principal point is the boresight, which must be the z axis
    of the camera's frame, x along the samples. Raise BoresightError if a kernel is missing, or does not have these.
    """
    with loaded_kernels(find_kernels(kernels, folders, "kernels")):
        try:
            number = int(instrument) if re.fullmatch("-?[0-9]{1,9}", instrument) else spiceypy.bodn2c(instrument)
        except SPICE_ERRORS:
            raise BoresightError(f"the kernels do not have an instrument {instrument}: give its number") from None
        constants = Constants(number)
        shape, _, boresight, _, bounds = spiceypy.getfov(number, 100)
        read = [_above_zero(constants, name) for name in ("PIXEL_SAMPLES", "PIXEL_LINES")]
        width_px, height_px = (int(own or given) for own, given in zip(read, size_px, strict=True))
        focal = _above_zero(constants, "FOCAL_LENGTH")
        pixel, pixel_down = _pixel(constants)
        k0, k1, k2 = constants.numbers("OD_K", 3).tolist() if constants.has("OD_K") else (0.0, 0.0, 0.0)
        outwards = constants.number("RAD_DIST_COEFF") if constants.has("RAD_DIST_COEFF") else 0.0
    axis = np.array(boresight) / np.linalg.norm(boresight)
    if np.linalg.norm(axis[:2]) > _STRAIGHT or axis[2] < 0.0:
        raise BoresightError(f"the boresight of {instrument} is {axis.round(6).tolist()}, not the z axis of its frame")
    if shape not in {"RECTANGLE", "POLYGON"} or len(bounds) != 4:
        raise BoresightError(f"the field of view of {instrument} is a {shape.lower()}, not a rectangle")
    slopes = np.array(bounds)[:, :2] / np.array(bounds)[:, 2:]
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    across, down = np.array([width_px, height_px]) / (high - low)
    # The boresight divides the field of view; the field begins at the left and upper edge of the image.
    centre = (float(-low[0] * across), float(-low[1] * down))
    if focal is None or pixel is None:
        return Camera(width_px, height_px, float(across), float(down), *centre)
    # Focal length over pixel in each pair of units, by the unit of the focal length.
    ratios = [(focal * f / (pixel * p), f) for f, p in product(_FOCAL_M, _PIXEL_M)]
    focal_px, unit_m = min(ratios, key=lambda ratio: abs(np.log(ratio[0] / across)))
    if abs(np.log(focal_px / across)) > _AGREES:
        raise BoresightError(
            f"FOCAL_LENGTH and PIXEL_SIZE of {instrument} do not agree with its field of view of {across:.6g} px in any"
            " unit: give camera.focal_px instead"
        )
    if k0 != 0.0:
        raise BoresightError(f"INS{number}_OD_K: k0 = {k0:g} would change the focal length; only 0 is supported")
    focal_mm = 1e3 * unit_m * focal
    lens: Lens | None = RadialDistortion(-k1 * focal_mm**2, -k2 * focal_mm**4) if k1 or k2 else None
    if outwards:
        if lens is not None:
            raise BoresightError(f"INS{number}: OD_K and RAD_DIST_COEFF are two distortions; leave one kernel out")
        lens = OpenCVDistortion(outwards * focal_mm**2, 0.0, 0.0, 0.0)
    ratio = float(down / across) if pixel_down is None else pixel / pixel_down
    return Camera(width_px, height_px, focal_px, focal_px * ratio, *centre, lens)


def _pixel(constants: Constants) -> tuple[float | None, float | None]:
    """Return the size of a pixel across, None if no kernel has it, and that down if the kernel has both."""
    for name in ("PIXEL_SIZE", "PIXEL_PITCH"):
        if constants.has(name):
            across, *down = constants.each_above_zero(name, 1, 2)
            return across, down[0] if down else None
    return None, None


def _above_zero(constants: Constants, name: str) -> float | None:
    """Return a number of an instrument above 0; None if no kernel has it."""
    return constants.above_zero(name) if constants.has(name) else None


Aberration = Literal["LT+S", "NONE"]
M_PER_KM = 1e3


@dataclass(frozen=True, slots=True)
class SpiceNames:
    """NAIF names of the spacecraft, the camera's frame, the body and the body's frame."""

    spacecraft: str
    camera_frame: str
    target: str
    target_frame: str


@dataclass(frozen=True, slots=True, eq=False)
class ApparentGeometry:
    """Apparent pose of a body, in the axes of the camera's frame, and unit vector (3,) towards the Sun, at an epoch."""

    T_cam_body: Pose
    sun_dir_body: FloatArray


def apparent_geometry(names: SpiceNames, et: float, aberration: Aberration = "LT+S") -> ApparentGeometry:
    """Compute the pose and the direction to the Sun of an exposure from the loaded kernels.

    Its middle is at ``et``, s past J2000 TDB. With ``LT+S`` the pose is apparent: position and attitude of the body
    when the light left it (light time), in the direction changed by the spacecraft's motion (stellar aberration). The
    two nearly cancel where spacecraft and body move together; either alone is an error of v / c, 20 arcsec at 30 km/s.
    The range is the light path, which differs from the geometric range by up to the same factor of 1e-4. ``NONE`` gives
    the geometric state, which ISIS uses for AMICA.

    The direction to the Sun is apparent (LT+S) from the body when the light left it.
    """
    # Position of the body from the spacecraft: received light, so that its epoch is et minus the light time.
    position_km, light_s = spiceypy.spkpos(names.target, et, "J2000", aberration, names.spacecraft)
    left_et = et - (0.0 if aberration == "NONE" else light_s)
    # pxform gives the matrix from its first frame to its second.
    R_cam_j2000 = np.array(spiceypy.pxform("J2000", names.camera_frame, et))
    R_body_j2000 = np.array(spiceypy.pxform("J2000", names.target_frame, left_et))
    # The Sun as seen from the body when the light left it.
    sun_km, _ = spiceypy.spkpos("SUN", left_et, "J2000", "LT+S", names.target)
    sun_body = R_body_j2000 @ np.array(sun_km)
    # The translation of T_cam_body is the body's origin in camera axes.
    pose = Pose(R_cam_j2000 @ R_body_j2000.T, M_PER_KM * (R_cam_j2000 @ np.array(position_km)))
    return ApparentGeometry(pose, sun_body / np.linalg.norm(sun_body))


def spice_states(spec: SpiceTrajectorySpec, folders: Sequence[Path], *, spin: bool) -> StatesSpec:
    """Compute apparent states (see `apparent_geometry`) at the epochs of a trajectory, and the first ``spin``.

    Velocities are geometric: they serve to name the directions along and across an orbit. Raise BoresightError if a
    kernel is missing or damaged, or the kernels do not have a name, a frame or an epoch.
    """
    names = SpiceNames(spec.observer, spec.camera_frame or "J2000", spec.target, spec.target_frame)
    with loaded_kernels(find_kernels(spec.kernels, folders, "spice.kernels")):
        start_et, stop_et = (float(spiceypy.str2et(utc)) for utc in (spec.start_utc, spec.stop_utc))
        if stop_et < start_et:
            raise BoresightError(f"spice: stop_utc {spec.stop_utc} is before start_utc {spec.start_utc}")
        count = math.floor((stop_et - start_et) / spec.step_s + 1e-9) + 1
        if not 1 <= count <= MOST_STATES:
            raise BoresightError(f"spice: {count} epochs from start_utc to stop_utc are not within [1, {MOST_STATES}]")
        epochs = start_et + spec.step_s * np.arange(count)
        found, velocities = [], []
        for et in epochs.tolist():
            found.append(apparent_geometry(names, et, spec.aberration))
            state_km, _ = spiceypy.spkezr(spec.observer, et, "J2000", "NONE", spec.target)
            to_body = np.array(spiceypy.pxform("J2000", spec.target_frame, et))
            velocities.append(M_PER_KM * to_body @ np.array(state_km)[3:])
        spin_rad_s = None
        if spin:
            # The angular velocity of the body-fixed frame is given in inertial axes.
            to_body, rate_rad_s = spiceypy.xf2rav(spiceypy.sxform("J2000", spec.target_frame, epochs[0]))
            spin_rad_s = tuple((to_body @ rate_rad_s).tolist())
    return StatesSpec(
        time_s=tuple(epochs.tolist()),
        position_m=rows_of(np.array([one.T_cam_body.camera_position_m for one in found])),
        velocity_m_s=rows_of(np.array(velocities)),
        attitude=rows_of(np.array([one.T_cam_body.quat_wxyz for one in found])) if spec.camera_frame else None,
        sun_dir=rows_of(np.array([one.sun_dir_body for one in found])),
        spin_rad_s=spin_rad_s,
    )
