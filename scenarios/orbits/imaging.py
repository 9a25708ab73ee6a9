"""True views of planned images: true orbit, pointing errors, misalignment and focal length error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.orbits.true_orbit import DAY_S, TrueOrbit
from boresight.scenarios.orbits.world import OrbitWorld
from boresight.scenarios.spec.orbit import ImagingSpec


@dataclass(frozen=True, slots=True, eq=False)
class PointingErrors:
    """Errors of I images of a trial: rotations (I, 3, 3) from reported to true camera axes, and the true camera."""

    R_true_reported: FloatArray
    camera: Camera

    @classmethod
    def draw(cls, world: OrbitWorld, images: int, rng: np.random.Generator) -> PointingErrors:
        """Draw one misalignment and one focal length, and an attitude error for each image."""
        spec, known = world.spec.pointing, world.camera
        mounting = 1e-6 * spec.misalignment_urad * rng.normal(size=3)
        shake = 1e-6 * spec.attitude_urad * rng.normal(size=(images, 3))
        focal = 1.0 + spec.focal_error * rng.normal()
        # Left of the reported attitude: about camera axes, the constant mounting first.
        turns = Rotation.from_rotvec(shake).as_matrix() @ Rotation.from_rotvec(mounting).as_matrix()
        camera = Camera(
            known.width_px, known.height_px, known.fx_px * focal, known.fy_px * focal, known.cx_px, known.cy_px
        )
        return cls(turns, camera)


def imaging_of(world: OrbitWorld) -> ImagingSpec:
    """Return the ``imaging`` section; raise `BoresightError` if it is missing."""
    if world.spec.imaging is None:
        raise BoresightError("orbit.imaging: missing, so there are no images to take")
    return world.spec.imaging


def epochs_s(world: OrbitWorld) -> FloatArray:
    """(I,) possible image times: centres of equal intervals of the arc."""
    count = imaging_of(world).epochs
    return (np.arange(count) + 0.5) / count * world.spec.arc.days * DAY_S


def sun_dir_inertial(world: OrbitWorld) -> FloatArray:
    """(3,) unit vector towards the Sun."""
    sun = np.array(world.spec.light.sun_dir)
    return np.asarray(sun / np.linalg.norm(sun))


def control_errors(world: OrbitWorld, images: int, seed: int, trial: int) -> FloatArray:
    """(I, 3) rotation vectors, rad, camera axes, from the planned to the reported pointing."""
    rng = generator(seed, Stream.ORBIT_CONTROL, trial)
    return 1e-6 * imaging_of(world).control_urad * rng.normal(size=(images, 3))


def true_views(
    world: OrbitWorld, flown: TrueOrbit, R_cam_inertial: FloatArray, seed: int, trial: int
) -> tuple[View, ...]:
    """Return the true views of images with reported attitudes (I, 3, 3), in the axes of the shape model."""
    errors = PointingErrors.draw(world, len(flown.times_s), generator(seed, Stream.ORBIT_POINTING, trial))
    sun, turns = sun_dir_inertial(world), world.rotation.at(flown.times_s)
    attitudes = errors.R_true_reported @ R_cam_inertial
    views = []
    for state, turn, attitude in zip(flown.image_states, turns, attitudes, strict=True):
        rotation = attitude @ turn.T
        # The shape model's origin is not the centre of mass.
        position = turn @ state[:3] + world.asteroid.centre_m
        views.append(View(errors.camera, Pose(rotation, -rotation @ position), turn @ sun))
    return tuple(views)
