"""True motion of camera and body in a sequence: circular or propagated orbit or given states, spin or tumbling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.dynamics.gravity import PointMass, Polyhedron
from boresight.scenarios.dynamics.propagation import Acceleration, PiecewiseAcceleration, propagate, radiation_pressure
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, look_at, orbit_axes
from boresight.scenarios.sequences.ground import LandmarkGround, MeshGround
from boresight.scenarios.spec.sequence import BodyMotionSpec, SequenceOrbitSpec, SequenceSpec
from boresight.scenarios.spec.trajectory import SequenceTrajectorySpec

AttitudeFunction = Callable[[FloatArray], FloatArray]
"""Takes (n,) seconds since the first frame to R_body_inertial, (n, 3, 3)."""

_HOUR_S = 3600.0
_TOLERANCE = 1e-12


def anomalies_deg(orbit: SequenceOrbitSpec) -> FloatArray:
    """(F,) anomaly of each frame since the first."""
    return orbit.step_deg * np.arange(orbit.frames, dtype=np.float64)


def frame_times_s(orbit: SequenceOrbitSpec) -> FloatArray:
    """(F,) epochs of the frames, by Kepler's third law."""
    return np.asarray(np.radians(anomalies_deg(orbit)) / _rate_rad_s(orbit), dtype=np.float64)


def circular_poses(orbit: SequenceOrbitSpec) -> tuple[Pose, ...]:
    """T_cam_inertial of each frame of a circular orbit, the camera as in `nadir_pose`."""
    first, second, normal = orbit_axes(np.array(orbit.normal_body))
    found = []
    for angle in np.radians(orbit.start_deg + anomalies_deg(orbit)):
        radial = np.cos(angle) * first + np.sin(angle) * second
        found.append(_look_down(orbit.radius_m * radial, radial, normal))
    return tuple(found)


def circular_velocities_m_s(orbit: SequenceOrbitSpec) -> FloatArray:
    """(F, 3) velocities on a circular orbit, inertial axes."""
    first, second, _ = orbit_axes(np.array(orbit.normal_body))
    angles = np.radians(orbit.start_deg + anomalies_deg(orbit))[:, None]
    return np.asarray(_rate_rad_s(orbit) * orbit.radius_m * (np.cos(angles) * second - np.sin(angles) * first))


def nadir_pose(position_m: FloatArray, velocity_m_s: FloatArray) -> Pose:
    """T_cam_inertial: x along the horizontal velocity, y against the orbit's normal, z (boresight) to the origin."""
    normal = np.cross(position_m, velocity_m_s)
    return _look_down(position_m, position_m / np.linalg.norm(position_m), normal / np.linalg.norm(normal))


def _look_down(position_m: FloatArray, radial: FloatArray, normal: FloatArray) -> Pose:
    # Rows: forward motion on a circle, against the normal, down. x cross y = z.
    rotation = np.stack([np.cross(normal, radial), -normal, -radial])
    return Pose(rotation, -rotation @ position_m, from_frame="inertial")


def _rate_rad_s(orbit: SequenceOrbitSpec) -> float:
    # Kepler's third law: n^2 r^3 = GM.
    return float(np.sqrt(orbit.gm_m3_s2 / orbit.radius_m**3))


def inertial_from_body(points_m: FloatArray, R_body_inertial: FloatArray) -> FloatArray:
    """Convert points (..., 3) of the body frame R_A to ACRF; ``R_body_inertial`` is (..., 3, 3), m."""
    return np.asarray(np.einsum("...ji,...j->...i", R_body_inertial, points_m), dtype=np.float64)


def angular_velocity(motion: BodyMotionSpec) -> FloatArray:
    """(3,) rad/s at the first frame, where body and inertial axes agree; zero for a body at rest."""
    if motion.kind == "none":
        return np.zeros(3)
    axis = np.asarray(motion.axis_body, dtype=np.float64)
    return np.asarray(2.0 * np.pi / (motion.period_h * _HOUR_S) * axis / np.linalg.norm(axis))


def attitude_function(motion: BodyMotionSpec, rate_rad_s: FloatArray, until_s: float) -> AttitudeFunction:
    """Return the body's attitude as a function of time up to an end, by its angular velocity, (3,), at first."""
    if motion.kind == "none" or not rate_rad_s.any():
        return lambda times_s: np.tile(np.eye(3), (len(times_s), 1, 1))
    if motion.kind == "spin":
        # Coordinates in axes that rotate by +angle: the inverse rotation. At time 0 both axes agree.
        return lambda times_s: Rotation.from_rotvec(-np.outer(times_s, rate_rad_s)).as_matrix()
    return _tumbling(np.asarray(motion.inertia, dtype=np.float64), rate_rad_s, until_s)


