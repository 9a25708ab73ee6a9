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
    rate_rad_s = np.sqrt(orbit.gm_m3_s2 / orbit.radius_m**3)
    return np.asarray(np.radians(anomalies_deg(orbit)) / rate_rad_s, dtype=np.float64)


def orbit_axes(orbit: OrbitSpec) -> FloatArray:
    """(3, 3) rows, body axes: the direction of zero anomaly, the one 90 deg on, and the orbit's normal.

    Zero anomaly is where the orbit comes nearest the body's x axis; for a normal along that axis, the y axis.
    """
    normal = np.asarray(orbit.normal_body, dtype=np.float64)
    normal = normal / np.linalg.norm(normal)
    along = np.eye(3)[0] if abs(normal[0]) < 0.999999 else np.eye(3)[1]
    first = along - (along @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def poses(orbit: OrbitSpec) -> tuple[Pose, ...]:
    """T_cam_body of each frame: x along the velocity, y against the orbit's normal, z (boresight) to the origin."""
    first, second, normal = orbit_axes(orbit)
    found = []
    for angle in np.radians(orbit.start_deg + anomalies_deg(orbit)):
        radial = np.cos(angle) * first + np.sin(angle) * second
        velocity = np.cross(normal, radial)
        rotation = np.stack([velocity, -normal, -radial])
        found.append(Pose(rotation, -rotation @ (orbit.radius_m * radial)))
    return tuple(found)
