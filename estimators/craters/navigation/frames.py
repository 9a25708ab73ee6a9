"""Images with the poses that a trajectory and telemetry give them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimators.craters.contract import CraterImage
from estimators.craters.navigation.task import Exposure, NavigationTask
from estimators.craters.navigation.trajectory import Trajectory
from scenarios.geometry import Pose, cross_matrix
from scenarios.observation import Frame

FloatArray = NDArray[np.float64]


def placed_images(exposures: Sequence[Exposure], trajectory: Trajectory, task: NavigationTask) -> list[CraterImage]:
    """Give each image the pose of its time; the trajectory has one place for each, in their order."""
    turns = task.knowledge.field.rotation.at(trajectory.times_s)
    images = []
    for exposure, turn, position, covariance in zip(
        exposures, turns, trajectory.positions_m, trajectory.covariances_m2, strict=True
    ):
        rotation = exposure.R_cam_inertial @ turn.T
        pose = Pose(rotation, -rotation @ (turn @ position + task.shape.centre_of_mass_m))
        spread = _pose_covariance(pose, exposure.R_cam_inertial, covariance, task)
        frame = Frame(exposure.pixels, exposure.sun_dir_cam, pose, spread, exposure.time_s)
        images.append(CraterImage(exposure.number, frame, task.knowledge.camera, exposure.detections))
    return images


def _pose_covariance(
    pose: Pose, R_cam_inertial: FloatArray, position_covariance_m2: FloatArray, task: NavigationTask
) -> FloatArray:
    """(6, 6) of `Pose.perturbed`'s error: a turn w of the camera about itself, and a shift dr of its place.

    With x = R p + t in camera axes, the turn takes t to t + w x t, and the shift to t - R_cam_inertial dr.
    """
    known = task.knowledge
    turn = (known.attitude_sigma_rad**2 + known.misalignment_sigma_rad**2) * np.eye(3)
    by_turn = np.vstack([np.eye(3), -cross_matrix(pose.translation_m[None])[0]])
    covariance = by_turn @ turn @ by_turn.T
    covariance[3:, 3:] += R_cam_inertial @ position_covariance_m2 @ R_cam_inertial.T
    return np.asarray(covariance)
