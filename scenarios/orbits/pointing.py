"""How the camera that takes the images differs from what is known of it: attitude, mounting, focal length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenarios.geometry import Camera
from scenarios.orbits.world import OrbitWorld

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PointingErrors:
    """Errors of a trial's images.

    Parameters
    ----------
    R_true_reported
        (I, 3, 3) from the camera's axes as they are reported to those that it has.
    camera
        The true one.
    """

    R_true_reported: FloatArray
    camera: Camera

    @classmethod
    def draw(cls, world: OrbitWorld, images: int, rng: np.random.Generator) -> PointingErrors:
        """Draw the mounting's error and the focal length once, the attitude's error for each image."""
        spec, known = world.spec.pointing, world.camera
        mounting = 1e-6 * spec.misalignment_urad * rng.normal(size=3)
        shake = 1e-6 * spec.attitude_urad * rng.normal(size=(images, 3))
        focal = 1.0 + spec.focal_error * rng.normal()
        turns = Rotation.from_rotvec(shake).as_matrix() @ Rotation.from_rotvec(mounting).as_matrix()
        camera = Camera(
            known.width_px, known.height_px, known.fx_px * focal, known.fy_px * focal, known.cx_px, known.cy_px
        )
        return cls(turns, camera)
