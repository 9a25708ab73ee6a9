"""Random streams of a trial, and random draws of camera pose, Sun direction and prior pose error."""

from __future__ import annotations

import hashlib
import math
from enum import IntEnum
from typing import Literal, Protocol

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View, cross_matrix, look_at
from boresight.scenarios.spec.distribution import Choice, Uniform, constant, drawn
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.stars import StarsSpec
from boresight.scenarios.spec.world import AttitudeErrorSpec, LightingSpec, PoseErrorSpec, ViewpointSpec

_ALL_LATITUDES_RAD = (-0.5 * np.pi, 0.5 * np.pi)


_LIMB_EMISSION_DEG = (50.0, 70.0)
_TERMINATOR_INCIDENCE_DEG = (55.0, 75.0)
_MOST_DEG = 80.0  # of emission and incidence of a target

TargetKind = Literal["nadir", "limb", "terminator"]
TARGET_KINDS: tuple[TargetKind, ...] = ("nadir", "limb", "terminator")


class Surface(Protocol):
    """Surface of a body, above which an altitude is: a mesh, or a cratered surface."""

    def distance_along_m(self, direction: FloatArray) -> float:
        """Return the distance from the origin to the outermost facet along a unit vector, (3,)."""
        ...


def draw_aimed_view(
    viewpoint: ViewpointSpec,
    lighting: LightingSpec,
    camera: Camera,
    shape: TriangleMesh,
    rng: np.random.Generator,
    state: int = 0,
    surface: Surface | None = None,
) -> View:
    """Draw a camera position and a Sun direction as `draw_lit_view` does, and point at a sunlit target if asked for.

    Targets are those of Cheng et al. (2003): the nadir if it is lit, and regions near the lit limb and the terminator.
    The target is a facet of ``shape``, drawn by area; occlusion by other parts is not checked. If no facet fits the
    kind, the lit facet nearest to the nadir is taken; if none is lit, the body's centre. An altitude is above
    ``surface``, by default the shape.
    """
    surface = surface or shape
    if not viewpoint.targets:
        return draw_lit_view(viewpoint, lighting, camera, rng, state, surface)
    exact = viewpoint.model_copy(update={"off_pointing_deg": None})
    view = draw_lit_view(exact, lighting, camera, rng, state, surface)
    kind, turn_rad = str(rng.choice(viewpoint.targets)), float(rng.uniform(0.0, 2.0 * np.pi))
    position = view.T_cam_body.camera_position_m
    places = shape.corners_m.mean(axis=1)
    emission, incidence = emission_incidence_deg(places, shape.normals, position, view.sun_dir_body)
    lit = is_lit_and_facing(emission, incidence)
    chosen = lit & near_limb_or_terminator(kind, emission, incidence)
    target = np.zeros(3)
    if lit.any():
        from_nadir = places @ position / np.linalg.norm(places, axis=1)
        target = places[int(np.where(lit, from_nadir, -np.inf).argmax())]
    if chosen.any():
        # Facets that are not chosen have no area, so that no number falls on them. Drawn for each kind.
        total = np.cumsum(np.where(chosen, shape.areas_m2, 0.0))
        row = int(np.searchsorted(total, rng.uniform(0.0, total[-1]), side="right"))
        target = target if kind == "nadir" else places[row]
    # look_at points at the origin: the rotation is that of a camera at the same offset from it.
    turned = look_at(position - target, turn_rad)
    aimed = View(camera, Pose(turned.rotation, -turned.rotation @ position), view.sun_dir_body)
    return _off_pointed(aimed, viewpoint, rng)


