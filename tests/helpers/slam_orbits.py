"""Sequences along orbits integrated by scipy, for the tests of SLAM with dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from slam_sequences import ORBIT_M, STEP_RAD, Recipe, Truth, sequence_along

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import Forces, TrackSequence

GM = 3.54
RATE = np.sqrt(GM / ORBIT_M**3)
INTERVAL_S = STEP_RAD / RATE
LIGHT = np.array([0.0, 0.2e-7, -1.0e-7])
SPIN = np.array([0.2, -0.1, 1.0]) * 2.0 * np.pi / (30.4 * 3600.0)


@dataclass(frozen=True)
class Drive:
    """Standard deviations of the errors of the spacecraft's prior knowledge."""

    noise_m_s2: float = 1e-7
    gm_sigma: float = 0.1
    radiation_sigma: float = 0.2
    velocity_sigma_m_s: float = 1e-3
    spinning: bool = True


def flown(start: FloatArray, gm: float, light: FloatArray, pushes: FloatArray) -> FloatArray:
    """(n + 1, 6) states by DOP853, with a constant acceleration in each interval."""
    states = [start]
    for push in pushes:

        def rate(_: float, y: FloatArray, push: FloatArray = push) -> FloatArray:
            pull = -gm * y[:3] / np.linalg.norm(y[:3]) ** 3
            return np.concatenate([y[3:], pull + light + push])

        states.append(solve_ivp(rate, (0.0, INTERVAL_S), states[-1], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1])
    return np.array(states)


@dataclass(frozen=True)
class OrbitTruth(Truth):
    """Besides the positions in the body frame: (n, 6) inertial states, and the parameters."""

    states: FloatArray
    gm: float


def make_orbit_sequence(
    rng: np.random.Generator, recipe: Recipe, drive: Drive = Drive()
) -> tuple[TrackSequence, OrbitTruth]:
    """True forces are GM and LIGHT; their prior values have errors drawn by their standard deviations."""
    start = np.array([ORBIT_M, 0.0, 0.0, 0.0, ORBIT_M * RATE, 0.0])
    states = flown(start, GM, LIGHT, drive.noise_m_s2 * rng.standard_normal((recipe.frames - 1, 3)))
    times = INTERVAL_S * np.arange(recipe.frames)
    turns = Rotation.from_rotvec(-SPIN * times[:, None] * drive.spinning).as_matrix()
    sequence, truth = sequence_along(rng, np.einsum("fij,fj->fi", turns, states[:, :3]), recipe)
    frames = [
        replace(frame, time_s=float(time), R_body_inertial=turn)
        for frame, time, turn in zip(sequence.frames, times, turns, strict=True)
    ]
    gm_error, light_error = rng.standard_normal(2) * [drive.gm_sigma, drive.radiation_sigma]
    forces = Forces(
        gm_m3_s2=GM * (1.0 + gm_error),
        gm_sigma_m3_s2=GM * drive.gm_sigma,
        radiation_m_s2=LIGHT * (1.0 + light_error),
        radiation_sigma_m_s2=float(np.linalg.norm(LIGHT)) * drive.radiation_sigma,
        noise_m_s2=drive.noise_m_s2,
        velocity_m_s=start[3:] + drive.velocity_sigma_m_s * rng.standard_normal(3),
        velocity_covariance_m2_s2=drive.velocity_sigma_m_s**2 * np.eye(3),
    )
    truth = OrbitTruth(truth.positions_m, truth.points_m, states, GM)
    return replace(sequence, frames=tuple(frames), forces=forces), truth
