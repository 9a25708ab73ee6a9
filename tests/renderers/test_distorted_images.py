"""Images through a real lens: what the rays see, and what resampling makes of it."""

from __future__ import annotations

from dataclasses import astuple

import cv2
import numpy as np
import pytest
import trimesh

from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.renderers.mitsuba3.rays import body_window, outline_points
from boresight.renderers.rectify import rectify
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import (
    Camera,
    OpenCVDistortion,
    RadialDistortion,
    TriangleMesh,
    View,
    look_at,
    pixel_to_opencv,
)
from boresight.scenarios.spec.brdf import LambertSpec

SUN = [0.9, -0.5, 0.1]
# Several times the distortion of a mission's camera.
PINCUSHION = Camera(120, 90, 150.0, 160.0, 58.0, 46.0, RadialDistortion(-0.4, 0.1))
BARREL = Camera(120, 90, 150.0, 160.0, 58.0, 46.0, RadialDistortion(0.5, 0.2))
CALIBRATED = Camera(120, 90, 150.0, 160.0, 58.0, 46.0, OpenCVDistortion(-0.3, 0.12, 0.01, -0.006, -0.02))
LENSES = pytest.mark.parametrize("camera", [PINCUSHION, BARREL, CALIBRATED], ids=["pincushion", "barrel", "opencv"])


@pytest.fixture(params=["llvm", "scalar"])
def variant(request):
    return request.getfixturevalue(request.param)


def opencv_pixels(camera: Camera, points_cam: np.ndarray) -> np.ndarray:
    """Where OpenCV puts what the pinhole sees: its polynomial runs from ideal to seen, that of kernels back."""
    matrix = camera.matrix
    if isinstance(camera.distortion, OpenCVDistortion):
        return cv2.projectPoints(points_cam, np.zeros(3), np.zeros(3), matrix, np.array(astuple(camera.distortion)))[0][
            :, 0
        ]
    ideal = (points_cam[:, :2] / points_cam[:, 2:])[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-14)
    lens = np.array([camera.distortion.k1, camera.distortion.k2, 0.0, 0.0])
    return cv2.undistortPoints(ideal, np.eye(3), lens, P=matrix, criteria=criteria)[:, 0]