def emission_incidence_deg(
    points_m: FloatArray, normals: FloatArray, position_m: FloatArray, sun_dir_body: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n,) angles of emission and incidence of points (n, 3) with normals (n, 3) for a camera and a Sun, (3,) each."""
    to_camera = position_m - points_m
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    emission = np.degrees(np.arccos(np.clip(np.einsum("fi,fi->f", normals, to_camera), -1.0, 1.0)))
    return emission, np.degrees(np.arccos(np.clip(normals @ sun_dir_body, -1.0, 1.0)))


def is_lit_and_facing(emission_deg: FloatArray, incidence_deg: FloatArray) -> BoolArray:
    """(n,) whether incidence and emission are both below 80 deg."""
    return (emission_deg < _MOST_DEG) & (incidence_deg < _MOST_DEG)


def near_limb_or_terminator(kind: str, emission_deg: FloatArray, incidence_deg: FloatArray) -> BoolArray:
    """(n,) whether points lie near the limb for ``kind`` limb, and near the terminator for any other."""
    if kind == "limb":
        return (emission_deg > _LIMB_EMISSION_DEG[0]) & (emission_deg < _LIMB_EMISSION_DEG[1])
    low, high = _TERMINATOR_INCIDENCE_DEG
    return (incidence_deg > low) & (incidence_deg < high) & (emission_deg < _LIMB_EMISSION_DEG[0])


class Stream(IntEnum):
    """Purpose of a random stream. Append only: the numbers are part of every seed."""

    TRUTH = 0
    POSE_ERROR = 1
    DETECTOR = 2
    ESTIMATOR = 3
    DATABASE = 4
    KNOWLEDGE = 5
    ALTIMETER = 6
    LANDMARKS = 7
    TRACK_FIELD = 8
    TRACK_NOISE = 9
    MOTION = 10
    MISMATCH = 11
    ACCELERATION = 12
    FORCES = 13
    ROTATION = 14
    RANGES = 15
    REVISIT = 16
    STATES = 17
    CORRELATED = 18
    TRACK_ERRORS = 19
    SKY = 20
    STAR_TRACKER = 21
    SECOND_BODY = 22
    ORBIT_CRATERS = 32
    ORBIT_IMAGES = 33
    ORBIT_SIGHTINGS = 34
    ORBIT_POINTING = 35
    ORBIT_RADIOMETRY = 36
    ORBIT_FORCES = 37
    ORBIT_KNOWLEDGE = 38
    ORBIT_CONTROL = 39
    ORBIT_DETECTIONS = 40


def generator(seed: int, stream: Stream, trial: int) -> np.random.Generator:
    """Return the generator of one stream of one trial.

    It depends on the address (seed, stream, trial) alone, not on the order of trials or the content of the scenario, so
    that scenarios and estimators are compared on the same draws.
    """
    # spawn_key, not the seed plus a number: streams of neighbouring trials are independent.
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), trial)))


def estimator_generator(seed: int, trial: int) -> np.random.Generator:
    """Return the generator that an estimator draws from in a trial.

    Its seed is a one-way hash of its address. The campaign's seed, from which the truth could be drawn again, can be
    read from a generator of ``generator`` but not from this one; a guess of the seed can still be verified.
    """
    address = f"boresight estimator {seed} {int(Stream.ESTIMATOR)} {trial}".encode()
    return np.random.default_rng(int.from_bytes(hashlib.blake2b(address, digest_size=16).digest(), "little"))


def state_of_trial(viewpoint: ViewpointSpec | None, seed: int, trial: int) -> int:
    """Return the index of a trial's state of a trajectory; 0 for a viewpoint that has none."""
    if viewpoint is None or viewpoint.trajectory is None:
        return 0
    count = len(viewpoint.trajectory.states)
    if viewpoint.trajectory.order == "in-turn":
        return trial % count
    return int(generator(seed, Stream.STATES, trial).integers(count))


def drawn_together(spec: ScenarioSpec, seed: int, trial: int) -> ScenarioSpec:
    """Return the scenario of a trial, in which the keys of ``correlated`` have the values of the trial.

    They are drawn from a stream of their own; a scenario without them is returned as it is.
    """
    if spec.correlated is None:
        return spec
    shares = spec.correlated.shares(generator(seed, Stream.CORRELATED, trial))
    for key, share in zip(spec.correlated.keys, shares, strict=True):
        law, (section, _, name) = spec.law_of(key), key.partition(".")
        if law is None:
            raise BoresightError(f"correlated.keys: {key} is not drawn")
        if spec.correlated.same_row and isinstance(law, Choice):
            value = law.choice[int(share * len(law.choice))]
        elif key == "lighting.phase_deg":
            value = math.degrees(phase_quantile_rad(spec.lighting, share))
        else:
            value = law.quantile(share)
        fixed = getattr(spec, section).model_copy(update={name: constant(value)})
        spec = spec.model_copy(update={section: fixed})
    return spec


