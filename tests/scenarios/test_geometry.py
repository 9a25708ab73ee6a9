"""Geometry against OpenCV, scipy, trimesh and closed forms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import (
    Camera,
    Pose,
    TriangleMesh,
    View,
    look_at,
    pixel_from_opencv,
    pixel_to_opencv,
)
from boresight.scenarios.geometry.camera import LinesOfSight, triangulation_equations
from boresight.scenarios.geometry.pose import FrameMismatchError
from boresight.scenarios.spec.camera import CameraSpec

CAMERA = Camera(640, 480, 700.0, 710.0, 318.0, 243.0)


def random_pose(rng: np.random.Generator) -> Pose:
    return Pose(Rotation.random(rng=rng).as_matrix(), np.array([0.1, -0.2, 9.0]) + rng.normal(0, 0.1, 3))


def test_projection_agrees_with_opencv():
    rng = np.random.default_rng(1)
    pose = random_pose(rng)
    points = rng.uniform(-1, 1, (50, 3))
    principal = pixel_to_opencv(np.array([CAMERA.cx_px, CAMERA.cy_px]))
    matrix = CAMERA.matrix
    matrix[:2, 2] = principal
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(pose.rotation)[0], pose.translation_m, matrix, None)
    ours = CAMERA.project(pose.transform(points))
    np.testing.assert_allclose(ours, pixel_from_opencv(expected[:, 0]), atol=1e-9)


def test_a_field_of_view_is_that_across_the_width():
    camera = CameraSpec(width_px=640, height_px=480, fov_deg=30.0).camera()
    across_deg, down_deg, *_, aspect = cv2.calibrationMatrixValues(camera.matrix, (640, 480), 1.0, 1.0)
    assert (across_deg, aspect) == pytest.approx((30.0, 1.0))
    assert down_deg < across_deg


def test_points_behind_the_camera_have_no_pixel():
    assert np.isnan(CAMERA.project(np.array([0.0, 0.0, -1.0]))).all()


def test_the_papers_pixel_scale():
    # Section 4.2: 18.3 deg over 512 px at 2 km less the body's radius of 200 m is about 1.13 m a pixel.
    camera = Camera.from_fov(512, 512, np.radians(18.3))
    assert 1800.0 * camera.pixel_angle_rad == pytest.approx(1.13, abs=0.01)


def test_quaternion_order_agrees_with_the_papers_matrix():
    q0, q1, q2, q3 = quat = np.array([0.8, 0.2, -0.4, 0.4])
    printed = np.array(  # eq. (8)
        [
            [q0**2 + q1**2 - q2**2 - q3**2, 2 * q1 * q2 - 2 * q0 * q3, 2 * q1 * q3 + 2 * q0 * q2],
            [2 * q1 * q2 + 2 * q0 * q3, q0**2 - q1**2 + q2**2 - q3**2, 2 * q2 * q3 - 2 * q0 * q1],
            [2 * q1 * q3 - 2 * q0 * q2, 2 * q2 * q3 + 2 * q0 * q1, q0**2 - q1**2 - q2**2 + q3**2],
        ]
    )
    pose = Pose.from_quat_wxyz(quat, np.zeros(3))
    np.testing.assert_allclose(pose.rotation, printed, atol=1e-12)
    np.testing.assert_allclose(pose.quat_wxyz, quat, atol=1e-12)


def test_chained_and_inverse_transforms():
    rng = np.random.default_rng(3)
    T_cam_body = random_pose(rng)
    T_body_inertial = Pose(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), "body", "inertial")
    point = rng.normal(size=(4, 3))
    chained = T_cam_body @ T_body_inertial
    np.testing.assert_allclose(chained.transform(point), T_cam_body.transform(T_body_inertial.transform(point)))
    np.testing.assert_allclose((chained.inverse() @ chained).rotation, np.eye(3), atol=1e-12)
    with pytest.raises(FrameMismatchError, match="body is not inertial"):
        _ = T_cam_body @ T_body_inertial.inverse()


def test_look_at_points_the_boresight_at_the_origin():
    rng = np.random.default_rng(4)
    for position in [*rng.normal(size=(10, 3)) * 1e3, np.array([0, 0, 5.0]), np.array([0, 0, -5.0])]:
        pose = look_at(position, roll_rad=0.7)
        np.testing.assert_allclose(pose.translation_m, [0, 0, np.linalg.norm(position)], atol=1e-9)
        np.testing.assert_allclose(pose.camera_position_m, position, atol=1e-9)
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


def test_north_is_up_at_zero_roll_and_roll_turns_the_camera():
    up = look_at(np.array([100.0, 0, 0]))
    assert up.transform(np.array([0, 0, 1.0]))[1] < 0
    rolled = look_at(np.array([100.0, 0, 0]), roll_rad=np.radians(30))
    assert np.degrees(up.angle_to(rolled)) == pytest.approx(30)


def test_a_camera_at_the_origin_is_refused():
    with pytest.raises(BoresightError, match="range above 0"):
        look_at(np.zeros(3))


def test_perturbed_keeps_rotation_and_translation_apart():
    pose = look_at(np.array([2000.0, 0, 0]))
    turned = pose.perturbed(np.array([0, np.radians(2), 0]), np.zeros(3))
    np.testing.assert_array_equal(turned.translation_m, pose.translation_m)
    assert np.degrees(pose.angle_to(turned)) == pytest.approx(2)


def test_phase_angle():
    view = View(CAMERA, look_at(np.array([100.0, 0, 0])), np.array([1.0, 1.0, 0]))
    assert np.degrees(view.phase_angle_rad) == pytest.approx(45)
    assert np.linalg.norm(view.sun_dir_body) == pytest.approx(1)
    with pytest.raises(BoresightError, match="direction to the Sun"):
        View(CAMERA, look_at(np.array([100.0, 0, 0])), np.zeros(3))


@pytest.mark.parametrize("rows_at_once", [7, 1 << 19])
def test_mesh_quantities_agree_with_trimesh(monkeypatch, rows_at_once):
    monkeypatch.setattr("boresight.scenarios.geometry.mesh._ROWS_AT_ONCE", rows_at_once)
    foreign = trimesh.creation.torus(3.0, 1.0)
    mesh = TriangleMesh(foreign.vertices, foreign.faces)
    np.testing.assert_allclose(mesh.areas_m2, foreign.area_faces, rtol=1e-9)
    np.testing.assert_array_equal(mesh.normals_of(np.array([5, 0])), mesh.normals[[5, 0]])
    assert mesh.volume_m3 == pytest.approx(foreign.volume)
    np.testing.assert_allclose(mesh.normals, foreign.face_normals, atol=1e-9)
    np.testing.assert_allclose(mesh.extent_m, foreign.extents)


def test_a_mesh_refuses_a_face_without_vertex():
    with pytest.raises(BoresightError, match="names vertex 3"):
        TriangleMesh(np.eye(3), np.array([[0, 1, 3]]))


def test_values_are_frozen():
    mesh = TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices_m[0, 0] = 1.0
    # A method shares the mesh with the truth: it cannot allow itself to write either.
    for array in (mesh.vertices_m, mesh.faces, mesh.area_vectors_m2, mesh.normals):
        assert not array.flags.writeable
        with pytest.raises(ValueError, match="cannot set WRITEABLE flag"):
            array.setflags(write=True)
    mesh.corners_m[:] = 0.0
    np.testing.assert_array_equal(mesh.corners_m, [np.eye(3)])


# --- Triangulation from lines of sight: exact points, scipy's least squares, and the covariance of drawn lines -------


NO_PRIOR = np.zeros((2, 3, 3)), np.zeros((2, 3))


def lines_to(points: np.ndarray, rows: np.ndarray, rng: np.random.Generator) -> LinesOfSight:
    """Aim a line from a random place at each point."""
    origins = rng.normal(0.0, 1000.0, (len(rows), 3))
    rays = points[rows] - origins
    return LinesOfSight(origins, rays / np.linalg.norm(rays, axis=1, keepdims=True))


def test_lines_that_meet_give_their_points_and_have_no_distance_from_them():
    rng = np.random.default_rng(1)
    points, rows = rng.normal(0.0, 100.0, (2, 3)), np.array([0, 1, 0, 1, 0])
    lines = lines_to(points, rows, rng)
    matrix, right = triangulation_equations(lines, rows, NO_PRIOR)
    np.testing.assert_allclose(np.linalg.solve(matrix, right[..., None])[..., 0], points, atol=1e-9)
    np.testing.assert_allclose(lines.distances(points[rows]), 0.0, atol=1e-9)


def test_weighted_lines_with_a_prior_give_the_least_squares_of_scipy():
    rng = np.random.default_rng(2)
    rows = np.zeros(6, dtype=np.int64)
    lines = lines_to(rng.normal(0.0, 100.0, (6, 3)), np.arange(6), rng)
    weight, prior_m, prior_sigma_m = rng.uniform(0.5, 2.0, 6), np.array([10.0, -20.0, 30.0]), 50.0

    def residuals(point: np.ndarray) -> np.ndarray:
        offsets = point - lines.origins_m
        across = offsets - np.sum(offsets * lines.directions, axis=1)[:, None] * lines.directions
        return np.concatenate([(np.sqrt(weight)[:, None] * across).ravel(), (point - prior_m) / prior_sigma_m])

    held = np.eye(3)[None] / prior_sigma_m**2
    matrix, right = triangulation_equations(lines, rows, (held, prior_m[None] / prior_sigma_m**2), [weight])
    found = np.linalg.solve(matrix[0], right[0])
    expected = least_squares(residuals, prior_m, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_inverse_matrix_is_the_covariance_of_points_from_noisy_lines():
    rng = np.random.default_rng(3)
    point, rows, sigma_m = np.zeros((1, 3)), np.zeros(4, dtype=np.int64), 2.0
    lines = lines_to(point, rows, rng)
    none = np.zeros((1, 3, 3)), np.zeros((1, 3))
    found = []
    for _ in range(4000):
        shifted = LinesOfSight(lines.origins_m + rng.normal(0.0, sigma_m, (4, 3)), lines.directions)
        matrix, right = triangulation_equations(shifted, rows, none, [np.full(4, sigma_m**-2.0)])
        found.append(np.linalg.solve(matrix[0], right[0]))
    np.testing.assert_allclose(np.cov(np.array(found).T), np.linalg.inv(matrix[0]), atol=0.4)
