"""Onboard knowledge of a sequence, with its errors: predicted motion, attitude, forces and ranges."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.draw import Stream, draw_direction, generator
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.observation import Forces, TrackFrame, TrackRange, TrackSequence
from boresight.scenarios.sequences.trajectory import CameraTrajectory, angular_velocity, attitude_function
from boresight.scenarios.spec.sequence import SequenceKnowledgeSpec, SequenceSpec

_ALL_LATITUDES_RAD = (-0.5 * np.pi, 0.5 * np.pi)
# Lower bounds of the stated sigmas of exact data: infinite weights are numerically useless.
_LEAST_NOISE_PX = 1e-2
_LEAST_MOTION_ERROR = 1e-3
_LEAST_MOTION = 1e-6  # of the distance to the body


@dataclass(frozen=True, slots=True, eq=False)
class FrameTracks:
    """Tracks of a frame: numbers (n,), pixels (n, 2), and the points (n, 3), m, body axes, that ranges are measured to.

    These are the true landmarks; of real tracks, where their lines of sight meet the shape, NaN where they miss it.

    ``again`` are loop closures: pairs (track, older track) identified as the same landmark.
    """

    tracks: IndexArray
    uv_px: FloatArray
    points_m: FloatArray
    again: IndexArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))


def onboard_sequence(
    spec: SequenceSpec,
    camera: Camera,
    trajectory: CameraTrajectory,
    sightings: Sequence[FrameTracks],
    address: tuple[int, int],
) -> TrackSequence:
    """Simulate the onboard data of a trajectory and its sightings; ``address`` is (seed, trial).

    Camera positions are known in inertial axes and converted to body axes by the onboard rotation model.
    """
    knowledge, (seed, trial) = spec.knowledge, address
    attitudes = onboard_rotation(trajectory, spec, generator(seed, Stream.ROTATION, trial))
    moves = predicted_moves(trajectory, attitudes, knowledge, generator(seed, Stream.MOTION, trial))
    rng, star_tracker = generator(seed, Stream.KNOWLEDGE, trial), np.radians(knowledge.attitude_sigma_deg)
    position = attitudes[0] @ (trajectory.positions_m[0] + knowledge.position_sigma_m * rng.normal(size=3))
    ranges = [measured_ranges(sightings, trajectory.poses[0], camera, knowledge, rng)]
    later, every = generator(seed, Stream.RANGES, trial), knowledge.range_every
    ranges += [
        measured_ranges(sightings[i:], trajectory.poses[i], camera, knowledge, later)
        if every and i % every == 0
        else ()
        for i in range(1, len(sightings))
    ]
    misalignment = np.radians(knowledge.misalignment_sigma_deg)
    # Noise for each frame, and one misalignment for all.
    turns = star_tracker * rng.normal(size=(len(trajectory.poses), 3)) + misalignment * rng.normal(size=3)
    lasting = np.hypot(misalignment, rotation_sigma_rad(trajectory.times_s, spec))
    sigmas = np.hypot(star_tracker, lasting)
    frames = tuple(
        TrackFrame(
            time_s=float(trajectory.times_s[i]),
            R_cam_body=_known_attitude(trajectory.poses[i], trajectory.R_body_inertial[i], attitudes[i], turns[i]),
            tracks=sighting.tracks,
            uv_px=sighting.uv_px,
            sigma_px=max(spec.sigma_px, _LEAST_NOISE_PX),
            motion_m=moves[i][0],
            motion_covariance_m2=moves[i][1],
            ranges=ranges[i],
            again=sighting.again,
            R_body_inertial=attitudes[i],
            attitude_sigma_rad=float(sigmas[i]),
            attitude_bias_sigma_rad=float(lasting[i]),
            walk_px=knowledge.walk_px or 0.0,
            contraction=knowledge.contraction or 0.0,
            drift_px=knowledge.drift_px or 0.0,
        )
        for i, sighting in enumerate(sightings)
    )
    forces = onboard_forces(trajectory, spec, generator(seed, Stream.FORCES, trial))
    return TrackSequence(camera, frames, position, np.eye(3) * knowledge.position_sigma_m**2, forces)


def _known_attitude(pose: Pose, true: FloatArray, known: FloatArray, turn: FloatArray) -> FloatArray:
    """R_cam_body from the star tracker, with a rotation error, and from the onboard attitude of the body."""
    # R_cam_inertial R_inertial_body(known); with the true attitude R_cam_body is unchanged to the last bit.
    rotation = pose.rotation if np.array_equal(known, true) else pose.rotation @ true @ known.T
    return Rotation.from_rotvec(turn).as_matrix() @ rotation if turn.any() else rotation


def onboard_rotation(trajectory: CameraTrajectory, spec: SequenceSpec, rng: np.random.Generator) -> FloatArray:
    """R_body_inertial, (F, 3, 3), propagated from an angular velocity with errors.

    The first attitude is exact, as it defines the body axes. Errors of pole and rate grow from there by the rotational
    equations of motion.
    """
    motion, knowledge = spec.motion, spec.knowledge
    if not knowledge.pole_sigma_deg and not knowledge.spin_sigma:
        return trajectory.R_body_inertial
    rate = angular_velocity(motion)
    tilts = np.radians(knowledge.pole_sigma_deg) * rng.normal(size=2)
    longer = 1.0 + knowledge.spin_sigma * rng.normal()
    # The tilt is about two axes across the angular velocity.
    believed = longer * Rotation.from_rotvec(_perpendicular(rate).T @ tilts).apply(rate)
    return attitude_function(motion, believed, float(trajectory.times_s[-1]))(trajectory.times_s)


def rotation_sigma_rad(times_s: FloatArray, spec: SequenceSpec) -> FloatArray:
    """(F,) standard deviation of the attitude error of a spinning body about each axis, RMS over the axes.

    The error about the pole is the relative rate error times the angle; a tilt of the pole gives a rotation of
    2 tilt |sin(angle / 2)| about a perpendicular axis. For tumbling this is the order of magnitude only.
    """
    motion, knowledge = spec.motion, spec.knowledge
    angle = np.linalg.norm(angular_velocity(motion)) * times_s
    about = knowledge.spin_sigma * angle
    across = 2.0 * np.radians(knowledge.pole_sigma_deg) * np.sin(0.5 * angle)
    # Two tilts, each about an axis across the pole: the mean square of three axes.
    return np.asarray(np.sqrt((about**2 + 2.0 * across**2) / 3.0), dtype=np.float64)


def _perpendicular(axis: FloatArray) -> FloatArray:
    """(2, 3) unit vectors perpendicular to an axis and to each other."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    return np.stack([first, second / np.linalg.norm(second)])


