"""Simulate a trial of orbit determination: true orbit, sightings, radiometry and a priori knowledge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.dynamics.field import UniformRotation
from boresight.scenarios.dynamics.gravity import Harmonics
from boresight.scenarios.dynamics.propagation import OrbitLostError, PiecewiseAcceleration, propagate_states
from boresight.scenarios.orbits.data import Knowledge, LandmarkFile, OrbitData, Pictures, Radiometry
from boresight.scenarios.orbits.true_orbit import DAY_S, TrueOrbit, draw_pointing, pointed_at, propagate_truth
from boresight.scenarios.orbits.world import Horizons, OrbitWorld
from boresight.scenarios.spec.orbit import CraterSightingSpec


def draw_knowledge(world: OrbitWorld, state: FloatArray, seed: int, trial: int) -> Knowledge:
    """Draw the a priori knowledge with its errors; ``state`` (6,) is the true one at the epoch."""
    rng, spec, known = generator(seed, Stream.ORBIT_KNOWLEDGE, trial), world.spec, world.spec.knowledge
    # The error of the velocity is that of the position times a rate: the mean motion, or that of the approach.
    if (approach := spec.arc.approach) is not None:
        rate = approach.speed_m_s / approach.range_m
    else:
        rate = np.sqrt(spec.asteroid.gm_m3_s2 / spec.arc.semi_major_axis_m**3)
    ways = rng.normal(size=(2, 3))
    # Random directions of a given length: the variance of a coordinate is a third of its square.
    ways *= known.position_m / np.linalg.norm(ways, axis=1, keepdims=True)
    error = np.concatenate([ways[0], rate * ways[1]])
    gm, light = 1.0 + known.gm_sigma * rng.normal(), 1.0 + known.light_sigma * rng.normal()
    believed = world.onboard.harmonics
    harmonics = Harmonics(believed.gm_m3_s2 * gm, believed.radius_m, believed.c, believed.s)
    return Knowledge(
        camera=world.camera,
        field=world.field(harmonics, light, _believed_rotation(world, rng)),
        state=state + error,
        position_sigma_m=known.position_m / np.sqrt(3.0),
        velocity_sigma_m_s=float(rate * known.position_m / np.sqrt(3.0)),
        noise_px=spec.sightings.noise_px,
        attitude_sigma_rad=1e-6 * spec.pointing.attitude_urad,
        misalignment_sigma_rad=1e-6 * spec.pointing.misalignment_urad,
        focal_sigma=spec.pointing.focal_error,
        gm_sigma=known.gm_sigma,
        light_sigma=known.light_sigma,
        pole_sigma_rad=float(np.radians(known.pole_sigma_deg)),
        spin_sigma=known.spin_sigma,
        coefficient_sigma=world.coefficient_sigma,
        noise_m_s2=spec.light.noise_share * float(np.linalg.norm(world.light_m_s2)),
        noise_time_s=spec.light.noise_days * DAY_S,
    )


def _believed_rotation(world: OrbitWorld, rng: np.random.Generator) -> UniformRotation:
    """Draw the onboard spin model, with errors of pole and rate.

    The phase at the epoch has no error: it is equivalent to a common shift of the landmarks' longitudes.
    """
    known, true = world.spec.knowledge, world.rotation
    if not known.pole_sigma_deg and not known.spin_sigma:
        return true
    across_rad = np.radians(known.pole_sigma_deg) * rng.normal(size=2)
    longer = 1.0 + known.spin_sigma * rng.normal()
    return true.changed(across_rad, longer)


def draw_radiometry(world: OrbitWorld, flown: TrueOrbit, seed: int, trial: int) -> Radiometry | None:
    """Simulate range and Doppler along the true orbit; None if the scenario has no radiometric data."""
    spec = world.spec.radiometry
    if spec is None:
        return None
    rng = generator(seed, Stream.ORBIT_RADIOMETRY, trial)
    earth = np.array(world.spec.light.earth_dir) / np.linalg.norm(world.spec.light.earth_dir)
    n = len(flown.radio_s)
    bias = spec.range_bias_sigma_m * rng.normal()
    # A displacement towards the Earth shortens the range.
    ranges = -flown.radio_states[:, :3] @ earth + bias + spec.range_sigma_m * rng.normal(size=n)
    # The bias of the range is constant and has no rate.
    rates = -flown.radio_states[:, 3:] @ earth + spec.range_rate_sigma_m_s * rng.normal(size=n)
    return Radiometry(
        earth, flown.radio_s, ranges, rates, spec.range_sigma_m, spec.range_rate_sigma_m_s, spec.range_bias_sigma_m
    )


@dataclass(frozen=True, slots=True, eq=False)
class OrbitTruth:
    """True values of a trial, for scoring only.

    ``states`` (E, 6) are at the times of `OrbitData.wanted_s`, inertial axes, the first at the epoch; ``image_states``
    (I, 6) at the images. Each of K sightings has its true ``crater``, and is ``wrong`` if it has the number of another
    one, except for merged numbers. ``points_body_m`` (n, 3) are of all craters; ``light_m_s2`` (3,) is the acceleration
    by sunlight.
    """

    states: FloatArray
    image_states: FloatArray
    crater: IndexArray
    wrong: BoolArray
    points_body_m: FloatArray
    gm_m3_s2: float
    light_m_s2: FloatArray


def draw_orbit(world: OrbitWorld, seed: int, trial: int) -> tuple[OrbitTruth, OrbitData]:
    """Draw a trial; raise OrbitLostError if the true orbit leads into the body."""
    arc, images = world.spec.arc.days * DAY_S, world.spec.sightings.images
    times = np.sort(generator(seed, Stream.ORBIT_IMAGES, trial).uniform(0.0, arc, images))
    flown = propagate_truth(world, times, seed, trial)
    knowledge = draw_knowledge(world, flown.wanted_states[0], seed, trial)
    pictures, crater, wrong = _pictures(world, flown, seed, trial)
    landmarks = _landmarks(world, knowledge, pictures)
    data = OrbitData(knowledge, pictures, landmarks, draw_radiometry(world, flown, seed, trial), flown.wanted_s)
    truth = OrbitTruth(
        states=flown.wanted_states,
        image_states=flown.image_states,
        crater=crater,
        wrong=wrong,
        points_body_m=world.asteroid.horizons.points_m,
        gm_m3_s2=world.spec.asteroid.gm_m3_s2,
        light_m_s2=world.light_m_s2,
    )
    return truth, data


def _pictures(world: OrbitWorld, flown: TrueOrbit, seed: int, trial: int) -> tuple[Pictures, IndexArray, BoolArray]:
    """Simulate the numbered sightings; also return the true crater of each, and which numbers are wrong.

    Each image is pointed at a random lit and visible crater, or at the origin if there is none.
    """
    rng, images = generator(seed, Stream.ORBIT_POINTING, trial), len(flown.times_s)
    R_true_reported, camera = draw_pointing(world, images, rng)
    # Drawn for all images at once: how many craters are in view must not shift the stream.
    aims = rng.uniform(size=images)
    rng, spec, asteroid = generator(seed, Stream.ORBIT_SIGHTINGS, trial), world.spec.sightings, world.asteroid
    horizons, attitudes = asteroid.horizons, np.empty((images, 3, 3))
    numbers = merged_numbers(horizons.points_m, spec.merged_share, rng)
    turns = world.rotation.at(flown.times_s)
    parts: list[tuple[IndexArray, IndexArray, FloatArray, IndexArray, BoolArray]] = []
    for i, state in enumerate(flown.image_states):
        rows = lit_and_seen(horizons, turns[i] @ state[:3], turns[i] @ world.sun_dir, spec)
        target = turns[i].T @ horizons.points_m[rows[int(aims[i] * len(rows))]] if len(rows) else np.zeros(3)
        # The camera is pointed by the reported attitude; the true one differs by the errors.
        attitudes[i] = pointed_at(state, target)
        # Rows times R_body_inertial are its transpose times columns: body to inertial axes.
        inertial = horizons.points_m[rows] @ turns[i] - state[:3]
        uv = camera.project(inertial @ (R_true_reported[i] @ attitudes[i]).T)
        inside = world.camera.contains(uv, spec.margin_px)
        rows, uv = rows[inside], uv[inside]
        chosen = draw_found_craters(rows, asteroid.prominence, spec, rng)
        reported, wrong = misidentify(numbers[rows], chosen, uv, spec, rng)
        seen = uv[chosen] + spec.noise_px * rng.normal(size=(len(chosen), 2))
        # A number can occur once in an image: the first sighting of it is kept.
        _, first = np.unique(reported, return_index=True)
        once = np.sort(first)
        parts.append((np.full(len(once), i), reported[once], seen[once], rows[chosen][once], wrong[once]))
    image, landmark, uv, crater, wrong = (np.concatenate(part) for part in zip(*parts, strict=True))
    pictures = Pictures(flown.times_s, attitudes, image, landmark, uv)
    return pictures, crater, wrong


def lit_and_seen(
    horizons: Horizons, camera_position_m: FloatArray, sun_dir: FloatArray, spec: CraterSightingSpec
) -> IndexArray:
    """Return the indices of the visible, sunlit craters within the limits of emission and incidence; body axes."""
    towards = camera_position_m - horizons.points_m
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    emission = np.einsum("ni,ni->n", horizons.normals, towards)
    incidence = horizons.normals @ sun_dir
    limits = np.cos(np.radians([spec.emission_max_deg, spec.incidence_max_deg]))
    rows = np.flatnonzero((emission > limits[0]) & (incidence > limits[1]))
    free = horizons.free(rows, towards[rows])
    rows = rows[free]
    return rows[horizons.free(rows, np.broadcast_to(sun_dir, (len(rows), 3)))]


def draw_found_craters(
    rows: IndexArray, prominence: FloatArray, spec: CraterSightingSpec, rng: np.random.Generator
) -> IndexArray:
    """Draw which of the craters in view are detected: positions in ``rows``, ascending."""
    # Poisson with a gamma-distributed mean, the negative binomial law: images differ in how many craters are found.
    mean = spec.per_image * rng.gamma(spec.per_image_shape) / spec.per_image_shape
    count = min(int(rng.poisson(mean)), len(rows))
    if not count:
        return np.zeros(0, dtype=np.int64)
    # Without replacement: a prominent crater is found more often, none twice.
    weights = prominence[rows] / prominence[rows].sum()
    return np.sort(rng.choice(len(rows), count, replace=False, p=weights))


def merged_numbers(points_m: FloatArray, share: float, rng: np.random.Generator) -> IndexArray:
    """(n,) number of each crater; a share of the craters have the number of their nearest neighbour."""
    numbers = np.arange(len(points_m))
    free = np.ones(len(points_m), dtype=bool)
    wanted = round(share * len(points_m))
    for i in rng.permutation(len(points_m)):
        if wanted <= 0:
            break
        if not free[i]:
            continue
        distance = np.where(free, np.linalg.norm(points_m - points_m[i], axis=1), np.inf)
        distance[i] = np.inf
        other = int(np.argmin(distance))
        numbers[i] = other
        free[[i, other]] = False
        wanted -= 1
    return numbers


def misidentify(
    numbers: IndexArray, chosen: IndexArray, uv_px: FloatArray, spec: CraterSightingSpec, rng: np.random.Generator
) -> tuple[IndexArray, BoolArray]:
    """Return the reported numbers of detected craters, and which of them are wrong.

    ``numbers`` (n,) are the correct ones of the craters in view, ``uv_px`` (n, 2) their pixels, ``chosen`` (k,) the
    rows of the detected ones. A wrong number is that of another crater in view, weighted by a Gaussian of the distance.
    """
    # One draw for each sighting, whatever the share is.
    wrong = rng.uniform(size=len(chosen)) < spec.wrong_share
    reported = numbers[chosen].copy()
    for k in np.flatnonzero(wrong):
        apart = np.sum((uv_px - uv_px[chosen[k]]) ** 2, axis=1)
        # Craters with the same number, the crater itself or one merged with it, are no wrong ones.
        weights = np.exp(-0.5 * apart / spec.wrong_within_px**2) * (numbers != numbers[chosen[k]])
        if weights.sum() > 0.0:
            reported[k] = numbers[rng.choice(len(numbers), p=weights / weights.sum())]
        else:
            wrong[k] = False
    return reported, wrong


def _landmarks(world: OrbitWorld, knowledge: Knowledge, pictures: Pictures) -> LandmarkFile:
    """Compute a priori positions: first lines of sight by the a priori orbit, intersected with the a priori shape."""
    numbers, first = np.unique(pictures.landmark, return_index=True)
    image = pictures.image[first]
    used, place = np.unique(image, return_inverse=True)
    times = pictures.times_s[used]
    try:
        states = propagate_states(knowledge.field, knowledge.state, times, PiecewiseAcceleration.none(float(times[-1])))
    # A poor a priori orbit can lead into the body. Positions by the state at the epoch are wrong, but the trial goes
    # on.
    except OrbitLostError:
        states = np.tile(knowledge.state, (len(times), 1))
    turns = knowledge.field.rotation.at(times)
    rays = knowledge.camera.unproject(pictures.uv_px[first])
    # R_body_inertial R_inertial_cam ray.
    rays = np.einsum("nij,nkj,nk->ni", turns[place], pictures.R_cam_inertial[image], rays)
    origins = np.einsum("nij,nj->ni", turns[place], states[place, :3])
    points = world.onboard.shape.intersect(origins, rays)
    # Errors of the a priori shape and of the orbit, as if the same on each coordinate.
    sigma = float(np.hypot(world.onboard.shape.rms_m, world.spec.knowledge.position_m))
    return LandmarkFile(numbers, points, np.full(len(numbers), sigma))
