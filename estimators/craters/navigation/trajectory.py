"""The input of the navigation chain, and the trajectory that its images get their prior poses from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.contract import CraterDetections, CraterImage
from boresight.estimators.orbit.contract import Orbit
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.dynamics.propagation import PiecewiseAcceleration, propagate_partials
from boresight.scenarios.geometry import Pose, cross_matrix
from boresight.scenarios.observation import Frame
from boresight.scenarios.orbits.data import Knowledge, Radiometry
from boresight.scenarios.sequences.ground import MeshGround


@dataclass(frozen=True, slots=True, eq=False)
class AprioriShape:
    """The shape that landmarks are located on, in axes whose origin need not be the centre of mass.

    ``centre_of_mass_m`` (3,) is in the same axes; ``height_sigma_m`` is the standard deviation of the shape's height.
    """

    ground: MeshGround
    centre_of_mass_m: FloatArray
    height_sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """An image with its craters and its attitude; its position comes from the trajectory.

    ``time_s`` is relative to the epoch of the orbit, ``R_cam_inertial`` (3, 3) the telemetered attitude,
    ``sun_dir_cam`` (3,) the unit vector towards the Sun; ``pixels`` are (H, W).
    """

    number: int
    time_s: float
    R_cam_inertial: FloatArray
    sun_dir_cam: FloatArray
    pixels: NDArray[np.float32]
    detections: CraterDetections


@dataclass(frozen=True, slots=True, eq=False)
class NavigationTask:
    """The input of the chain other than the images; ``knowledge`` and ``radiometry`` are as in `OrbitData`.

    ``wanted_s`` (E,) are the times at which the orbit is wanted; later than the last image for a prediction.
    """

    knowledge: Knowledge
    shape: AprioriShape
    radiometry: Radiometry | None
    wanted_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Positions (n, 3) and covariances (n, 3, 3) at ascending times (n,), about the centre of mass, inertial axes.

    ``by_common_m`` (n, 3, s) is the effect on the positions of s errors of unit variance that are the same at all
    times: the part of their covariances that is correlated between times.
    """

    times_s: FloatArray
    positions_m: FloatArray
    covariances_m2: FloatArray
    by_common_m: FloatArray

    @classmethod
    def a_priori(cls, knowledge: Knowledge, times_s: FloatArray) -> Trajectory:
        """Propagate the a priori orbit, with the errors of the state at the epoch, of GM and of the solar pressure.

        Raise OrbitLostError if the a priori orbit hits the body.
        """
        flown = propagate_partials(
            knowledge.field, knowledge.state, times_s, PiecewiseAcceleration.none(float(times_s[-1]))
        )
        # The errors of state, GM and solar pressure are constants of the arc: times their partials, they are the common
        # errors, and the covariance is the sum of their squares.
        sigma = np.repeat([knowledge.position_sigma_m, knowledge.velocity_sigma_m_s], 3)
        forces = flown.by_parameters[:, :3, :2] * [knowledge.gm_sigma, knowledge.light_sigma]
        spread = np.concatenate([flown.by_state[:, :3] * sigma, forces], axis=2)
        return cls(times_s, flown.states[:, :3], np.asarray(spread @ np.swapaxes(spread, 1, 2)), spread)

    @classmethod
    def from_orbit(cls, orbit: Orbit, times_s: FloatArray, wanted_s: FloatArray, inflation: float) -> Trajectory:
        """Take the positions of an orbit at ``times_s``, which are among the times ``wanted_s`` it was computed for.

        ``inflation`` multiplies its covariance: the chi-square per degree of freedom of a solution whose residuals are
        larger than expected.
        """
        rows = np.searchsorted(wanted_s, times_s)
        # An orbit estimate has no covariance between times: its errors count as independent between images.
        covariances = inflation * orbit.position_covariances_m2[rows]
        return cls(times_s, orbit.positions_m[rows], covariances, np.zeros((len(rows), 3, 0)))


def images_along_trajectory(
    exposures: Sequence[Exposure], trajectory: Trajectory, task: NavigationTask
) -> list[CraterImage]:
    """Give each image its prior pose; the trajectory has one position for each exposure, in their order."""
    turns, known = task.knowledge.field.rotation.at(trajectory.times_s), task.knowledge
    images = []
    for i, (exposure, turn, position) in enumerate(zip(exposures, turns, trajectory.positions_m, strict=True)):
        attitude = exposure.R_cam_inertial
        rotation = attitude @ turn.T
        # The position is about the centre of mass, the shape about its own origin: t = -R (c + centre of mass).
        pose = Pose(rotation, -rotation @ (turn @ position + task.shape.centre_of_mass_m))
        by_turn, by_place = _by_turn(pose), np.vstack([np.zeros((3, 3)), -attitude])
        # Independent attitude error and common misalignment, both rotations of the camera, and the position.
        covariance = (known.attitude_sigma_rad**2 + known.misalignment_sigma_rad**2) * by_turn @ by_turn.T
        covariance += by_place @ trajectory.covariances_m2[i] @ by_place.T
        common = np.hstack([known.misalignment_sigma_rad * by_turn, by_place @ trajectory.by_common_m[i]])
        frame = Frame(exposure.pixels, exposure.sun_dir_cam, pose, covariance, exposure.time_s)
        images.append(CraterImage(exposure.number, frame, known.camera, exposure.detections, common))
    return images


def _by_turn(pose: Pose) -> FloatArray:
    """Return (6, 3) the error of `Pose.perturbed` caused by a rotation w of the camera about itself.

    With x = R p + t it rotates t too, by w x t.
    """
    return np.vstack([np.eye(3), -cross_matrix(pose.translation_m)])
