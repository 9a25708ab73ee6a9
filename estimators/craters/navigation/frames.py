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
    turns, known = task.knowledge.field.rotation.at(trajectory.times_s), task.knowledge
    images = []
    for i, (exposure, turn, position) in enumerate(zip(exposures, turns, trajectory.positions_m, strict=True)):
        attitude = exposure.R_cam_inertial
        rotation = attitude @ turn.T
        pose = Pose(rotation, -rotation @ (turn @ position + task.shape.centre_of_mass_m))
        by_turn, by_place = _by_turn(pose), np.vstack([np.zeros((3, 3)), -attitude])
        covariance = (known.attitude_sigma_rad**2 + known.misalignment_sigma_rad**2) * by_turn @ by_turn.T
        covariance += by_place @ trajectory.covariances_m2[i] @ by_place.T
        common = np.hstack([known.misalignment_sigma_rad * by_turn, by_place @ trajectory.by_common_m[i]])
        frame = Frame(exposure.pixels, exposure.sun_dir_cam, pose, covariance, exposure.time_s)
        images.append(CraterImage(exposure.number, frame, known.camera, exposure.detections, common))
    return images


def _by_turn(pose: Pose) -> FloatArray:
    """(6, 3) `Pose.perturbed`'s error by a turn w of the camera about itself: x = R p + t, so that t moves by w x t."""
    return np.vstack([np.eye(3), -cross_matrix(pose.translation_m)])