def predicted_moves(
    trajectory: CameraTrajectory, known: FloatArray, knowledge: SequenceKnowledgeSpec, rng: np.random.Generator
) -> list[tuple[FloatArray, FloatArray]]:
    """Predict the displacement before each frame, (3,) in body axes, and the covariance of its error, (3, 3).

    The error has a random direction and the length lambda |displacement| in inertial space: lambda^2 |d|^2 / 3 on each
    axis; a displacement below 1e-6 of the distance to the body, of a camera that hovers, counts as so much, as nobody
    knows that it rests. The rotation of the body by its onboard attitude ``known``, (F, 3, 3), is added at the camera's
    true position; a navigator would use the estimated one, a difference of the rotation per step times the position
    error.
    """
    moves = [(np.zeros(3), np.zeros((3, 3)))]
    frames = zip(trajectory.positions_m, known, strict=True)
    for (before, old), (after, new) in itertools.pairwise(frames):
        true = after - before
        distance = max(float(np.linalg.norm(true)), _LEAST_MOTION * float(np.linalg.norm(before)))
        moved = true + knowledge.motion_error * distance * draw_direction(_ALL_LATITUDES_RAD, rng)
        sigma_m = max(knowledge.motion_error, _LEAST_MOTION_ERROR) * distance / np.sqrt(3.0)
        # R_new c_new - R_old c_old = R_new (c_new - c_old) + (R_new - R_old) c_old in body axes.
        moves.append((new @ moved + (new - old) @ before, np.eye(3) * sigma_m**2))
    return moves


def measured_ranges(
    sightings: Sequence[FrameTracks],
    pose: Pose,
    camera: Camera,
    knowledge: SequenceKnowledgeSpec,
    rng: np.random.Generator,
) -> tuple[TrackRange, ...]:
    """Simulate ranges to some landmarks of the first of the sightings.

    The later sightings are used only to select landmarks with ``range_to: lasting``, which is not possible on board.
    """
    here = sightings[0]
    off_axis = np.linalg.norm(here.uv_px - [camera.cx_px, camera.cy_px], axis=1)
    lasting = knowledge.range_to == "lasting"
    last = np.sum([np.isin(here.tracks, s.tracks) for s in sightings], axis=0) if lasting else np.zeros(len(off_axis))
    # The last key counts first: most frames to come, then nearest the principal point.
    rows = np.lexsort((off_axis, -last))
    rows = rows[np.isfinite(here.points_m[rows]).all(axis=1)][: knowledge.ranges]
    true = np.linalg.norm(here.points_m[rows] - pose.camera_position_m, axis=1)
    errors = knowledge.range_sigma_m * rng.normal(size=len(rows))
    return tuple(
        TrackRange(int(track), float(distance), knowledge.range_sigma_m)
        for track, distance in zip(here.tracks[rows], true + errors, strict=True)
    )


def onboard_forces(trajectory: CameraTrajectory, spec: SequenceSpec, rng: np.random.Generator) -> Forces | None:
    """Return the onboard force model with its errors; None if there is none."""
    knowledge, orbit = spec.knowledge, spec.orbit
    if not knowledge.dynamics:
        return None
    gm = spec.gm_m3_s2 * (1.0 + knowledge.gm_sigma * rng.normal())
    radiation = trajectory.radiation_m_s2 * (1.0 + knowledge.radiation_sigma * rng.normal())
    velocity = trajectory.velocities_m_s[0] + knowledge.velocity_sigma_m_s * rng.normal(size=3)
    return Forces(
        gm_m3_s2=float(gm),
        gm_sigma_m3_s2=float(knowledge.gm_sigma * spec.gm_m3_s2),
        radiation_m_s2=radiation,
        radiation_sigma_m_s2=float(knowledge.radiation_sigma * np.linalg.norm(trajectory.radiation_m_s2)),
        noise_m_s2=orbit.forces.noise_m_s2 if knowledge.noise_m_s2 is None else knowledge.noise_m_s2,
        velocity_m_s=velocity,
        velocity_covariance_m2_s2=np.eye(3) * knowledge.velocity_sigma_m_s**2,
    )