def _tumbling(inertia: FloatArray, rate_rad_s: FloatArray, until_s: float) -> AttitudeFunction:
    """Integrate Euler's equations and the attitude in units of the initial angular rate."""
    unit = float(np.linalg.norm(rate_rad_s))

    def change(_: float, state: FloatArray) -> FloatArray:
        rate, quat = state[:3], state[3:]
        turned = np.cross(inertia * rate, rate) / inertia  # I w' = (I w) x w
        # q' = q (w, 0) / 2 for q from body to inertial axes and w in body axes; the product of the quaternions
        # (vector, scalar) and (w, 0) is (scalar w + vector x w, -vector . w).
        vector, scalar = quat[:3], quat[3]
        return np.concatenate(
            [turned, 0.5 * np.concatenate([scalar * rate + np.cross(vector, rate), [-vector @ rate]])]
        )

    # With time in units of 1 / rate all quantities are near 1, to which the tolerances refer.
    start = np.concatenate([rate_rad_s / unit, [0.0, 0.0, 0.0, 1.0]])
    end = max(unit * until_s, 1e-9)
    found = solve_ivp(change, (0.0, end), start, "DOP853", dense_output=True, rtol=_TOLERANCE, atol=_TOLERANCE)
    if not found.success or found.sol is None:
        raise BoresightError(f"sequence.body_motion: the rotation cannot be integrated: {found.message}")

    solution = found.sol

    def attitude(times_s: FloatArray) -> FloatArray:
        quat_xyzw = solution(unit * np.asarray(times_s))[3:].T
        # The quaternion is from body to inertial axes; its norm drifts by the tolerance and is restored.
        return np.swapaxes(Rotation.from_quat(quat_xyzw).as_matrix(), 1, 2)

    return attitude


@dataclass(frozen=True, slots=True, eq=False)
class CameraTrajectory:
    """True motion of camera and body in a trial.

    ``times_s`` (F,) are epochs of the frames, the first at 0. Positions and velocities (F, 3) are in inertial axes
    about the body's centre of mass, ``R_body_inertial`` (F, 3, 3) is the attitude of the body, ``poses`` are
    T_cam_body, ``suns_body`` (F, 3) directions to the Sun. ``radiation_m_s2`` (3,) is the acceleration by sunlight,
    inertial axes. ``anomaly_deg`` (F,) counts from the first frame; NaN along given states. ``start_s`` is the epoch
    of the first of given states.
    """

    times_s: FloatArray
    positions_m: FloatArray
    velocities_m_s: FloatArray
    R_body_inertial: FloatArray
    poses: tuple[Pose, ...]
    suns_body: FloatArray
    radiation_m_s2: FloatArray
    anomaly_deg: FloatArray
    start_s: float = 0.0

    def views(self, camera: Camera) -> tuple[View, ...]:
        """Return the views of all frames."""
        return tuple(View(camera, pose, sun) for pose, sun in zip(self.poses, self.suns_body, strict=True))


def camera_trajectory(spec: SequenceSpec, ground: LandmarkGround, unmodelled_m_s2: FloatArray) -> CameraTrajectory:
    """Compute the camera trajectory over the rotating body.

    ``unmodelled_m_s2``, (F - 1, 3), inertial axes, acts on propagated orbits only. Given states are taken as they are.
    Raise OrbitLostError if a propagated orbit impacts on the body.
    """
    if spec.trajectory is not None:
        return _given_trajectory(spec.trajectory, spec.motion)
    orbit, times = spec.orbit, frame_times_s(spec.orbit)
    # A terminator orbit: the Sun is along its normal.
    sun_dir = orbit_axes(np.array(orbit.normal_body))[2]
    radiation = radiation_pressure(orbit.forces, sun_dir)
    attitude = attitude_function(spec.body_motion, angular_velocity(spec.body_motion), float(times[-1]))
    poses, velocities = circular_poses(orbit), circular_velocities_m_s(orbit)
    positions = np.array([pose.camera_position_m for pose in poses])
    if orbit.model == "propagated":
        pulled = _acceleration(orbit, ground, attitude, radiation)
        start = np.concatenate([positions[0], velocities[0]])
        states = propagate(pulled, ground.reach_m, start, times, PiecewiseAcceleration(times, unmodelled_m_s2))
        positions, velocities = states[:, :3], states[:, 3:]
        # The camera keeps looking at the origin, along the propagated orbit.
        poses = tuple(nadir_pose(*state) for state in zip(positions, velocities, strict=True))
    turns = attitude(times)
    over = tuple(_to_body_axes(pose, turn) for pose, turn in zip(poses, turns, strict=True))
    suns = turns @ sun_dir
    return CameraTrajectory(times, positions, velocities, turns, over, suns, radiation, anomalies_deg(orbit))


