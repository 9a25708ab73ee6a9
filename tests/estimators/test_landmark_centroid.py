"""Centroid, whole-image alignment and the loop that shifts the mesh, on images drawn by formula."""

import cv2
import numpy as np
import pytest

from boresight.estimators.contract import Stopwatch
from boresight.estimators.landmark.alignment import (
    AlignmentOptions,
    MeshView,
    align_translation,
    best_shift,
    brightness_centroid,
    centroid_pair,
    correlation_pair,
    translation_update,
)
from boresight.estimators.landmark.signal import extract_signal, observed_signal
from boresight.scenarios.geometry import Camera, Pose
from boresight.scenarios.observation import Frame

CAMERA = Camera(256, 200, 800.0, 800.0, 128.0, 100.0)
RADIUS_M = 60.0


def disc(u0, v0, radius, shape=(200, 256), oversample=8):
    """A uniform disc, each pixel the exact share that it covers up to the oversampling."""
    step = (np.arange(oversample) + 0.5) / oversample
    u = (np.arange(shape[1])[:, None] + step).ravel()
    v = (np.arange(shape[0])[:, None] + step).ravel()
    fine = (np.hypot(u[None] - u0, v[:, None] - v0) < radius).astype(np.float32)
    return fine.reshape(shape[0], oversample, shape[1], oversample).mean(axis=(1, 3))


class Ball:
    """An analytic renderer: a ball of uniform brightness, which is a disc in the image."""

    def __init__(self, gain=1.0):
        self.gain = gain
        self.views = []

    def render(self, view):
        self.views.append(view)
        centre = view.T_cam_body.translation_m
        u, v = view.camera.project(centre)
        shape = view.camera.height_px, view.camera.width_px
        return self.gain * disc(u, v, view.camera.fx_px * RADIUS_M / centre[2], shape)


@pytest.mark.parametrize("centre", [(100.0, 90.0), (100.5, 90.5), (77.3, 121.8)])
def test_the_centroid_of_a_disc_is_its_centre(centre):
    np.testing.assert_allclose(brightness_centroid(disc(*centre, 30.0)), centre, atol=5e-3)


def test_one_pixel_has_its_centroid_half_a_pixel_in():
    image = np.zeros((20, 30), dtype=np.float32)
    image[3, 7] = 5.0
    np.testing.assert_array_equal(brightness_centroid(image), (7.5, 3.5))


def test_the_background_does_not_pull_the_centroid():
    rng = np.random.default_rng(1)
    clean = disc(70.0, 60.0, 30.0)
    noisy = (1000.0 * clean + rng.normal(200.0, 8.0, clean.shape)).astype(np.float32)
    raw = brightness_centroid(noisy)
    assert np.linalg.norm(raw - (70.0, 60.0)) > 20.0
    np.testing.assert_allclose(brightness_centroid(extract_signal(noisy).image), (70.0, 60.0), atol=0.1)


def test_the_update_of_equation_13():
    pose = Pose(np.eye(3), np.array([10.0, -20.0, 1500.0]))
    seen = CAMERA.project(pose.translation_m)
    target = seen + np.array([30.0, -12.0])
    moved = translation_update(pose, target, seen, CAMERA)
    np.testing.assert_allclose(CAMERA.project(moved.translation_m), target, atol=1e-9)
    # cos(theta) makes the shift perpendicular to the new line of sight, so the range falls by cos(theta).
    cosine = CAMERA.unproject(target) @ CAMERA.unproject(seen)
    assert np.linalg.norm(moved.translation_m) == pytest.approx(np.linalg.norm(pose.translation_m) * cosine)
    np.testing.assert_array_equal(moved.rotation, pose.rotation)


@pytest.mark.parametrize("measure", [centroid_pair, correlation_pair], ids=["centroid", "image"])
@pytest.mark.parametrize("start", [(40.0, -55.0), (-6.0, 3.0), (130.0, 90.0)])
def test_the_loop_finds_the_ball(measure, start):
    truth = Pose(np.eye(3), np.array([12.0, 18.0, 2000.0]))
    ball, clock = Ball(), Stopwatch()
    observed = ball.render(type("V", (), {"T_cam_body": truth, "camera": CAMERA}))
    prior = truth.perturbed(np.zeros(3), np.array([*start, 0.0]))
    view = MeshView(CAMERA, Ball(gain=0.3), np.array([0.0, 0.0, -1.0]))
    result = align_translation(observed, prior, view, measure, AlignmentOptions(), clock)
    assert result.failure == ""
    miss = CAMERA.project(result.T_cam_body.translation_m) - CAMERA.project(truth.translation_m)
    assert np.abs(miss).max() < 0.1
    assert 2 <= len(result.steps) <= 4
    assert set(clock.seconds) == {"mesh_rendering", "centroid"}
    moved = [step.rendered_px for step in result.steps]
    assert np.linalg.norm(moved[-1] - moved[-2]) < 5.0


