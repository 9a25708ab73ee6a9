"""What is known before the data, with its errors, and radiometric records of the true motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenarios.draw import Stream, generator
from scenarios.dynamics.harmonics import Harmonics
from scenarios.orbits.data import Knowledge, Radiometry
from scenarios.orbits.flown import DAY_S, Flown
from scenarios.orbits.rotation import UniformRotation
from scenarios.orbits.world import OrbitWorld

FloatArray = NDArray[np.float64]


def draw_knowledge(world: OrbitWorld, state: FloatArray, seed: int, trial: int) -> Knowledge:
    """Draw how wrong is what is known before; ``state`` (6,) is the true one at the epoch."""
    rng, spec, known = generator(seed, Stream.ORBIT_KNOWLEDGE, trial), world.spec, world.spec.knowledge
    rate = np.sqrt(spec.asteroid.gm_m3_s2 / spec.arc.semi_major_axis_m**3)
    ways = rng.normal(size=(2, 3))
    ways *= known.position_m / np.linalg.norm(ways, axis=1, keepdims=True)
    error = np.concatenate([ways[0], rate * ways[1]])
    gm, light = 1.0 + known.gm_sigma * rng.normal(), 1.0 + known.light_sigma * rng.normal()
    believed = world.believed.harmonics
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
        coefficient_sigma=world.coefficient_sigma,
        noise_m_s2=spec.light.noise_share * float(np.linalg.norm(world.light_m_s2)),
        noise_time_s=spec.light.noise_days * DAY_S,
    )


def _believed_rotation(world: OrbitWorld, rng: np.random.Generator) -> UniformRotation:
    """Draw how the body is believed to turn: its axis and its rate wrong, of which nothing tells the estimator.

    The phase at the epoch is right: it and the landmarks' longitudes are one unknown by two names.
    """
    known, true = world.spec.knowledge, world.rotation
    if not known.pole_sigma_deg and not known.spin_sigma:
        return true
    across_rad = np.radians(known.pole_sigma_deg) * rng.normal(size=2)
    longer = 1.0 + known.spin_sigma * rng.normal()
    tilt = Rotation.from_rotvec([*across_rad, 0.0]).as_matrix()
    return UniformRotation(tilt @ true.R_body_inertial, longer * true.rate_rad_s)


def draw_radiometry(world: OrbitWorld, flown: Flown, seed: int, trial: int) -> Radiometry | None:
    """Measure range and Doppler along the flown orbit; None where the scenario has no radiometric data."""
    spec = world.spec.radiometry
    if spec is None:
        return None
    rng = generator(seed, Stream.ORBIT_RADIOMETRY, trial)
    earth = np.array(world.spec.light.earth_dir) / np.linalg.norm(world.spec.light.earth_dir)
    n = len(flown.radio_s)
    bias = spec.range_bias_sigma_m * rng.normal()
    # The station is on the Earth's side: the nearer the spacecraft is to it, the shorter the range.
    ranges = -flown.radio_states[:, :3] @ earth + bias + spec.range_sigma_m * rng.normal(size=n)
    rates = -flown.radio_states[:, 3:] @ earth + spec.range_rate_sigma_m_s * rng.normal(size=n)
    return Radiometry(
        earth, flown.radio_s, ranges, rates, spec.range_sigma_m, spec.range_rate_sigma_m_s, spec.range_bias_sigma_m
    )
