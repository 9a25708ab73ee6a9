"""The covariance of a pose by the errors of the camera's calibration."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.load import load_scenario
from boresight.scenarios.observation import CameraSigma, Frame, Observation

CAMERA = Camera(1500.0, 1600.0, 511.5, 383.5, 1024, 768)
POSE = Pose(np.eye(3), np.array([30.0, -20.0, 2000.0]))


def observation(sigma: CameraSigma) -> Observation:
    frame = Frame(np.zeros((768, 1024), np.float32), np.array([0.0, 0.0, -1.0]), POSE, np.eye(6))
    return Observation(CAMERA, frame, sigma)


def test_an_exact_calibration_adds_nothing():
    assert not observation(CameraSigma()).calibration_covariance(POSE).any()


def test_opencv_scatters_as_the_calibration_says():
    # solvePnP with a camera that is wrong by draws: the positions scatter by the stated covariance. The body has no
    # size to speak of, so that turning it does not move its image.
    sigma = CameraSigma(focal=0.003, principal_point_px=0.4)
    rng = np.random.default_rng(4)
    points_m = rng.uniform(-40.0, 40.0, (60, 3))
    seen = points_m + POSE.translation_m
    uv = seen[:, :2] / seen[:, 2:] * [CAMERA.fx_px, CAMERA.fy_px] + [CAMERA.cx_px, CAMERA.cy_px]
    found = []
    for _ in range(400):
        scale, shift = 1.0 + sigma.focal * rng.standard_normal(), sigma.principal_point_px * rng.standard_normal(2)
        matrix = np.array(
            [
                [CAMERA.fx_px * scale, 0.0, CAMERA.cx_px + shift[0]],
                [0.0, CAMERA.fy_px * scale, CAMERA.cy_px + shift[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        _, turn, move = cv2.solvePnP(points_m, uv, matrix, None, np.zeros(3), POSE.translation_m.copy(), True)
        found.append(np.concatenate([turn[:, 0], move[:, 0]]))
    scatter = np.std(found, axis=0)
    stated = np.sqrt(np.diag(observation(sigma).calibration_covariance(POSE)))
    # 400 draws give a standard deviation to 3.5 % (1 sigma).
    np.testing.assert_allclose(scatter[3:], stated[3:], rtol=0.11)
    # What perspective leaves of it in the attitude: 80 m at 2 km.
    assert (scatter[:3] < np.radians(0.1)).all()


def test_a_scenario_states_it_and_refuses_what_cannot_be():
    spec = load_scenario("quickstart", ["onboard.camera_sigma={focal: 0.001, principal_point_px: 0.3}"]).spec
    assert (spec.onboard.camera_sigma.focal, spec.onboard.camera_sigma.principal_point_px) == (0.001, 0.3)
    with pytest.raises(BoresightError, match=r"onboard\.camera_sigma\.focal"):
        load_scenario("quickstart", ["onboard.camera_sigma={focal: -0.001}"])