@LENSES
def test_rendered_pixels_are_where_opencv_puts_them(variant, camera):
    """The middle of a small ball lit from behind the camera, to 0.03 px; the lens moves it by up to 4 px."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=3.0)
    pose = look_at(np.array([200.0, -400.0, 100.0]), 0.3)
    moved = []
    for u, v in ((10.0, 10.0), (108.0, 80.0), (60.0, 45.0)):
        centre = pose.inverse().transform(450.0 * camera.unproject(np.array([u, v])))
        ball = TriangleMesh(sphere.vertices + centre, sphere.faces)
        image = MitsubaRenderer(ball, LambertSpec(), 64, variant=variant).render(
            View(camera, pose, pose.camera_position_m - centre)
        )
        rows, columns = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
        centroid = np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()
        expected = opencv_pixels(camera, pose.transform(centre)[None])[0]
        np.testing.assert_allclose(centroid, expected, atol=0.03)
        moved.append(np.linalg.norm(expected - camera.pinhole.project(pose.transform(centre))))
    assert max(moved) > 3.0


@LENSES
def test_de_projected_points_project_back_by_opencv(variant, rock, looking, camera):
    view = looking(camera, [500.0, -800.0, 400.0], SUN)
    uv = np.random.default_rng(5).uniform([0, 0], [120, 90], (200, 2))
    hits = MitsubaRenderer(rock, LambertSpec(), 1, variant=variant).surface(view, uv)
    assert hits.hit.sum() > 50
    points = view.T_cam_body.transform(hits.points_body_m[hits.hit])
    np.testing.assert_allclose(opencv_pixels(camera, points), uv[hits.hit], atol=1e-6)


def test_variants_render_the_same_through_a_lens(llvm, scalar, rock, looking):
    view = looking(PINCUSHION, [900.0, -1500.0, 700.0], SUN)
    one, other = (MitsubaRenderer(rock, LambertSpec(), 4, variant=v).render(view) for v in (llvm, scalar))
    assert (one > 0).sum() > 200
    assert (np.abs(one - other) > 1e-3 * one.max()).mean() < 0.01


@LENSES
def test_the_window_holds_the_body_seen_through_the_lens(rock, looking, camera):
    for position in ([0.0, -900.0, 300.0], [700.0, 500.0, -500.0]):
        view = looking(camera, position, SUN)
        window = body_window(view, outline_points(rock))
        uv = camera.project(view.T_cam_body.transform(rock.vertices_m))
        uv = np.clip(uv, 0, [camera.width_px, camera.height_px])
        assert np.all(uv >= [window.column, window.row])
        assert np.all(uv <= [window.column + window.width, window.row + window.height])


@LENSES
def test_rectified_is_what_the_pinhole_sees(llvm, rock, looking, camera):
    """Inside the disc to 1 % of the brightest in the median; the lens itself makes a difference of ten times that."""
    view = looking(camera, [900.0, -1500.0, 700.0], SUN)
    renderer = MitsubaRenderer(rock, LambertSpec(), 64, "smooth", llvm)
    seen = renderer.render(view)
    ideal = renderer.render(View(camera.pinhole, view.T_cam_body, view.sun_dir_body))
    inside = cv2.erode((ideal > 0).astype(np.uint8), np.ones((5, 5))) > 0
    rectified = rectify(seen, camera)
    error, wrong = (np.abs(image - ideal)[inside] / ideal.max() for image in (rectified, seen))
    assert rectified.dtype == np.float32
    assert np.median(error) < 0.01
    assert np.median(wrong) > 5.0 * np.median(error)


def test_rectifying_follows_opencvs_maps_on_a_smooth_image():
    """OpenCV takes the positions in another way and interpolates linearly: a smooth image shows the same."""
    camera = BARREL
    rows, columns = np.mgrid[:90, :120].astype(np.float64)
    image = (100 + 50 * np.sin(columns / 15) * np.cos(rows / 11)).astype(np.float32)
    columns, rows = np.meshgrid(np.arange(120) + 0.5, np.arange(90) + 0.5)
    rays = camera.pinhole.unproject(np.stack([columns, rows], axis=-1).reshape(-1, 2))
    maps = pixel_to_opencv(opencv_pixels(camera, rays)).reshape(90, 120, 2).astype(np.float32)
    theirs = cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(rectify(image, camera)[2:-2, 2:-2], theirs[2:-2, 2:-2], atol=0.2)


@pytest.mark.parametrize(("wavelength_px", "limit"), [(4.0, 0.0065), (8.0, 3.5e-4)])
def test_the_error_of_resampling_is_what_is_stated(wavelength_px, limit):
    """RMS error over the amplitude, for waves of a wavelength, through AMICA's lens."""
    camera = Camera(1024, 1024, 120.8 / 0.012, 120.8 / 0.012, 512.0, 512.0, RadialDistortion(-2.8e-5 * 120.8**2))

    def wave(uv: np.ndarray) -> np.ndarray:
        return np.sin(2.0 * np.pi * (0.8 * uv[..., 0] + 0.6 * uv[..., 1]) / wavelength_px)

    grid = np.stack(np.meshgrid(np.arange(1024) + 0.5, np.arange(1024) + 0.5), axis=-1)
    rectified = rectify(wave(camera.undistorted(grid)).astype(np.float32), camera)
    error = (rectified - wave(grid))[8:-8, 8:-8]
    rms = np.sqrt(2.0 * (error**2).mean())
    assert 0.5 * limit < rms < limit


def test_without_distortion_the_image_is_left_alone():
    image = np.ones((90, 120), dtype=np.float32)
    assert rectify(image, PINCUSHION.pinhole) is image
    with pytest.raises(BoresightError, match=r"\(80, 120\) is not of the camera, 120 x 90"):
        rectify(image[:80], PINCUSHION)


def test_noise_keeps_the_variance_that_is_stated():
    camera = Camera(1024, 1024, 120.8 / 0.012, 120.8 / 0.012, 512.0, 512.0, RadialDistortion(-2.8e-5 * 120.8**2))
    noise = np.random.default_rng(0).normal(size=(1024, 1024)).astype(np.float32)
    assert rectify(noise, camera)[8:-8, 8:-8].var() == pytest.approx(0.84, abs=0.02)