def draw_view(spec: ScenarioSpec, camera: Camera, rng: np.random.Generator, state: int = 0) -> View:
    """Draw the true view of a trial, at a state of the trajectory if there is one.

    Raise BoresightError if the scenario has no viewpoint section: its views come from a table of real images.
    """
    if spec.viewpoint is None:
        raise BoresightError(
            f"{spec.name}: viewpoint: missing, so there is no view to draw; real images have their own"
        )
    return draw_lit_view(spec.viewpoint, spec.lighting, camera, rng, state)


def draw_lit_view(
    viewpoint: ViewpointSpec,
    lighting: LightingSpec,
    camera: Camera,
    rng: np.random.Generator,
    state: int = 0,
    surface: Surface | None = None,
) -> View:
    """Draw a camera pose with the boresight on the body's origin, and a direction to the Sun.

    The direction to the camera is uniform over the area of the latitude band. The direction to the Sun is at the phase
    angle from it, at an azimuth uniform about it. A ``state`` of a trajectory, by its index, has the position, and the
    attitude and the Sun if its table has them; only what it has not is drawn. Off-pointing turns the camera in its
    place. An altitude is above ``surface``.
    """
    if viewpoint.states is None:
        south_rad, north_rad = np.radians(viewpoint.latitude_deg.uniform)
        camera_dir_body = draw_direction((south_rad, north_rad), rng)
    roll_rad = np.radians(viewpoint.roll_deg.draw(rng))
    phase_rad = draw_phase(lighting, rng)
    azimuth_rad = rng.uniform(0.0, 2.0 * np.pi)
    if viewpoint.states is not None:
        position_m = np.array(viewpoint.states.position_m[state])
    elif viewpoint.range_m is not None:
        position_m = drawn(viewpoint.range_m, rng) * camera_dir_body
    elif viewpoint.altitude_m is None or surface is None:
        raise BoresightError("viewpoint: give range_m or trajectory; an altitude is above a surface, and none is read")
    else:
        position_m = (surface.distance_along_m(camera_dir_body) + drawn(viewpoint.altitude_m, rng)) * camera_dir_body
    T_cam_body = look_at(position_m, float(roll_rad))
    if viewpoint.states is not None and viewpoint.states.attitude is not None:
        turned = Pose.from_quat_wxyz(np.array(viewpoint.states.attitude[state]), np.zeros(3)).rotation
        T_cam_body = Pose(turned, -turned @ position_m)
    # In camera axes the body's origin is at +z, so that the camera lies towards -z from it.
    across_cam = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    towards_camera_cam = np.array([0.0, 0.0, -1.0])
    sun_dir_cam = np.cos(phase_rad) * towards_camera_cam + np.sin(phase_rad) * across_cam
    sun_dir_body = T_cam_body.inverse().rotate(sun_dir_cam)
    if viewpoint.states is not None and viewpoint.states.sun_dir is not None:
        sun_dir_body = np.array(viewpoint.states.sun_dir[state])
    return _off_pointed(View(camera, T_cam_body, sun_dir_body), viewpoint, rng)


def _off_pointed(view: View, viewpoint: ViewpointSpec, rng: np.random.Generator) -> View:
    """Turn the camera in its place so that its boresight misses what it pointed at."""
    if viewpoint.off_pointing_deg is None:
        return view
    angle_rad, azimuth_rad = np.radians(viewpoint.off_pointing_deg.draw(rng)), rng.uniform(0.0, 2.0 * np.pi)
    across = angle_rad * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    turned = view.T_cam_body.perturbed(across, np.zeros(3)).rotation
    return View(view.camera, Pose(turned, -turned @ view.T_cam_body.camera_position_m), view.sun_dir_body)


