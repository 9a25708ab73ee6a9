"""Where the camera and the body are at every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.draw import Stream, generator
from scenarios.dynamics.gravity import Gravity, PointMass, Polyhedron
from scenarios.dynamics.propagation import Acceleration, Pushes, propagate, radiation_pressure
from scenarios.errors import BoresightError
from scenarios.geometry import Camera, Pose, View
from scenarios.sequences.ground import Ground, MeshGround
from scenarios.sequences.orbit import orbit_axes, pointed, poses, times_s, velocities_m_s
from scenarios.sequences.rotation import Attitude, angular_velocity, attitude_law
from scenarios.spec.sequence import OrbitSpec, SequenceSpec

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """The true motion of a trial.

    Parameters
    ----------
    times_s
        (F,) epochs of the frames, the first at 0.
    positions_m, velocities_m_s
        (F, 3) of the camera, inertial axes about the body's centre of mass.
    R_body_inertial
        (F, 3, 3) attitude of the body.
    poses
        T_cam_body of each frame.
    sun_dir
        (3,) direction of the Sun, inertial axes.
    radiation_m_s2
        (3,) acceleration by sunlight, inertial axes.
    """

    times_s: FloatArray
    positions_m: FloatArray
    velocities_m_s: FloatArray
    R_body_inertial: FloatArray
    poses: tuple[Pose, ...]
    sun_dir: FloatArray
    radiation_m_s2: FloatArray

    def views(self, camera: Camera) -> tuple[View, ...]:
        """Return what the camera looks at in each frame."""
        suns = self.R_body_inertial @ self.sun_dir
        return tuple(View(camera, pose, sun) for pose, sun in zip(self.poses, suns, strict=True))


def travel(spec: SequenceSpec, ground: Ground, unmodelled_m_s2: FloatArray) -> Path:
    """Move the camera along its orbit over a body that turns.

    ``unmodelled_m_s2``, (F - 1, 3), acts on a propagated orbit alone.

    Raises
    ------
    OrbitLostError
        If a propagated orbit comes down to the body.
    """
    orbit, times = spec.orbit, times_s(spec.orbit)
    sun_dir = orbit_axes(orbit)[2]
    radiation = radiation_pressure(orbit.forces, sun_dir)
    attitude = attitude_law(spec.body_motion, angular_velocity(spec.body_motion), float(times[-1]))
    looks, velocities = poses(orbit), velocities_m_s(orbit)
    positions = np.array([look.camera_position_m for look in looks])
    if orbit.model == "propagated":
        pulled = _acceleration(_gravity(orbit, ground), attitude, radiation)
        start = np.concatenate([positions[0], velocities[0]])
        states = propagate(pulled, ground.reach_m, start, times, Pushes(times, unmodelled_m_s2))
        positions, velocities = states[:, :3], states[:, 3:]
        looks = tuple(pointed(*state) for state in zip(positions, velocities, strict=True))
    turns = attitude(times)
    over = tuple(_over_the_body(look, turn) for look, turn in zip(looks, turns, strict=True))
    return Path(times, positions, velocities, turns, over, sun_dir, radiation)


def undisturbed(spec: SequenceSpec, ground: Ground) -> Path:
    """Move the camera along its orbit without what no model knows."""
    return travel(spec, ground, np.zeros((spec.orbit.frames - 1, 3)))


def unmodelled(orbit: OrbitSpec, seed: int, trial: int) -> FloatArray:
    """Draw the acceleration that no model knows, (F - 1, 3) m/s2, constant between two frames."""
    rng = generator(seed, Stream.ACCELERATION, trial)
    return orbit.forces.noise_m_s2 * rng.normal(size=(orbit.frames - 1, 3))


def _gravity(orbit: OrbitSpec, ground: Ground) -> Gravity:
    if orbit.forces.gravity == "point-mass":
        return PointMass(orbit.gm_m3_s2)
    if not isinstance(ground, MeshGround):
        raise BoresightError("sequence.orbit.forces.gravity: polyhedral needs a body with a mesh: use point-mass")
    return Polyhedron(ground.mesh, orbit.gm_m3_s2)


def _acceleration(gravity: Gravity, attitude: Attitude, radiation_m_s2: FloatArray) -> Acceleration:
    """Equation (6) of Delpech et al. (2015) without its noise."""

    def acceleration(time_s: float, position_m: FloatArray) -> FloatArray:
        if isinstance(gravity, PointMass):
            return gravity.acceleration(position_m) + radiation_m_s2
        turn = attitude(np.array([time_s]))[0]
        return np.asarray(turn.T @ gravity.acceleration(turn @ position_m) + radiation_m_s2)

    return acceleration


def _over_the_body(T_cam_inertial: Pose, R_body_inertial: FloatArray) -> Pose:
    """Take the pose from inertial to body axes, which share their origin."""
    return Pose(T_cam_inertial.rotation @ R_body_inertial.T, T_cam_inertial.translation_m)
