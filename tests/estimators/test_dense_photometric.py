"""Photometric alignment with real renderings of the embedded body."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from boresight.estimators.contract import Estimate, Stopwatch
from boresight.estimators.dense import gauss_newton
from boresight.estimators.dense.gauss_newton import (
    LevelOptions,
    available_gradient,
    band_pass,
    fit_level,
    inverse,
    reduced_camera,
    reduced_image,
    register,
    saturation,
)
from boresight.estimators.dense.photometric import PhotometricEstimator, PhotometricOptions, registration_aligner
from boresight.estimators.landmark.alignment import MeshView
from boresight.estimators.landmark.pose.posterior import PosePrior
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies.embedded import EMBEDDED
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, look_at
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera.from_fov(128, 128, np.radians(18.3))
TRUE = look_at(np.array([1500.0, 900.0, 970.0]), 0.4)
SUN_CAM = np.array([0.5, 0.2, -0.84]) / np.linalg.norm([0.5, 0.2, -0.84])
PRIOR_SIGMAS = np.array([0.012, 0.012, 0.012, 29.0, 29.0, 3.0])
OPTIONS = PhotometricOptions(levels=(LevelOptions(reduction=2, iterations=6), LevelOptions(reduction=1, iterations=6)))


@pytest.fixture(scope="module")
def renderer() -> MitsubaRenderer:
    return MitsubaRenderer(
        EMBEDDED["contact-binary"](), LambertSpec(), samples_per_pixel=4, shading="flat", variant=choose_variant()
    )


@pytest.fixture(scope="module")
def image(renderer: MitsubaRenderer) -> np.ndarray:
    return renderer.render(View(CAMERA, TRUE, TRUE.rotation.T @ SUN_CAM))


def frame(image: np.ndarray, seed: int = 1) -> Frame:
    error = np.random.default_rng(seed).normal(0.0, PRIOR_SIGMAS)
    return Frame(image, SUN_CAM, TRUE.perturbed(error[:3], error[3:]), np.diag(PRIOR_SIGMAS**2))


def estimate(renderer: MitsubaRenderer, frame: Frame, options: PhotometricOptions = OPTIONS):
    estimator = PhotometricEstimator(renderer, 200.0, options)
    return estimator.estimate(Observation(CAMERA, frame), rng=np.random.default_rng(0))


def errors(pose: Pose) -> tuple[float, float]:
    return float(np.linalg.norm(pose.translation_m - TRUE.translation_m)), float(np.degrees(pose.angle_to(TRUE)))


@pytest.fixture(scope="module")
def plain(renderer: MitsubaRenderer, image: np.ndarray) -> Estimate:
    """The estimate from the image and the first prior."""
    return estimate(renderer, frame(image))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_true_shape_gives_the_true_pose(renderer, image, seed):
    """The image is from the same renderer: the error is below a pixel (5 m), that of the prior 40 m."""
    found = estimate(renderer, frame(image, seed))
    assert found.status == "ok"
    shift_m, turn_deg = errors(found.pose)
    assert shift_m < 2.5
    assert turn_deg < 0.15
    assert found.diagnostics["correlation"] > 0.99


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_the_frame_cuts_the_body_its_mean_brightness_moves_the_pose_less(renderer, seed, monkeypatch):
    """Half of the body is out of the frame, and brighter to one side than the rendering, as by another reflectance."""
    beside = Camera(128, 128, CAMERA.fx_px, CAMERA.fy_px, 128.0, 64.0)
    seen = renderer.render(View(beside, TRUE, TRUE.rotation.T @ SUN_CAM)) * np.linspace(0.7, 1.3, 128, dtype=np.float32)
    method, found = PhotometricEstimator(renderer, 200.0, OPTIONS), []
    for background_px in (6.0, 0.0):
        monkeypatch.setattr("boresight.estimators.dense.gauss_newton._CUT_BACKGROUND_PX", background_px)
        answer = method.estimate(Observation(beside, frame(seen, seed)), rng=np.random.default_rng(0))
        assert answer.status == "ok"
        found.append(errors(answer.pose))
    (shift_m, turn_deg), without = found
    assert shift_m < min(3.0, 0.8 * without[0])
    assert turn_deg < min(0.45, 0.8 * without[1])


@pytest.mark.parametrize("gradient", ["autodiff", "differences"])
def test_low_above_the_ground_the_pose_is_found(renderer, gradient):
    """At 30 m a pixel is 0.5 m of the ground, and 2.4 m at the range of the body's origin, 156 m."""
    low, true = Camera.from_fov(128, 128, np.radians(90.0)), look_at(156.0 * TRUE.camera_position_m / 2000.0, 0.4)
    sigmas = np.array([0.0005, 0.0005, 0.0005, 4.0, 4.0, 0.3])
    seen = renderer.render(View(low, true, true.rotation.T @ SUN_CAM))
    method = PhotometricEstimator(renderer, 120.0, PhotometricOptions(gradient=gradient))
    for seed in range(1):
        error = np.random.default_rng(seed).normal(0.0, sigmas)
        start = Frame(seen, SUN_CAM, true.perturbed(error[:3], error[3:]), np.diag(sigmas**2))
        found = method.estimate(Observation(low, start), rng=np.random.default_rng(0))
        assert found.status == "ok", found.reason
        assert np.linalg.norm(found.pose.translation_m - true.translation_m) < 0.2