def draw_direction(latitudes_rad: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Draw a unit vector, (3,), uniform over the area between two latitudes."""
    south, north = np.sin(latitudes_rad)
    # The area between two latitudes is proportional to the difference of their sines (Archimedes).
    z = rng.uniform(south, north)
    longitude_rad = rng.uniform(0.0, 2.0 * np.pi)
    radius = np.sqrt(1.0 - z * z)
    return np.array([radius * np.cos(longitude_rad), radius * np.sin(longitude_rad), z])


def turn_direction(direction: FloatArray, angle_rad: float, azimuth_rad: float) -> FloatArray:
    """Rotate a unit vector (3,) by an angle towards an azimuth about it."""
    # The coordinate axis farthest from the direction gives a well-conditioned product.
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first /= np.linalg.norm(first)
    across = np.cos(azimuth_rad) * first + np.sin(azimuth_rad) * np.cross(direction, first)
    return np.asarray(np.cos(angle_rad) * direction + np.sin(angle_rad) * across)


def draw_phase(lighting: LightingSpec, rng: np.random.Generator) -> float:
    """Draw a phase angle, rad: if it is uniform, in its cosine (the solid angle) or in itself; else by its law."""
    if not isinstance(lighting.phase_deg, Uniform):
        return math.radians(lighting.phase_deg.draw(rng))
    low, high = np.radians(lighting.phase_deg.uniform)
    if lighting.measure == "angle":
        return float(rng.uniform(low, high))
    # The solid angle of a cap grows with 1 - cos(phase).
    return float(np.arccos(rng.uniform(np.cos(high), np.cos(low))))


def phase_quantile_rad(lighting: LightingSpec, share: float) -> float:
    """Return the phase angle that a share of those of `draw_phase` are below, rad."""
    if lighting.measure == "angle" or not isinstance(lighting.phase_deg, Uniform):
        return math.radians(lighting.phase_deg.quantile(share))
    low, high = np.cos(np.radians(lighting.phase_deg.uniform))
    return float(np.arccos((1.0 - share) * low + share * high))


def body_attitude(stars: StarsSpec, seed: int, trial: int, time_s: float) -> FloatArray:
    """(3, 3) rotation from inertial to body axes: by the body's rotation, else drawn uniformly over all rotations."""
    if stars.rotation is not None:
        return np.asarray(stars.rotation.matrices(np.array([time_s]))[0], dtype=np.float64)
    # A normal quaternion of unit length is uniform.
    quat_wxyz = generator(seed, Stream.SKY, trial).normal(size=4)
    return Pose.from_quat_wxyz(quat_wxyz / np.linalg.norm(quat_wxyz), np.zeros(3)).rotation


def rtn_axes(position_m: FloatArray, velocity_m_s: FloatArray) -> FloatArray:
    """(3, 3) matrix of the radial, transverse and normal unit vectors, as columns, of a position and velocity (3,)."""
    radial = position_m / np.linalg.norm(position_m)
    normal = np.cross(position_m, velocity_m_s)
    normal /= np.linalg.norm(normal)
    return np.column_stack([radial, np.cross(normal, radial), normal])


def degrade(
    T_cam_body: Pose,
    spec: PoseErrorSpec,
    camera: Camera,
    rng: np.random.Generator,
    velocity_m_s: FloatArray | None = None,
) -> Pose:
    """Degrade a true pose: shift its translation in camera axes and turn its attitude.

    This is the error of Rowell et al. (2015), section 4.2. The translation is T of equation (4): the shift alone moves
    the body in the image, and the error of the camera's position in the body frame is the shift plus the attitude
    error times the range.

    With ``position_body_m`` or ``position_rtn_m`` the camera's position has that error, whatever the attitude's is; the
    latter needs the camera's velocity (3,), in body axes. `prior_covariance` is the second moment of the same laws.
    """
    position, rotation_rad = draw_pose_error(spec, rng)
    if spec.pose_cam_deg_m is not None:
        return T_cam_body.perturbed(rotation_rad, position)
    if (unit_m := _unit_m(spec, T_cam_body, camera)) is not None:
        return T_cam_body.perturbed(rotation_rad, position * unit_m)
    position_m = T_cam_body.camera_position_m
    axes = _axes(spec, position_m, velocity_m_s)
    position_m = position_m + (position if axes is None else axes @ position)
    turned = T_cam_body.perturbed(rotation_rad, np.zeros(3)).rotation
    return Pose(turned, -turned @ position_m)


def draw_pose_error(spec: PoseErrorSpec, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw the values of a pose error: (3,) of its law of the position, in that law's unit, and a rotation vector, rad.

    The vector (3,) is in camera axes.
    """
    if spec.pose_cam_deg_m is not None:
        joint = spec.pose_cam_deg_m.draw(rng)
        return joint[3:], np.radians(joint[:3])
    # Drawn before the attitude: the order belongs to the stream.
    position = spec.position[1].draw(rng)
    return position, _rotation_vector(spec.attitude, rng)


def prior_covariance(
    spec: PoseErrorSpec, prior: Pose, camera: Camera, velocity_m_s: FloatArray | None = None
) -> FloatArray:
    """Return the (6, 6) second moment of the error that ``degrade`` adds, [rotation_rad, translation_m] in camera axes.

    ``prior`` is the degraded pose, as the spacecraft does not know the true one: its range and the camera scale errors
    in pixel sizes, and it turns errors in body axes, to first order. Errors in radial, transverse and normal direction
    need the velocity (3,), in body axes.
    """
    if spec.pose_cam_deg_m is not None:
        units = np.array([*np.full(3, np.radians(1.0)), 1.0, 1.0, 1.0])
        return spec.pose_cam_deg_m.second_moment * np.outer(units, units)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = spec.attitude.second_moment_rad2
    moment = spec.position[1].second_moment
    if (unit_m := _unit_m(spec, prior, camera)) is not None:
        covariance[3:, 3:] = moment * unit_m**2
        return covariance
    # T = -R c: an error e of the camera's position c and a turn w of the attitude change T by w x T - R e.
    axes = _axes(spec, prior.camera_position_m, velocity_m_s)
    covariance[3:, 3:] = moment if axes is None else axes @ moment @ axes.T
    by_error = np.block([[np.eye(3), np.zeros((3, 3))], [-cross_matrix(prior.translation_m), -prior.rotation]])
    moved = by_error @ covariance @ by_error.T
    return np.asarray(0.5 * (moved + moved.T), dtype=np.float64)


def _unit_m(spec: PoseErrorSpec, pose: Pose, camera: Camera) -> float | None:
    """Return the metres of a unit of the shift in camera axes; None if the error is of the camera's position."""
    key, _ = spec.position
    if key == "position_cam_px":
        return float(np.linalg.norm(pose.translation_m)) * camera.pixel_angle_rad
    return 1.0 if key == "position_cam_m" else None


def _axes(spec: PoseErrorSpec, position_m: FloatArray, velocity_m_s: FloatArray | None) -> FloatArray | None:
    """Return the axes (3, 3) in the body's that the error of the camera's position is in; None for those themselves."""
    if spec.position_rtn_m is None:
        return None
    if velocity_m_s is None:
        raise BoresightError("pose_error.position_rtn_m: needs a trajectory whose table has velocities")
    return rtn_axes(position_m, velocity_m_s)


def _rotation_vector(spec: AttitudeErrorSpec, rng: np.random.Generator) -> FloatArray:
    """Draw a rotation vector, (3,), rad, in camera axes."""
    if spec.rotation_vector_deg is not None:
        return np.radians(spec.rotation_vector_deg.draw(rng))
    if spec.angle_deg is not None:
        angle_rad = np.radians(spec.angle_deg.draw(rng))
        return np.asarray(angle_rad * draw_direction(_ALL_LATITUDES_RAD, rng))
    raise BoresightError("pose_error.attitude: give either angle_deg or rotation_vector_deg")
