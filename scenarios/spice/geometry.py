"""Poses and directions to the Sun from the loaded kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import spiceypy

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import Pose

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