def test_a_level_ends_where_the_next_steps_would_be_short(renderer):
    """The image is brighter to one side than the rendering, as by another reflectance, which makes steps slow."""
    sun_cam = np.array([0.4, 0.2, -0.9]) / np.linalg.norm([0.4, 0.2, -0.9])
    seen = renderer.render(View(CAMERA, TRUE, TRUE.rotation.T @ sun_cam)) * np.linspace(0.7, 1.3, 128, dtype=np.float32)
    start, view = replace(frame(seen, 3), sun_dir_cam=sun_cam), MeshView(CAMERA, renderer, sun_cam)
    prior = PosePrior(start.prior_T_cam_body, inverse(start.prior_covariance))
    moved = {}
    for most in (2, LevelOptions().iterations):
        level = LevelOptions(reduction=1, iterations=most)
        found = register(seen, start, view, 200.0, PhotometricOptions(levels=(level,)), Stopwatch())
        further = PhotometricOptions(tolerance_sigma=0.01)
        on = fit_level(seen, np.inf, found.T_cam_body, view, prior, 200.0, LevelOptions(iterations=60), further)
        offset = PosePrior(found.T_cam_body, on.information).offset(on.T_cam_body)
        moved[most] = float(np.sqrt(offset @ on.information @ offset))
    assert moved[LevelOptions().iterations] < 0.3 < 0.5 < moved[2], moved


class Holed:
    """A renderer whose image and derivatives are not finite in a tenth of the columns, where it differentiates."""

    differentiable = True

    def __init__(self, renderer):
        self.renderer = renderer

    def render(self, view):
        return self.renderer.render(view)

    def render_with_derivatives(self, view):
        image, derivatives = self.renderer.render_with_derivatives(view)
        size = image.shape[1]
        columns = slice(int(0.45 * size), int(0.55 * size))
        image[:, columns], derivatives[3, :, columns] = np.nan, np.inf
        return image, derivatives


def test_a_full_detector_moves_the_pose_little(renderer, image, monkeypatch):
    """Half of the lit pixels are full, and scatter by the read noise."""
    level = np.median(image[image > 0.0])
    noise = np.random.default_rng(4).normal(0.0, 0.003 * level, image.shape)
    clipped = np.where(image > 0.0, np.minimum(image, level) + noise, 0.0).astype(np.float32)
    assert saturation(clipped) == pytest.approx(level, rel=2e-3)
    # A ball with the Sun behind the camera: 5.9 % of it has a cosine above 0.97, and fades gradually.
    v, u = np.mgrid[-1:1:400j, -1:1:400j]
    assert saturation(np.sqrt(np.maximum(1.0 - u**2 - v**2, 0.0)).astype(np.float32)) == np.inf
    found = [errors(estimate(renderer, frame(clipped, seed)).pose)[1] for seed in range(3)]
    monkeypatch.setattr(gauss_newton, "saturation", lambda observed: np.inf)
    ignored = [errors(estimate(renderer, frame(clipped, seed)).pose)[1] for seed in range(3)]
    assert max(found) < 0.2 * min(ignored)


