"""Projection, visibility and matching against OpenCV, sampling, trimesh and brute force."""

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import mahalanobis

from boresight.estimators.landmark.matching import inverse_2x2, match_landmarks, squared_distances, weighted_distances
from boresight.estimators.landmark.projection import faces_camera, is_occluded, project_landmarks, visible_landmarks
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, look_at

CAMERA = Camera(640, 480, 900.0, 850.0, 315.0, 250.0)


class Landmarks:
    """The two arrays that a projection reads."""

    def __init__(self, n=60, seed=2):
        rng = np.random.default_rng(seed)
        self.means_m = rng.uniform(-120.0, 120.0, (n, 3))
        factor = rng.normal(size=(n, 3, 3))
        self.covariances_m2 = factor @ np.swapaxes(factor, 1, 2) + 0.2 * np.eye(3)


POSE = look_at(np.array([500.0, -700.0, 400.0]), roll_rad=0.7).perturbed(np.array([0.01, -0.02, 0.0]), np.zeros(3))


def test_means_agree_with_opencv():
    landmarks = Landmarks()
    projection = project_landmarks(landmarks, CAMERA, POSE)
    matrix = CAMERA.matrix
    matrix[:2, 2] -= 0.5  # OpenCV counts from the centre of the first pixel
    expected, _ = cv2.projectPoints(
        landmarks.means_m, cv2.Rodrigues(POSE.rotation)[0], POSE.translation_m, matrix, None
    )
    np.testing.assert_allclose(projection.uv_px - 0.5, expected[:, 0], atol=1e-9)


def test_covariances_agree_with_sampling():
    landmarks = Landmarks(8)
    projection = project_landmarks(landmarks, CAMERA, POSE)
    rng = np.random.default_rng(5)
    n = 40_000
    for mean, covariance, ours in zip(
        landmarks.means_m, landmarks.covariances_m2, projection.covariances_px2, strict=True
    ):
        sample = CAMERA.project(POSE.transform(rng.multivariate_normal(mean, covariance, n)))
        # The sampling error of a variance is sqrt(2 / n) = 0.7 %; 4 % is beyond five of it plus the curvature.
        np.testing.assert_allclose(np.cov(sample.T), ours, atol=0.04 * np.trace(ours) / 2)


def test_a_landmark_behind_the_camera_has_no_pixel():
    landmarks = Landmarks(2)
    landmarks.means_m = np.array([POSE.camera_position_m * 2.0, np.zeros(3)])
    projection = project_landmarks(landmarks, CAMERA, POSE)
    assert np.isnan(projection.uv_px[0]).all()
    assert np.isnan(projection.covariances_px2[0]).all()
    assert np.isfinite(projection.uv_px[1]).all()


def two_lobes():
    """A concave body: two balls on a bar, remeshed by revolving a profile."""
    x = np.linspace(-200.0, 200.0, 31)
    lobe = np.sqrt(np.clip(90.0**2 - (np.abs(x) - 110.0) ** 2, 0.0, None))
    profile = np.column_stack([np.maximum(lobe, np.where(np.abs(x) < 110.0, 30.0, 0.0)), x])
    body = trimesh.creation.revolve(profile, sections=18)
    body.fix_normals()
    return TriangleMesh(np.asarray(body.vertices), np.asarray(body.faces))


MESH = two_lobes()


class EveryTriangle:
    """Stands in for trimesh's search tree, which needs a package of its own: every triangle is a candidate."""

    def __init__(self, body):
        self.count = len(body.faces)
        self.bounds = body.bounds.ravel()

    def intersection(self, bounds):
        del bounds
        return range(self.count)


@pytest.mark.parametrize("direction", [(0.1, 0.05, 1.0), (0.55, 0.1, 0.8), (1.0, -0.4, 0.3), (0.0, 0.3, -1.0)])
def test_visibility_agrees_with_rays_of_trimesh(direction):
    position = 2000.0 * np.array(direction) / np.linalg.norm(direction)
    pose = look_at(position)
    camera = Camera.from_fov(512, 512, np.radians(18.3))
    ours = visible_landmarks(MESH, camera, pose)
    body = trimesh.Trimesh(MESH.vertices_m, MESH.faces, process=False)
    facing = np.zeros(len(MESH.vertices_m), dtype=bool)
    for vertex, faces in enumerate(body.vertex_faces):
        normals = body.face_normals[faces[faces >= 0]]
        facing[vertex] = (normals @ (position - MESH.vertices_m[vertex]) > 0.0).any()
    rays = MESH.vertices_m - position
    triangles, index, _ = trimesh.ray.ray_triangle.ray_triangle_id(
        body.triangles, np.tile(position, (len(rays), 1)), rays, body.face_normals, tree=EveryTriangle(body)
    )
    hidden = np.zeros(len(rays), dtype=bool)
    for triangle, vertex in zip(triangles, index, strict=True):
        if vertex in MESH.faces[triangle]:
            continue
        corner = MESH.corners_m[triangle]
        normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
        t = normal @ (corner[0] - position) / (normal @ rays[vertex])
        hidden[vertex] |= bool(t < 1.0)
    expected = facing & ~hidden & camera.contains(camera.project(pose.transform(MESH.vertices_m)))
    # Rays that graze an edge shared by two facets may be called either way.
    assert (ours != expected).mean() < 0.01
    assert (facing & hidden).sum() > 20 or direction[0] > 0.9
    assert 50 < ours.sum() < 0.7 * len(ours)


