"""The closed-form pose: EPnP of Lepetit, Moreno-Noguer and Fua (2009), by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from estimators.landmark.pose.problem import PoseProblem
from scenarios.geometry import Pose, pixel_to_opencv


def solve_epnp(problem: PoseProblem) -> Pose | None:
    """Solve for the pose without a first guess.

    Returns
    -------
    T_cam_body, or None where there is no solution with all landmarks in front of the camera.
    """
    camera = problem.camera
    matrix = camera.matrix
    matrix[:2, 2] = pixel_to_opencv(matrix[:2, 2])
    found, rotation_vector, translation = cv2.solvePnP(
        problem.points_body_m, pixel_to_opencv(problem.uv_px), matrix, None, flags=cv2.SOLVEPNP_EPNP
    )
    if not found or not (np.isfinite(rotation_vector).all() and np.isfinite(translation).all()):
        return None
    pose = Pose(cv2.Rodrigues(rotation_vector)[0], translation.ravel())
    return pose if (pose.transform(problem.points_body_m)[:, 2] > 0.0).all() else None