def test_the_loop_ends_by_tolerance_and_by_count():
    truth = Pose(np.eye(3), np.array([0.0, 0.0, 2000.0]))
    prior = truth.perturbed(np.zeros(3), np.array([60.0, 0.0, 0.0]))
    observed = disc(128.0, 100.0, 24.0)
    view = MeshView(CAMERA, Ball(), np.array([0.0, 0.0, -1.0]))

    def steps(**options):
        found = align_translation(observed, prior, view, centroid_pair, AlignmentOptions(**options), Stopwatch())
        return len(found.steps)

    assert steps(max_iterations=1) == 1
    # The ball is 24 px off: the second image differs from the first by 24 px, the third from the second by nothing.
    assert steps(tolerance_px=30.0) == 2
    assert steps(tolerance_px=5.0) == 3


def test_the_sun_stays_in_the_camera():
    turn = Pose.from_quat_wxyz(np.array([0.9, 0.1, -0.3, 0.2]), np.array([0.0, 0.0, 2000.0]))
    ball = Ball()
    sun_cam = np.array([0.6, 0.0, -0.8])
    MeshView(CAMERA, ball, sun_cam).render(turn)
    np.testing.assert_allclose(turn.rotate(ball.views[0].sun_dir_body), sun_cam, atol=1e-12)


def test_a_mesh_out_of_view_is_a_failure_with_a_reason():
    prior = Pose(np.eye(3), np.array([5000.0, 0.0, 2000.0]))
    view = MeshView(CAMERA, Ball(), np.array([0.0, 0.0, -1.0]))
    result = align_translation(disc(128, 100, 24), prior, view, centroid_pair, AlignmentOptions(), Stopwatch())
    assert "out of view" in result.failure
    assert result.steps == ()


def blob(u0, v0, seed=4):
    """A smooth, lopsided blob."""
    rng = np.random.default_rng(seed)
    u, v = np.meshgrid(np.arange(256) + 0.5, np.arange(200) + 0.5)
    image = np.zeros((200, 256))
    for du, dv, size, gain in rng.uniform((-25, -20, 4, 0.2), (25, 20, 10, 1.0), (12, 4)):
        image += gain * np.exp(-0.5 * ((u - u0 - du) ** 2 + (v - v0 - dv) ** 2) / size**2)
    return np.where(image > 0.02, image, 0.0).astype(np.float32)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (17.0, -9.0), (-30.4, 22.7), (70.0, 0.3)])
def test_the_best_shift_is_the_shift(shift):
    found = best_shift(3.0 * blob(120.0 + shift[0], 100.0 + shift[1]), blob(120.0, 100.0))
    np.testing.assert_allclose(found, shift, atol=0.15)


def scenery(seed=3) -> np.ndarray:
    """Texture without an end, larger than a frame."""
    rng = np.random.default_rng(seed)
    fine, coarse = (cv2.GaussianBlur(rng.standard_normal((400, 500)), (0, 0), sigma) for sigma in (3.0, 20.0))
    return (1.0 + 0.5 * fine / fine.std() + 0.5 * coarse / coarse.std()).clip(0.05).astype(np.float32)


@pytest.mark.parametrize("shift", [(0, 0), (23, -14), (-60, 35)])
@pytest.mark.parametrize("sky", [0, 100, 180])
def test_a_body_that_the_frame_cuts_is_shifted_by_what_both_have_in_common(shift, sky):
    """Ground that fills the frame, or with ``sky`` columns of it dark on the left; the renderer has other albedo."""
    ground, (du, dv) = scenery(), shift
    ground[:, : 100 + sky] = np.where(sky, 0.0, ground[:, : 100 + sky])
    albedo = np.linspace(0.7, 1.3, 256, dtype=np.float32)
    rendered = ground[100:300, 100:356]
    observed = 3.0 * albedo * ground[100 - dv : 300 - dv, 100 - du : 356 - du]
    np.testing.assert_allclose(best_shift(observed, rendered), shift, atol=0.3)


