"""The predicted range and the update of a pose with it, against a ray tracer, differences, closed forms, statistics."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.estimators.altimeter import (
    AltimeterEstimator,
    AltimeterOptions,
    boresight_range,
    fuse_range,
    mesh_height_sigma_m,
)
from boresight.estimators.contract import Estimate
from boresight.estimators.landmark.database import LandmarkDatabase
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View, look_at
from boresight.scenarios.observation import Frame, Observation, RangeReading
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera.from_fov(64, 64, 0.3)


def radius_m(directions):
    x, y, z = directions.T
    return 200.0 * (1 + 0.15 * np.sin(5 * x + 2) * np.cos(6 * y) + 0.1 * np.sin(9 * z))


def bumpy(subdivisions=3):
    shape = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    shape.vertices *= radius_m(np.array(shape.vertices))[:, None]
    return shape


def mesh_of(shape):
    return TriangleMesh(np.array(shape.vertices), np.array(shape.faces, dtype=np.int32))


def poses(count, seed=1, off_m=60.0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        direction = rng.normal(size=3)
        pose = look_at(2000.0 * direction / np.linalg.norm(direction), rng.uniform(-3, 3))
        yield pose.perturbed(rng.normal(0, 0.02, 3), rng.normal(0, off_m, 3))


def database(shape, sigma_m=0.5):
    n = len(shape.vertices)
    return LandmarkDatabase(
        np.array(shape.vertices), np.tile(sigma_m**2 * np.eye(3), (n, 1, 1)), np.full(n, 9), np.array(shape.faces)
    )


def test_the_range_is_that_of_the_ray_tracer():
    mesh, hits = mesh_of(bumpy()), 0
    renderer = MitsubaRenderer(mesh, LambertSpec())
    for pose in poses(60, off_m=120.0):
        view = View(CAMERA, pose, np.array([0.0, 0.0, 1.0]))
        traced = renderer.surface(view, np.array([[CAMERA.cx_px, CAMERA.cy_px]]))
        found = boresight_range(MeshGround(mesh), pose)
        assert (found is None) == (not traced.hit[0])
        if found is not None:
            point_m = traced.points_body_m[0]
            assert found.range_m == pytest.approx(np.linalg.norm(point_m - pose.camera_position_m), rel=1e-9)
            np.testing.assert_allclose(found.cos_incidence, -traced.normals_body[0] @ pose.rotation[2])
            hits += 1
    assert 20 < hits < 60


def test_the_gradient_is_that_of_central_differences():
    mesh = mesh_of(bumpy(1))  # facets so large that a small step stays on them
    steps = np.array([1e-7] * 3 + [1e-4] * 3)
    for pose in poses(30):
        found = boresight_range(MeshGround(mesh), pose)
        if found is None or found.cos_incidence < 0.3:
            continue
        numeric = [
            (boresight_range(MeshGround(mesh), pose.perturbed(e[:3], e[3:])).range_m
             - boresight_range(MeshGround(mesh), pose.perturbed(-e[:3], -e[3:])).range_m) / (2.0 * step)
            for step, e in zip(steps, np.diag(steps), strict=True)
        ]  # fmt: skip
        np.testing.assert_allclose(found.gradient, numeric, rtol=2e-5, atol=2e-5 * np.abs(numeric).max())


def test_a_straight_look_at_a_plane_is_the_weighted_mean():
    """Prior z with variance p, range with variance R: the mean weighted by their inverses, variance 1/(1/p + 1/R)."""
    box = trimesh.creation.box(extents=(4000.0, 4000.0, 200.0))
    pose = look_at(np.array([0.0, 0.0, 1100.0]))  # 1000 m above the upper face
    covariance = np.diag([1e-4, 1e-4, 1e-4, 9.0, 9.0, 16.0])
    fused = fuse_range((pose, covariance), RangeReading(1006.0, 3.0), MeshGround(mesh_of(box)), 4.0, adaptive=False)
    R = 3.0**2 + 4.0**2
    assert fused.innovation_m == pytest.approx(6.0)
    assert fused.sigma_m == pytest.approx(5.0)
    assert fused.T_cam_body.translation_m[2] == pytest.approx(1100.0 + 6.0 * 16.0 / (16.0 + R), abs=1e-6)
    np.testing.assert_allclose(fused.covariance[5, 5], 1.0 / (1.0 / 16.0 + 1.0 / R))
    np.testing.assert_allclose(np.delete(np.delete(fused.covariance, 5, 0), 5, 1), np.diag(np.diag(covariance)[:5]))
    np.testing.assert_allclose(np.linalg.inv(fused.covariance), np.linalg.inv(covariance) + fused.information)


def test_the_fused_error_is_what_its_covariance_says():
    """NEES of fusions of exact Gaussians: the mean lies in the 99.9 % band of chi-square with 6 degrees of freedom."""
    box, rng = mesh_of(trimesh.creation.box(extents=(600.0, 500.0, 400.0))), np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * np.array([[0.001]] * 3 + [[3.0]] * 3)
    covariance, nees = root @ root.T, []
    for true in poses(400, seed=2, off_m=0.0):
        found = boresight_range(MeshGround(box), true)
        if found is None or found.cos_incidence < 0.5:
            continue
        start = true.perturbed(*np.split(root @ rng.normal(size=6), 2))
        reading = RangeReading(found.range_m + rng.normal(0, 5.0), 5.0)
        fused = fuse_range((start, covariance), reading, MeshGround(box), 1e-6, adaptive=False)
        turn = Rotation.from_matrix(fused.T_cam_body.rotation @ true.rotation.T).as_rotvec()
        error = np.concatenate([turn, fused.T_cam_body.translation_m - true.translation_m])
        nees.append(error @ np.linalg.solve(fused.covariance, error))
    assert len(nees) > 200
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


def test_a_contradicted_covariance_grows_until_the_innovation_fits():
    pose, box = look_at(np.array([0.0, 0.0, 1100.0])), mesh_of(trimesh.creation.box(extents=(4000.0, 4000.0, 200.0)))
    covariance = np.diag([1e-6, 1e-6, 1e-6, 1.0, 1.0, 1.0])
    agrees = fuse_range((pose, covariance), RangeReading(1002.0, 5.0), MeshGround(box), 1e-3, adaptive=True)
    contradicts = fuse_range((pose, covariance), RangeReading(1020.0, 5.0), MeshGround(box), 1e-3, adaptive=True)
    assert agrees.inflation == 1.0
    assert contradicts.inflation == pytest.approx((20.0**2 - 5.0**2) / 1.0, rel=1e-4)
    assert contradicts.normalised_innovation == pytest.approx(20.0 / np.sqrt(1.0 + 5.0**2), rel=1e-4)
    assert contradicts.T_cam_body.translation_m[2] == pytest.approx(1100 + 20.0 * (1 - 5.0**2 / 20.0**2), rel=1e-6)


def test_an_estimate_that_misses_the_mesh_is_left_alone():
    away = look_at(np.array([0.0, 0.0, 2000.0])).perturbed(np.zeros(3), np.array([900.0, 0.0, 0.0]))
    assert (
        fuse_range((away, np.eye(6)), RangeReading(1800.0, 5.0), MeshGround(mesh_of(bumpy())), 1.0, adaptive=True)
        is None
    )


@pytest.mark.parametrize("subdivisions", [2, 3])
def test_the_height_error_of_a_mesh_is_found_from_its_landmarks(subdivisions):
    """The mesh of a smooth body is off by a quarter of the relief of its landmarks: half is a safe estimate."""
    coarse = bumpy(subdivisions)
    points = trimesh.sample.sample_surface(coarse, 4000, seed=1)[0]
    surface_m = radius_m(points / np.linalg.norm(points, axis=1, keepdims=True))
    error_m = np.sqrt(np.mean((surface_m - np.linalg.norm(points, axis=1)) ** 2))
    predicted_m = mesh_height_sigma_m(database(coarse, sigma_m=0.01))
    assert 1.0 < predicted_m / error_m < 2.5


def test_the_height_error_of_a_smooth_mesh_is_the_scatter_of_its_landmarks():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    assert mesh_height_sigma_m(database(sphere, sigma_m=0.7)) == pytest.approx(0.7, rel=1e-4)


class Base:
    """An estimator that returns a fixed pose and covariance, on the landmarks of a body."""

    name, version = "base", 1

    def __init__(self, answer):
        self.answer = answer
        self.database = database(bumpy())

    def estimate(self, observation, *, rng):
        return self.answer


def observation(reading):
    pose = look_at(np.array([0.0, 0.0, 2000.0]))
    frame = Frame(np.zeros((64, 64), np.float32), np.array([0.0, 0.0, -1.0]), pose, np.eye(6), altimeter=reading)
    return Observation(CAMERA, frame)


@pytest.mark.parametrize("reading", [None, RangeReading(1800.0, 5.0)])
def test_the_estimator_uses_a_reading_where_there_is_one(reading):
    pose, covariance = look_at(np.array([0.0, 0.0, 2000.0])), np.diag([1e-6] * 3 + [9.0] * 3)
    base = Base(Estimate("ok", pose=pose, covariance=covariance, bound=0.5 * covariance))
    estimator = AltimeterEstimator(base, base.database, AltimeterOptions())
    estimate = estimator.estimate(observation(reading), rng=np.random.default_rng(0))
    assert [stage.name for stage in estimate.stages] == ["range"]
    assert estimate.diagnostics["range_used"] == (reading is not None)
    moved = estimate.pose.translation_m[2] - pose.translation_m[2]
    if reading is None:
        assert moved == 0.0
        assert estimate.covariance is covariance
        return
    assert moved * estimate.diagnostics["range_innovation_m"] > 0.0
    assert np.linalg.eigvalsh(0.5 * covariance - estimate.bound).min() > -1e-12
    assert estimate.bound[5, 5] < 4.5


@pytest.mark.parametrize(
    "answer", [Estimate("failed", "no landmarks"), Estimate("ok", pose=Pose(np.eye(3), np.array([0.0, 0.0, 9.0])))]
)
def test_what_the_base_cannot_say_fails(answer):
    base = Base(answer)
    estimator = AltimeterEstimator(base, base.database, AltimeterOptions())
    estimate = estimator.estimate(observation(RangeReading(1800.0, 5.0)), rng=np.random.default_rng(0))
    assert estimate.status == "failed"
    assert estimate.reason in {"no landmarks", "the base gives no covariance to weigh the range with"}
    assert estimate.pose is None


@pytest.mark.parametrize(
    ("base", "why"), [("landmark-altimeter", "count twice"), ("prior", "prior has no landmark data base")]
)
def test_a_base_that_cannot_be_is_refused(base, why):
    with pytest.raises(BoresightError, match=why):
        AltimeterEstimator.from_options({"base": base}, assets=None)