@pytest.mark.skipif(
    not choose_variant().is_wavefront, reason="the Mitsuba variant of this machine gives no derivatives"
)
def test_pixels_that_are_not_finite_are_left_out_and_counted(renderer, image, plain):
    found = estimate(Holed(renderer), frame(image))
    assert found.status == "ok"
    assert 0.05 < found.diagnostics["masked_share"] < 0.4
    shift_m, turn_deg = errors(found.pose)
    assert shift_m < 2.5
    assert turn_deg < 0.15
    assert plain.diagnostics["masked_share"] == 0.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_mesh_is_brought_into_place_for_recognition(renderer, image, seed):
    """The alignment estimates translation and rotation, and gives the first points of the shift for drawing."""
    start = frame(image, seed)
    clock = Stopwatch()
    found = registration_aligner(OPTIONS, 200.0).align(image, start, MeshView(CAMERA, renderer, SUN_CAM), clock)
    assert not found.failure
    assert found.steps[0].T_cam_body is start.prior_T_cam_body
    assert errors(found.T_cam_body)[1] < min(0.15, 0.5 * errors(start.prior_T_cam_body)[1])
    assert clock.seconds["registration"] > 0.0


@pytest.mark.skipif(
    not choose_variant().is_wavefront, reason="the Mitsuba variant of this machine gives no derivatives"
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_both_gradients_lead_to_the_same_pose(renderer, image, seed):
    """Differences of twelve renderings include all shadows; the renderer's derivatives must give the same pose."""
    poses = [
        estimate(renderer, frame(image, seed), OPTIONS.model_copy(update={"gradient": gradient})).pose
        for gradient in ("autodiff", "differences")
    ]
    assert np.linalg.norm(poses[0].translation_m[:2] - poses[1].translation_m[:2]) < 0.5
    assert np.degrees(poses[0].angle_to(poses[1])) < 0.1


def test_a_gradient_that_the_renderer_lacks_is_refused_and_otherwise_replaced(renderer):
    slow = MitsubaRenderer(EMBEDDED["contact-binary"](), LambertSpec(), 1, variant=choose_variant("scalar_rgb"))
    assert available_gradient(None, slow) == "differences"
    with pytest.raises(BoresightError, match="autodiff"):
        available_gradient("autodiff", slow)
    if renderer.differentiable:
        assert available_gradient(None, renderer) == "autodiff"
        assert available_gradient("differences", renderer) == "differences"


def test_the_unit_of_the_image_has_no_part(renderer, image, plain):
    scaled = estimate(renderer, frame((700.0 * image + 90.0).astype(np.float32)))
    np.testing.assert_allclose(scaled.pose.translation_m, plain.pose.translation_m, atol=0.1)
    assert np.degrees(scaled.pose.angle_to(plain.pose)) < 0.01


def test_what_the_image_does_not_tell_comes_from_the_prior(renderer, image):
    """With a prior much more accurate than the image, the pose stays at the prior along the boresight."""
    sure = np.diag(np.array([1e-6, 1e-6, 1e-6, 1e-3, 1e-3, 1e-3]) ** 2)
    wrong = TRUE.perturbed(np.zeros(3), np.array([0.0, 0.0, 30.0]))
    found = estimate(renderer, Frame(image, SUN_CAM, wrong, sure))
    assert found.pose.translation_m[2] - TRUE.translation_m[2] == pytest.approx(30.0, abs=0.1)


def test_the_covariance_is_below_the_prior_and_positive(plain):
    assert (np.linalg.eigvalsh(plain.covariance) > 0).all()
    assert (np.diag(plain.covariance) <= PRIOR_SIGMAS**2 * (1 + 1e-9)).all()


def test_another_body_is_a_failure_with_a_reason(renderer, image):
    noise = np.where(image > 0, np.random.default_rng(0).random(image.shape), 0).astype(np.float32)
    options = OPTIONS.model_copy(update={"correlation_min": 0.98})
    found = estimate(renderer, frame(noise), options)
    assert found.status == "failed"
    assert "does not look like the image" in found.reason


def test_a_body_cut_by_the_frame_is_judged_by_shifted_images(renderer):
    """Ground that is nowhere that of the shape correlates as well when shifted; a weak but true likeness does not."""
    noise = np.random.default_rng(0).random((128, 128), dtype=np.float32)
    found = estimate(renderer, frame(cv2.GaussianBlur(noise, (0, 0), 2.0)))
    assert (found.status, found.pose) == ("failed", None)
    assert found.reason.endswith("times that of shifted images")
    rng = np.random.default_rng(1)
    mine, others = (cv2.GaussianBlur(rng.normal(size=(200, 240)), (0, 0), 2.0) for _ in range(2))
    everywhere = np.ones(mine.shape, dtype=bool)
    weak = 0.3 * mine + others
    assert np.corrcoef(mine.ravel(), weak.ravel())[0, 1] < 0.35
    assert gauss_newton._sharpness(weak, mine, everywhere) > 3.5
    assert gauss_newton._sharpness(others, mine, everywhere) < 1.5
    shifted = np.roll(mine, (20, -9), axis=(0, 1))
    assert gauss_newton._sharpness(shifted, mine, everywhere) < 0.3


def test_a_strong_likeness_of_a_cut_body_needs_no_shifted_images(renderer):
    """Relief of long wavelengths makes shifted images alike as well; here the limit is above what this body reaches."""
    beside = Camera(128, 128, CAMERA.fx_px, CAMERA.fy_px, 128.0, 64.0)
    observation = Observation(beside, frame(renderer.render(View(beside, TRUE, TRUE.rotation.T @ SUN_CAM))))

    def answer(sure: float) -> Estimate:
        options = OPTIONS.model_copy(update={"sharpness_min": 10.0, "correlation_sure": sure})
        return PhotometricEstimator(renderer, 200.0, options).estimate(observation, rng=np.random.default_rng(0))

    found = answer(OPTIONS.correlation_sure)
    assert (found.status, answer(1.0).status) == ("ok", "failed")
    assert found.diagnostics["sharpness"] < 10.0


@pytest.mark.parametrize(("value", "reason"), [(0.0, "black"), (np.nan, "NaN")])
def test_an_image_without_a_body_fails(renderer, value, reason):
    found = estimate(renderer, frame(np.full((128, 128), value, dtype=np.float32)))
    assert found.status == "failed"
    assert reason in found.reason


def test_a_reduced_camera_sees_the_same_directions():
    small = reduced_camera(CAMERA, 4)
    points = np.random.default_rng(0).normal([0.0, 0.0, 2000.0], 100.0, (50, 3))
    np.testing.assert_allclose(small.project(points) * 4.0, CAMERA.project(points))


def test_reduction_averages_and_a_band_has_no_mean():
    image = np.random.default_rng(0).random((64, 64), dtype=np.float32)
    np.testing.assert_allclose(reduced_image(image, 4)[3, 5], image[12:16, 20:24].mean(), rtol=1e-6)
    flat = np.full((64, 64), 3.0, dtype=np.float32)
    np.testing.assert_allclose(band_pass(flat, LevelOptions(blur_px=1.0, background_px=4.0)), 0.0, atol=1e-5)


def test_the_prior_term_measures_what_perturbed_does():
    step = np.array([0.01, -0.02, 0.005, 3.0, -4.0, 1.0])
    np.testing.assert_allclose(PosePrior(TRUE, np.eye(6)).offset(TRUE.perturbed(step[:3], step[3:])), step, atol=1e-12)
    np.testing.assert_allclose(inverse(np.diag([1e8, 1e-3, 2.0])) @ np.diag([1e8, 1e-3, 2.0]), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("sure_of", [(5,), (0, 1, 2), (0, 1, 2, 3, 4, 5)], ids=["range", "attitude", "all"])
def test_what_the_prior_knows_without_error_stays(renderer, image, sure_of):
    """A variance of 0 has no inverse, but it fixes the component."""
    sigmas = PRIOR_SIGMAS.copy()
    sigmas[list(sure_of)] = 0.0
    error = np.random.default_rng(1).normal(0.0, sigmas)
    prior = TRUE.perturbed(error[:3], error[3:])
    found = estimate(renderer, Frame(image, SUN_CAM, prior, np.diag(sigmas**2)))
    assert found.status == "ok"
    moved = PosePrior(prior, np.eye(6)).offset(found.pose)
    np.testing.assert_allclose(moved[list(sure_of)], 0.0, atol=1e-6)
    assert np.isfinite(found.covariance).all()
    assert errors(found.pose)[0] < 2.5


def test_a_shape_that_goes_out_of_sight_on_the_way_is_a_failure_with_a_reason(renderer, image):
    class OnlyWhole:
        """Renders the body for the first shift, and nothing for the smaller images of the levels."""

        def render(self, view: View) -> np.ndarray:
            whole = view.camera.width_px == CAMERA.width_px
            return renderer.render(view) if whole else np.zeros((view.camera.height_px, view.camera.width_px), "f4")

    found = estimate(OnlyWhole(), frame(image))
    assert found.status == "failed"
    assert "out of view" in found.reason
    assert [stage.name for stage in found.stages] == ["alignment", "level-2"]