def test_a_shift_between_pixels_is_found_where_the_frame_cuts_the_body():
    ground = scenery()
    moved = cv2.warpAffine(ground, np.float32([[1, 0, 5.4], [0, 1, -3.3]]), (500, 400), flags=cv2.INTER_CUBIC)
    found = best_shift(moved[100:300, 100:356], ground[100:300, 100:356])
    np.testing.assert_allclose(found, (5.4, -3.3), atol=0.1)


@pytest.mark.parametrize("image", [np.zeros((64, 96)), np.ones((64, 96)), np.full((64, 96), np.nan)])
def test_an_image_without_contrast_shifts_nothing(image):
    flat, texture = image.astype(np.float32), scenery()[:64, :96]
    for pair in ((texture, flat), (np.ones_like(flat), flat)):
        np.testing.assert_array_equal(best_shift(*pair), 0.0)


def test_the_image_aligns_where_the_centroid_is_misled():
    observed = blob(120.0, 100.0)
    observed[:, 150:] = 0.0  # a part in a shadow that the mesh does not cast
    rendered = blob(110.0, 108.0)
    by_centroid = np.subtract(*centroid_pair(observed, rendered, np.zeros(2)))
    by_image = np.subtract(*correlation_pair(observed, rendered, np.array([110.0, 108.0])))
    error = [np.linalg.norm(found - (10.0, -8.0)) for found in (by_centroid, by_image)]
    assert error[1] < 0.5 * error[0]


def frame_of(image) -> Frame:
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 1000.0]))
    return Frame(image.astype(np.float32), np.array([0.0, 0.0, -1.0]), pose, np.eye(6))


def test_a_body_that_covers_all_corners_is_not_taken_for_sky():
    """The image is that of a detector with an offset, of ground with shadows, and the same with sky in one corner."""
    ground = 200.0 * scenery()[100:300, 100:356] + 40.0
    ground[90:110, 60:90] = 40.0
    signal = observed_signal(frame_of(ground), CAMERA)
    assert np.count_nonzero(signal) > 0.9 * signal.size
    assert not signal[95:105, 65:85].any(), "a shadow is black"
    noise = np.random.default_rng(1).normal(0.0, 2.0, ground.shape)
    with_sky = ground + noise
    with_sky[:30, :30] = 40.0 + noise[:30, :30]
    np.testing.assert_array_equal(
        observed_signal(frame_of(with_sky), CAMERA), extract_signal(with_sky.astype(np.float32)).image
    )


class Ground:
    """Textured flat ground at a radius above the body's origin, seen straight down."""

    def __init__(self, radius_m):
        rng = np.random.default_rng(6)
        angle, length_m = rng.uniform(0.0, 2.0 * np.pi, 60), rng.uniform(0.4, 2.5, 60)
        self.waves = 2.0 * np.pi / length_m * np.array([np.cos(angle), np.sin(angle)])
        self.phases = rng.uniform(0.0, 2.0 * np.pi, 60)
        self.radius_m = radius_m

    def render(self, view):
        camera, origin_m = view.camera, view.T_cam_body.translation_m
        depth_m = origin_m[2] - self.radius_m
        u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
        x, y = ((p - c) / 800.0 * depth_m for p, c in ((u, camera.cx_px), (v, camera.cy_px)))
        texture = np.zeros(u.shape)
        for (along, down), phase in zip(self.waves.T, self.phases, strict=True):
            texture += np.cos(along * (x - origin_m[0]) + down * (y - origin_m[1]) + phase)
        return (2.0 + texture / texture.std()).clip(0.1).astype(np.float32)


@pytest.mark.parametrize(("radius_m", "share"), [(480.0, 40.0 / 520.0), (100.0, 40.0 / 140.0), (30.0, 1.0)])
def test_near_ground_is_shifted_by_its_own_depth(radius_m, share):
    """At 40 m a pixel is 5 cm of the ground, and up to 65 cm at the range of the body's origin."""
    truth, ground = Pose(np.eye(3), np.array([1.0, -2.0, radius_m + 40.0])), Ground(radius_m)
    view = MeshView(CAMERA, ground, np.array([0.0, 0.0, -1.0]))
    prior = truth.perturbed(np.zeros(3), np.array([0.5, -0.3, 0.0]))
    observed = ground.render(view.at(truth))
    found = align_translation(observed, prior, view, correlation_pair, AlignmentOptions(tolerance_px=1.0), Stopwatch())
    assert found.depth_share == pytest.approx(share, rel=0.05)
    np.testing.assert_allclose(found.T_cam_body.translation_m[:2], truth.translation_m[:2], atol=0.05)
