"""The pose by craters, on detections from exact geometry, and against a least-squares solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from crater_looks import CAMERA, RANGE_M, ellipsoid, look, population, turned
from scipy.optimize import least_squares

from boresight.campaign.kinds.single_image import check
from boresight.estimators.contract import Estimate
from boresight.estimators.craters.contract import CraterDetections
from boresight.estimators.craters.database.build import triangulate_landmarks
from boresight.estimators.craters.database.files import CraterDatabase
from boresight.estimators.craters.database.landmarks import Landmarks, SequencePicture
from boresight.estimators.craters.matching.association import CraterAssociationOptions
from boresight.estimators.craters.pose import CraterPose, CraterPoseOptions, expected_craters
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, Pose, View, look_at, project_circles
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.craters import DetectionErrorSpec

ERRORS = DetectionErrorSpec(height_m=0.0)


class Found:
    """A detector that returns given detections."""

    def __init__(self, rims: Ellipses) -> None:
        self.rims = rims

    def detect(self, frame: Frame, camera: object) -> CraterDetections:
        if not np.isfinite(frame.image).all():
            raise BoresightError("the image holds NaN")
        return CraterDetections(self.rims, np.ones(len(self.rims)))


@pytest.fixture(scope="module")
def world():
    ground = ellipsoid()
    craters = population(ground, 3)
    n = len(craters)
    landmarks = Landmarks(
        np.arange(n),
        craters.centre_body_m + np.random.default_rng(7).normal(0.0, 5.0, (n, 3)),
        craters.normal_body,
        craters.radius_m,
        np.broadcast_to(25.0 * np.eye(3), (n, 3, 3)),
        np.full(n, 4),
    )
    return ground, craters, landmarks


def _looks(world, count: int, sigma_m: float = 1000.0):
    ground, craters, _ = world
    for seed in range(count):
        rng = np.random.default_rng(seed)
        points, normals = ground.sample(1, rng)
        towards = turned(normals[0], rng.uniform(0.0, 30.0), rng.uniform(0.0, 6.0))
        sun = turned(normals[0], rng.uniform(25.0, 60.0), rng.uniform(0.0, 6.0))
        one = look(seed, ground, craters, points[0], (towards, sun), rng, ERRORS, sigma_m)
        rotation = look_at(RANGE_M * towards).rotation
        yield one, points[0] + RANGE_M * towards, rotation


def _estimator(world, rims: Ellipses, options: CraterPoseOptions | None = None) -> CraterPose:
    ground, _, landmarks = world
    return CraterPose(CraterDatabase((), landmarks), ground.mesh, Found(rims), options or CraterPoseOptions())


def _estimate(world, one, frame: Frame | None = None) -> Estimate:
    rims = one.image.detections.ellipses
    observation = Observation(CAMERA, frame or one.image.frame)
    return _estimator(world, rims).estimate(observation, rng=np.random.default_rng(0))


def test_a_prior_a_kilometre_off_is_brought_within_sixty_metres_across_the_line_of_sight(world) -> None:
    priors, across, failed = [], [], 0
    for one, position, _ in _looks(world, 8):
        if len(one.crater) < 4:
            continue
        estimate = _estimate(world, one)
        priors.append(np.linalg.norm(one.image.frame.prior_T_cam_body.camera_position_m - position))
        if estimate.status != "ok":
            failed += 1
            continue
        offset = estimate.pose.camera_position_m - position
        across.append(np.linalg.norm((estimate.pose.rotation @ offset)[:2]))
        check(estimate)
    assert len(across) >= 5
    assert failed <= 1
    assert np.median(priors) > 1000.0
    # Along it the craters' scale alone tells: the spread of some 150 px over 200 km.
    assert np.median(across) < 60.0


def test_the_pose_is_that_of_a_solver_of_least_squares(world) -> None:
    ground, craters, landmarks = world
    one, _, _ = next(iter(_looks(world, 1)))
    frame, rims, options = one.image.frame, one.image.detections.ellipses, CraterPoseOptions()
    pose, found = _estimator(world, rims).recognise(frame, CAMERA, rims)
    assert found.reason == ""
    rows, expected = expected_craters(landmarks, ground, frame, CAMERA, pose, options)
    couples = [(rows[i], k, expected.noise_px2[i]) for i, k in found.pairs]
    roots = np.array([np.linalg.inv(np.linalg.cholesky(noise)) for _, _, noise in couples])
    prior_root = np.linalg.inv(np.linalg.cholesky(frame.prior_covariance))
    scale = np.sqrt(np.diag(frame.prior_covariance))

    def residuals(x: np.ndarray) -> np.ndarray:
        moved = frame.prior_T_cam_body.perturbed((scale * x)[:3], (scale * x)[3:])
        view = View(CAMERA, moved, np.array([0.0, 0.0, 1.0]))
        ids = np.array([row for row, _, _ in couples])
        seen = project_circles(
            view, landmarks.position_body_m[ids], landmarks.normal_body[ids], landmarks.radius_m[ids]
        )
        left = rims.centre_px[[k for _, k, _ in couples]] - seen.centre_px
        return np.concatenate([np.einsum("nij,nj->ni", roots, left).ravel(), prior_root @ (scale * x)])

    solved = least_squares(residuals, np.zeros(6), x_scale=0.1)
    best = frame.prior_T_cam_body.perturbed((scale * solved.x)[:3], (scale * solved.x)[3:])
    assert np.linalg.norm(best.camera_position_m - pose.camera_position_m) < 5.0
    assert len(found.pairs) >= 3
    assert len(craters) == len(landmarks)


def test_images_without_craters_fail_with_a_reason(world) -> None:
    one, _, _ = next(iter(_looks(world, 1)))
    empty = replace(one, image=replace(one.image, detections=CraterDetections.none()))
    assert "no crater was detected" in _estimate(world, empty).reason
    lone = replace(one, image=replace(one.image, detections=CraterDetections(
        one.image.detections.ellipses[:1], np.ones(1)
    )))  # fmt: skip
    failed = _estimate(world, lone)
    assert failed.status == "failed"
    assert failed.reason
    image = np.full_like(one.image.frame.image, np.nan)
    broken = _estimate(world, one, replace(one.image.frame, image=image))
    assert broken.reason == "the image holds NaN"


def _pictures(
    true: np.ndarray, normals: np.ndarray, radii: np.ndarray, angles: tuple[float, ...]
) -> list[SequencePicture]:
    """Make pictures with exact centres of the rims at ``true`` from several directions."""
    pictures = []
    for number, angle in enumerate(angles):
        position = true[0] + RANGE_M * turned(np.array([0.0, 0.0, 1.0]), angle, 1.0)
        rotation = look_at(position - true[0]).rotation
        pose = Pose(rotation, -rotation @ position)
        view = View(CAMERA, pose, np.array([0.0, 0.0, 1.0]))
        seen = CAMERA.project(pose.transform(true))
        rims = project_circles(view, true, normals, radii)
        exact = Ellipses(seen, rims.semi_axes_px, rims.angle_rad)
        pictures.append(SequencePicture(number, 0.0, CAMERA, pose, np.array([0.0, 0.0, -1.0]), np.arange(2), exact))
    return pictures


TRUE_M = np.array([[0.0, 0.0, 6e3], [900.0, 300.0, 6.1e3]])
NORMALS, RADII_M = np.tile([0.0, 0.0, 1.0], (2, 1)), np.array([300.0, 400.0])


def _landmarks(position_m: np.ndarray, images: int) -> Landmarks:
    covariance = np.broadcast_to(400.0 * np.eye(3), (2, 3, 3))
    return Landmarks(np.arange(2), position_m, NORMALS, RADII_M, covariance, np.full(2, images))


def test_triangulation_meets_exact_lines_of_sight_whatever_the_shape_said() -> None:
    pictures = _pictures(TRUE_M, NORMALS, RADII_M, (0.0, 15.0, 30.0))
    wrong = _landmarks(TRUE_M + np.random.default_rng(3).normal(0.0, 20.0, (2, 3)), 3)
    moved = triangulate_landmarks(CraterDatabase(tuple(pictures), wrong), 1e4, CraterAssociationOptions()).landmarks
    np.testing.assert_allclose(moved.position_body_m, TRUE_M, atol=0.1)


def test_a_sighting_with_the_number_of_another_crater_does_not_decide_where_a_landmark_lies() -> None:
    pictures = _pictures(TRUE_M, NORMALS, RADII_M, (0.0, 8.0, 15.0, 22.0, 30.0))
    odd = pictures[2].ellipses
    shifted = Ellipses(odd.centre_px + np.array([[9.0, -7.0], [0.0, 0.0]]), odd.semi_axes_px, odd.angle_rad)
    pictures[2] = replace(pictures[2], ellipses=shifted)
    database = CraterDatabase(tuple(pictures), _landmarks(TRUE_M, 5))
    moved = triangulate_landmarks(database, 1e4, CraterAssociationOptions()).landmarks
    mean_shift_m = 19.0 * np.hypot(9.0, 7.0) / 5
    assert np.linalg.norm(moved.position_body_m[0] - TRUE_M[0]) < 0.5 * mean_shift_m
    np.testing.assert_allclose(moved.position_body_m[1], TRUE_M[1], atol=0.1)
