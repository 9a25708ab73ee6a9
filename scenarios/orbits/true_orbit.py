"""True orbit of a trial, its states at all requested times, and the true views of planned images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.dynamics.field import HarmonicField
from boresight.scenarios.dynamics.gravity import Harmonics
from boresight.scenarios.dynamics.propagation import PiecewiseAcceleration, propagate
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View
from boresight.scenarios.orbits.world import OrbitWorld
from boresight.scenarios.spec.orbit import ArcSpec, ImagingSpec

DAY_S = 86_400.0
_STEPS_PER_CORRELATION_TIME = 4
_WANTED_S = 6 * 3600.0  # between two requested states
_ANOMALY_DEGREES = (2, 3)  # of the density anomalies


def state_at_epoch(arc: ArcSpec, gm_m3_s2: float) -> FloatArray:
    """(6,) position, m, and velocity, m/s, inertial axes, from Keplerian elements or those of an approach."""
    angles = [arc.node_deg, arc.inclination_deg, arc.pericentre_deg]
    # Rz(node) Rx(inclination) Rz(pericentre); capitals are rotations about the turned axes.
    turn = Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix()
    if arc.approach is not None:
        # In the plane of the motion, x along the velocity.
        position = np.array([-arc.approach.along_m, arc.approach.miss_m, 0.0])
        return np.concatenate([turn @ position, turn @ [arc.approach.speed_m_s, 0.0, 0.0]])
    a, e, mean = arc.semi_major_axis_m, arc.eccentricity, np.radians(arc.anomaly_deg % 360.0)
    # Kepler's equation M = E - e sin E; the bracket holds E for all e < 1 and M in [0, 2 pi).
    eccentric = float(brentq(lambda x: x - e * np.sin(x) - mean, -1.0, 2.0 * np.pi + 1.0, xtol=1e-14))
    root, c, s = np.sqrt(1.0 - e * e), np.cos(eccentric), np.sin(eccentric)
    # In the plane of the orbit, x to the pericentre.
    position = a * np.array([c - e, root * s, 0.0])
    velocity = np.sqrt(gm_m3_s2 / a) / (1.0 - e * c) * np.array([-s, root * c, 0.0])
    return np.concatenate([turn @ position, turn @ velocity])


@dataclass(frozen=True, slots=True, eq=False)
class TrueOrbit:
    """True states, inertial axes, at the times of images, of the wanted orbit and of radiometric records.

    Times (I,), (E,) and (N,) are seconds after the epoch, ascending; the first wanted one is the epoch. States are (I,
    6), (E, 6) and (N, 6), m and m/s.
    """

    times_s: FloatArray
    wanted_s: FloatArray
    radio_s: FloatArray
    image_states: FloatArray
    wanted_states: FloatArray
    radio_states: FloatArray


def propagate_truth(world: OrbitWorld, times_s: FloatArray, seed: int, trial: int) -> TrueOrbit:
    """Propagate the true orbit of a trial, with images at ``times_s``, ascending.

    Raise OrbitLostError if the true orbit leads into the body.
    """
    arc = world.spec.arc
    end, last = arc.days * DAY_S, (arc.days + arc.predicted_days) * DAY_S
    wanted = np.unique(np.concatenate([np.arange(0.0, end, _WANTED_S), [end], np.arange(end, last, _WANTED_S), [last]]))
    radio = np.zeros(0)
    if world.spec.radiometry is not None:
        radio = np.arange(0.0, end, 3600.0 * world.spec.radiometry.interval_h)
    every, place = np.unique(np.concatenate([times_s, wanted, radio]), return_inverse=True)
    field, pushes = _true_forces(world, seed, trial)
    states = propagate(
        field.acceleration, field.harmonics.radius_m, state_at_epoch(arc, world.spec.asteroid.gm_m3_s2), every, pushes
    )[place]
    parts = np.split(states, [len(times_s), len(times_s) + len(wanted)])
    return TrueOrbit(times_s, wanted, radio, parts[0], parts[1], parts[2])


def _true_forces(world: OrbitWorld, seed: int, trial: int) -> tuple[HarmonicField, PiecewiseAcceleration]:
    """Return gravity with anomalies, and the unmodelled acceleration: a Gauss-Markov process.

    The process is held constant over quarters of its correlation time.
    """
    rng = generator(seed, Stream.ORBIT_FORCES, trial)
    harmonics, arc, light = world.asteroid.harmonics, world.spec.arc, world.spec.light
    c, s = harmonics.c.copy(), harmonics.s.copy()
    for n in (n for n in _ANOMALY_DEGREES if n <= harmonics.degree):
        c[n, : n + 1] += world.spec.asteroid.anomaly_sigma * rng.normal(size=n + 1)
        # There is no S of order 0.
        s[n, 1 : n + 1] += world.spec.asteroid.anomaly_sigma * rng.normal(size=n)
    field = world.field(Harmonics(harmonics.gm_m3_s2, harmonics.radius_m, c, s))
    end = (arc.days + arc.predicted_days) * DAY_S
    sigma = light.noise_share * float(np.linalg.norm(world.light_m_s2))
    if sigma == 0.0:
        return field, PiecewiseAcceleration.none(end)
    step = light.noise_days * DAY_S / _STEPS_PER_CORRELATION_TIME
    pieces = int(np.ceil(end / step))
    # x_(k+1) = phi x_k + sqrt(1 - phi^2) w, phi = exp(-step / correlation time): the variance stays 1 from the first
    # draw.
    kept = np.exp(-1.0 / _STEPS_PER_CORRELATION_TIME)
    push = np.empty((pieces, 3))
    now = rng.normal(size=3)
    for p in range(pieces):
        push[p] = sigma * now
        now = kept * now + np.sqrt(1.0 - kept**2) * rng.normal(size=3)
    return field, PiecewiseAcceleration(step * np.arange(pieces + 1, dtype=np.float64), push)


def draw_pointing(world: OrbitWorld, images: int, rng: np.random.Generator) -> tuple[FloatArray, Camera]:
    """Draw rotations (I, 3, 3) from reported to true camera axes, and the true camera.

    There are one misalignment and one focal length, and an attitude error for each image.
    """
    spec, known = world.spec.pointing, world.camera
    mounting = 1e-6 * spec.misalignment_urad * rng.normal(size=3)
    shake = 1e-6 * spec.attitude_urad * rng.normal(size=(images, 3))
    focal = 1.0 + spec.focal_error * rng.normal()
    # Left of the reported attitude: about camera axes, the constant mounting first.
    turns = Rotation.from_rotvec(shake).as_matrix() @ Rotation.from_rotvec(mounting).as_matrix()
    return turns, Camera(
        known.width_px, known.height_px, known.fx_px * focal, known.fy_px * focal, known.cx_px, known.cy_px
    )


def imaging_of(world: OrbitWorld) -> ImagingSpec:
    """Return the ``imaging`` section; raise `BoresightError` if it is missing."""
    if world.spec.imaging is None:
        raise BoresightError("orbit.imaging: missing, so there are no images to take")
    return world.spec.imaging


def epochs_s(world: OrbitWorld) -> FloatArray:
    """(I,) possible image times: centres of equal intervals of the arc, or even steps of log range on an approach."""
    count, arc = imaging_of(world).epochs, world.spec.arc
    if arc.approach is not None:
        ranges = np.geomspace(arc.approach.range_m, arc.ranges_m[0], count)
        gone = arc.approach.along_m - np.sqrt(np.maximum(ranges**2 - arc.approach.miss_m**2, 0.0))
        return np.asarray(np.clip(gone / arc.approach.speed_m_s, 0.0, arc.days * DAY_S))
    return (np.arange(count) + 0.5) / count * world.spec.arc.days * DAY_S


def pointed_at(state: FloatArray, target_m: FloatArray) -> FloatArray:
    """R_cam_inertial with the boresight on a target and the x axis along the transverse velocity."""
    forward = target_m - state[:3]
    forward = forward / np.linalg.norm(forward)
    # The part of the velocity across the boresight.
    right = state[3:] - (state[3:] @ forward) * forward
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def control_errors(world: OrbitWorld, images: int, seed: int, trial: int) -> FloatArray:
    """(I, 3) rotation vectors, rad, camera axes, from the planned to the reported pointing."""
    rng = generator(seed, Stream.ORBIT_CONTROL, trial)
    return 1e-6 * imaging_of(world).control_urad * rng.normal(size=(images, 3))


def true_views(
    world: OrbitWorld, flown: TrueOrbit, R_cam_inertial: FloatArray, seed: int, trial: int
) -> tuple[View, ...]:
    """Return the true views of images with reported attitudes (I, 3, 3), in the axes of the shape model."""
    R_true_reported, camera = draw_pointing(world, len(flown.times_s), generator(seed, Stream.ORBIT_POINTING, trial))
    sun, turns = world.sun_dir, world.rotation.at(flown.times_s)
    attitudes = R_true_reported @ R_cam_inertial
    views = []
    for state, turn, attitude in zip(flown.image_states, turns, attitudes, strict=True):
        rotation = attitude @ turn.T
        # The shape model's origin is not the centre of mass.
        position = turn @ state[:3] + world.asteroid.centre_m
        views.append(View(camera, Pose(rotation, -rotation @ position), turn @ sun))
    return tuple(views)
