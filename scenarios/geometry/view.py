"""A view of a body (camera, pose and Sun), and the intersections of its lines of sight with the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry.camera import Camera
from boresight.scenarios.geometry.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceHits:
    """First intersections of N lines of sight with a body, body frame.

    Points (N, 3) and the outward unit normals (N, 3) used for shading are NaN for misses, ``facets`` (N,) -1, and
    ``lit`` (N,), whether the point is sunlit, False.
    """

    points_body_m: NDArray[np.float64]
    normals_body: NDArray[np.float64]
    facets: NDArray[np.int64]
    lit: NDArray[np.bool_]

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(N,) whether the line of sight hits the body."""
        return self.facets >= 0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Camera with any distortion, pose, and unit vector (3,) towards the Sun in the body frame, normalised here."""

    camera: Camera
    T_cam_body: Pose
    sun_dir_body: NDArray[np.float64]

    def __post_init__(self) -> None:
        sun = np.array(self.sun_dir_body, dtype=np.float64)
        norm = float(np.linalg.norm(sun))
        if sun.shape != (3,) or not np.isfinite(norm) or norm == 0.0:
            raise BoresightError(f"the direction to the Sun must be a finite vector of 3 numbers, not {sun}")
        sun /= norm
        sun.setflags(write=False)
        object.__setattr__(self, "sun_dir_body", sun)

    @property
    def phase_angle_rad(self) -> float:
        """The angle at the body's origin between the Sun and the camera."""
        camera = self.T_cam_body.camera_position_m
        cosine = float(camera @ self.sun_dir_body / np.linalg.norm(camera))
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def may_show(self, radius_m: float) -> bool:
        """Return whether a sphere about the body's origin reaches into the cone about the field of view."""
        width, height = self.camera.width_px, self.camera.height_px
        corners = self.camera.unproject(np.array([[0.0, 0.0], [0.0, height], [width, 0.0], [width, height]]))
        axis = corners.sum(axis=0) / np.linalg.norm(corners.sum(axis=0))
        centre = self.T_cam_body.translation_m
        range_m = float(np.linalg.norm(centre))
        sphere_rad = np.arcsin(radius_m / range_m) if range_m > radius_m else np.pi
        off_rad = np.arccos(np.clip(axis @ centre / range_m, -1.0, 1.0))
        return bool(off_rad <= np.arccos((corners @ axis).min()) + sphere_rad)
