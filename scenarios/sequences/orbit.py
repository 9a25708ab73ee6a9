"""Where the camera is along a circular orbit, and how it looks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Pose
from scenarios.spec.sequence import OrbitSpec

FloatArray = NDArray[np.float64]


def anomalies_deg(orbit: OrbitSpec) -> FloatArray:
    """(F,) anomaly that each frame has gone through since the first."""
    return orbit.step_deg * np.arange(orbit.frames, dtype=np.float64)


def times_s(orbit: OrbitSpec) -> FloatArray:
    """(F,) epochs of the frames, by Kepler's third law."""
    return np.asarray(np.radians(anomalies_deg(orbit)) / _rate_rad_s(orbit), dtype=np.float64)


def orbit_axes(orbit: OrbitSpec) -> FloatArray:
    """(3, 3) rows, inertial axes: the direction of zero anomaly, the one 90 deg on, and the orbit's normal.

    Zero anomaly is where the orbit comes nearest the x axis; for a normal along that axis, the y axis.
    """
    normal = np.asarray(orbit.normal_body, dtype=np.float64)
    normal = normal / np.linalg.norm(normal)
    along = np.eye(3)[0] if abs(normal[0]) < 0.999999 else np.eye(3)[1]
    first = along - (along @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def poses(orbit: OrbitSpec) -> tuple[Pose, ...]:
    """T_cam_inertial of each frame of a circular orbit, the camera as in ``pointed``."""
    first, second, normal = orbit_axes(orbit)
    found = []
    for angle in np.radians(orbit.start_deg + anomalies_deg(orbit)):
        radial = np.cos(angle) * first + np.sin(angle) * second
        found.append(_look_down(orbit.radius_m * radial, radial, normal))
    return tuple(found)


def velocities_m_s(orbit: OrbitSpec) -> FloatArray:
    """(F, 3) velocities on a circular orbit, inertial axes."""
    first, second, _ = orbit_axes(orbit)
    angles = np.radians(orbit.start_deg + anomalies_deg(orbit))[:, None]
    return np.asarray(_rate_rad_s(orbit) * orbit.radius_m * (np.cos(angles) * second - np.sin(angles) * first))


def pointed(position_m: FloatArray, velocity_m_s: FloatArray) -> Pose:
    """T_cam_inertial: x along the horizontal velocity, y against the orbit's normal, z (boresight) to the origin."""
    normal = np.cross(position_m, velocity_m_s)
    return _look_down(position_m, position_m / np.linalg.norm(position_m), normal / np.linalg.norm(normal))


def _look_down(position_m: FloatArray, radial: FloatArray, normal: FloatArray) -> Pose:
    rotation = np.stack([np.cross(normal, radial), -normal, -radial])
    return Pose(rotation, -rotation @ position_m, from_frame="inertial")


def _rate_rad_s(orbit: OrbitSpec) -> float:
    return float(np.sqrt(orbit.gm_m3_s2 / orbit.radius_m**3))
