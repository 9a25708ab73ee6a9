"""The paper's frames against what its section 3.1 says of them, and against scipy."""

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.sequences.trajectory import R_PAPER_CAMERA, first_camera_from_inertial, inertial_from_body


def test_body_and_inertial_axes_differ_by_the_body_s_rotation():
    turns = Rotation.random(4, rng=np.random.default_rng(2))  # x_body = R x_inertial
    inertial = np.random.default_rng(3).normal(size=(4, 3))
    np.testing.assert_allclose(inertial_from_body(turns.apply(inertial), turns.as_matrix()), inertial, atol=1e-14)


def test_the_first_camera_is_the_origin_of_its_frame_and_axes_stay():
    path = np.random.default_rng(4).normal(size=(5, 3))
    moved = first_camera_from_inertial(path, path[0])
    np.testing.assert_array_equal(moved[0], np.zeros(3))
    np.testing.assert_allclose(moved[3] - moved[1], path[3] - path[1], atol=1e-15)


def test_the_paper_s_camera_has_x_along_the_vertical_y_along_the_horizontal_and_z_ahead():
    assert np.linalg.det(R_PAPER_CAMERA) == 1.0  # right-handed
    camera = Camera(width_px=100, height_px=80, fx_px=90.0, fy_px=90.0, cx_px=50.0, cy_px=40.0)
    pose = Pose(np.eye(3), np.zeros(3))
    for paper_axis, image_axis in ((0, 1), (1, 0)):  # x of the paper moves rows alone, y columns alone
        point = R_PAPER_CAMERA.T @ (5.0 * np.eye(3)[2] + 0.1 * np.eye(3)[paper_axis])
        offset = camera.project(pose.transform(point[None]))[0] - [50.0, 40.0]
        assert np.flatnonzero(np.abs(offset) > 1e-9).tolist() == [image_axis]
    np.testing.assert_array_equal(R_PAPER_CAMERA @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