def test_a_wall_hides_what_stands_behind_it():
    cube = trimesh.creation.box((10.0, 10.0, 10.0))
    wall = trimesh.creation.box((40.0, 1.0, 40.0))
    wall.apply_translation((0.0, -30.0, 0.0))
    both = trimesh.util.concatenate([cube, wall])
    mesh = TriangleMesh(np.asarray(both.vertices), np.asarray(both.faces))
    camera = np.array([0.0, -500.0, 0.0])
    cube_front = np.flatnonzero(np.asarray(both.vertices)[:8, 1] < 0.0)
    assert is_occluded(mesh, camera, cube_front).all()
    assert not is_occluded(mesh, -camera, np.flatnonzero(np.asarray(both.vertices)[:8, 1] > 0.0)).any()
    assert is_occluded(mesh, camera, np.empty(0, dtype=np.intp)).shape == (0,)


def test_the_far_side_does_not_face_the_camera():
    ball = trimesh.creation.icosphere(3, 100.0)
    mesh = TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    facing = faces_camera(mesh, np.array([0.0, 0.0, 500.0]))
    height = mesh.vertices_m[:, 2]  # the horizon lies at 100 m * 100 / 500 = 20 m; one facet spans about 15 m
    assert facing[height > 20.0].all()
    assert not facing[height < 0.0].any()


def test_landmarks_outside_the_field_are_not_visible():
    narrow = Camera.from_fov(64, 64, np.radians(3.0))
    visible = visible_landmarks(MESH, narrow, look_at(np.array([0.0, 2000.0, 0.0])))
    uv = narrow.project(look_at(np.array([0.0, 2000.0, 0.0])).transform(MESH.vertices_m))
    assert visible.any()
    assert not visible[(uv < 0.0).any(axis=1) | (uv > 64.0).any(axis=1)].any()


def random_matches(seed, n=40, m=70):
    rng = np.random.default_rng(seed)
    uv = rng.uniform(0.0, 100.0, (n, 2))
    factor = rng.normal(size=(n, 2, 2))
    covariances = factor @ np.swapaxes(factor, 1, 2) + 0.3 * np.eye(2)
    return uv, covariances, rng.random(n) < 0.8, rng.uniform(0.0, 100.0, (m, 2))


@pytest.mark.parametrize("seed", range(3))
def test_matches_agree_with_brute_force(seed):
    uv, covariances, visible, corners = random_matches(seed)
    ours = match_landmarks(uv, covariances, visible, corners)
    distance = {
        (i, j): mahalanobis(corners[j], uv[i], np.linalg.inv(covariances[i])) ** 2
        for i in np.flatnonzero(visible)
        for j in range(len(corners))
    }
    expected = [
        pair
        for pair, d2 in distance.items()
        if d2 < 36.0
        and d2 == min(distance[pair[0], j] for j in range(len(corners)))
        and d2 == min(distance[i, pair[1]] for i in np.flatnonzero(visible))
    ]
    assert list(zip(ours.landmark, ours.corner, strict=True)) == sorted(expected)
    assert len(expected) > 5
    np.testing.assert_allclose(ours.d2, [distance[pair] for pair in sorted(expected)])


def test_the_threshold_is_strict_and_an_option():
    uv, covariances = np.array([[10.0, 10.0]]), np.array([np.eye(2)])
    everything = np.array([True])
    corner = np.array([[16.0, 10.0]])
    assert len(match_landmarks(uv, covariances, everything, corner)) == 0
    assert len(match_landmarks(uv, covariances, everything, corner, 36.1)) == 1
    assert len(match_landmarks(uv, covariances, ~everything, corner, 99.0)) == 0
    assert len(match_landmarks(uv, covariances, everything, np.empty((0, 2)))) == 0


def test_distances_agree_with_each_other_and_with_numpy():
    uv, covariances, _, corners = random_matches(9)
    np.testing.assert_allclose(inverse_2x2(covariances), np.linalg.inv(covariances))
    table = weighted_distances(uv, covariances, corners)
    np.testing.assert_allclose(squared_distances(corners[:40] - uv, covariances), np.diag(table[:, :40]))


def test_the_quaternion_of_equation_8_takes_body_to_camera():
    """Equation (8) by its own formula against the rotation that a quaternion stands for here."""
    rng = np.random.default_rng(6)
    q0, q1, q2, q3 = q = rng.normal(size=4)
    q0, q1, q2, q3 = q / np.linalg.norm(q)
    expected = np.array(
        [
            [q0**2 + q1**2 - q2**2 - q3**2, 2 * q1 * q2 - 2 * q0 * q3, 2 * q1 * q3 + 2 * q0 * q2],
            [2 * q1 * q2 + 2 * q0 * q3, q0**2 - q1**2 + q2**2 - q3**2, 2 * q2 * q3 - 2 * q0 * q1],
            [2 * q1 * q3 - 2 * q0 * q2, 2 * q2 * q3 + 2 * q0 * q1, q0**2 - q1**2 - q2**2 + q3**2],
        ]
    )
    np.testing.assert_allclose(Pose.from_quat_wxyz(q, np.zeros(3)).rotation, expected, atol=1e-12)
