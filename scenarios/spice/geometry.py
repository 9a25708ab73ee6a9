"""Poses, directions to the Sun and states of a spacecraft from kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import spiceypy

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose
from boresight.scenarios.spec.trajectory import MOST_STATES, SpiceTrajectorySpec, StatesSpec, rows_of
from boresight.scenarios.spice.kernels import find_kernels, loaded_kernels

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