def _given_trajectory(flown: SequenceTrajectorySpec, motion: BodyMotionSpec) -> CameraTrajectory:
    """Take the states of a trajectory: velocities are differences where it has none, poses look down where it has none.

    See `SequenceTrajectorySpec` for the roll about the boresight, and the Sun.
    """
    states, in_body = flown.states, np.array(flown.states.position_m)
    times = np.array(states.time_s) - states.time_s[0]
    turns = attitude_function(motion, angular_velocity(motion), float(times[-1]))(times)
    positions = inertial_from_body(in_body, turns)
    if states.velocity_m_s is not None:
        velocities = inertial_from_body(np.array(states.velocity_m_s), turns)
    else:
        velocities = np.gradient(positions, times, axis=0)
    if states.attitude is not None:
        rotations = Rotation.from_quat(states.attitude, scalar_first=True).as_matrix()
        poses = tuple(Pose(turn, -turn @ place) for turn, place in zip(rotations, in_body, strict=True))
    elif states.has_planes:
        ways = zip(positions, velocities, turns, strict=True)
        poses = tuple(_to_body_axes(nadir_pose(place, way), turn) for place, way, turn in ways)
    else:
        poses = tuple(look_at(place) for place in in_body)
    # Those of the poses to the last bit, so that an exact first position is one.
    positions = inertial_from_body(np.array([pose.camera_position_m for pose in poses]), turns)
    if states.sun_dir is not None:
        suns = np.array(states.sun_dir)
    else:
        sun_dir = in_body[0] if flown.sun_dir is None else np.array(flown.sun_dir)
        if flown.sun_dir is not None and flown.rotation is not None:
            sun_dir = flown.rotation.matrices(np.array(states.time_s[:1]))[0] @ sun_dir
        suns = turns @ (sun_dir / np.linalg.norm(sun_dir))
    nowhere = np.full(len(times), np.nan)
    return CameraTrajectory(times, positions, velocities, turns, poses, suns, np.zeros(3), nowhere, states.time_s[0])


def nominal_trajectory(spec: SequenceSpec, ground: LandmarkGround) -> CameraTrajectory:
    """Compute the camera trajectory without unmodelled acceleration."""
    return camera_trajectory(spec, ground, np.zeros((spec.frames - 1, 3)))


def draw_unmodelled_m_s2(orbit: SequenceOrbitSpec, seed: int, trial: int) -> FloatArray:
    """Draw the unmodelled acceleration, (F - 1, 3) m/s2, constant between two frames."""
    rng = generator(seed, Stream.ACCELERATION, trial)
    return orbit.forces.noise_m_s2 * rng.normal(size=(orbit.frames - 1, 3))


def _acceleration(
    orbit: SequenceOrbitSpec, ground: LandmarkGround, attitude: AttitudeFunction, radiation_m_s2: FloatArray
) -> Acceleration:
    """Equation (6) of Delpech et al. (2015) without its noise."""
    if orbit.forces.gravity == "point-mass":
        point = PointMass(orbit.gm_m3_s2)
        return lambda _, position_m: point.acceleration(position_m) + radiation_m_s2
    if not isinstance(ground, MeshGround):
        raise BoresightError("sequence.orbit.forces.gravity: polyhedral needs a body with a mesh: use point-mass")
    body = Polyhedron(ground.mesh, orbit.gm_m3_s2)

    def acceleration(time_s: float, position_m: FloatArray) -> FloatArray:
        # A mesh pulls in its own axes, which rotate.
        turn = attitude(np.array([time_s]))[0]
        return np.asarray(turn.T @ body.acceleration(turn @ position_m) + radiation_m_s2)

    return acceleration


def _to_body_axes(T_cam_inertial: Pose, R_body_inertial: FloatArray) -> Pose:
    """Convert T_cam_inertial to T_cam_body; both frames have the same origin."""
    return Pose(T_cam_inertial.rotation @ R_body_inertial.T, T_cam_inertial.translation_m)
