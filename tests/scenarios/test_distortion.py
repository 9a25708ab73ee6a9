"""Radial distortion against OpenCV, whose polynomial runs the other way, and against central differences."""

from __future__ import annotations

from dataclasses import astuple

import cv2
import numpy as np
import pytest

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, OpenCVDistortion, RadialDistortion, pixel_from_opencv, pixel_to_opencv
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.camera import CameraSpec, DistortionSpec

# As the kernels state them, per mm**2 of the focal plane, with focal lengths in mm.
AMICA = Camera(1024, 1024, 120.8 / 0.012, 120.8 / 0.012, 512.0, 512.0, RadialDistortion(-2.8e-5 * 120.8**2))
MSI = Camera(537, 244, 166.85 / 0.016, 166.85 / 0.027, 268.5, 122.0, RadialDistortion(-7e-5 * 166.85**2))
WIDE = Camera(640, 480, 700.0, 710.0, 318.0, 243.0, RadialDistortion(-0.12, 0.03))
BARREL = Camera(640, 480, 700.0, 710.0, 318.0, 243.0, RadialDistortion(0.3, 0.1))
CAMERAS = pytest.mark.parametrize("camera", [AMICA, MSI, WIDE, BARREL], ids=["amica", "msi", "wide", "barrel"])
BROWN = Camera(640, 480, 700.0, 710.0, 318.0, 243.0, OpenCVDistortion(-0.28, 0.11, 0.004, -0.003, -0.02))
RATIONAL = Camera(640, 480, 400.0, 410.0, 318.0, 243.0, OpenCVDistortion(0.9, 0.2, 2e-3, 1e-3, 0.01, 1.1, 0.3, 0.02))
CALIBRATED = pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=["brown", "rational"])
ALL = pytest.mark.parametrize(
    "camera",
    [WIDE.pinhole, AMICA, MSI, WIDE, BARREL, BROWN, RATIONAL],
    ids=["pinhole", "amica", "msi", "wide", "barrel", "brown", "rational"],
)


def pixels(camera: Camera, number: int = 200) -> np.ndarray:
    corners = [[0, 0], [camera.width_px, 0], [0, camera.height_px], [camera.width_px, camera.height_px]]
    inside = np.random.default_rng(5).uniform(0, 1, (number, 2)) * [camera.width_px, camera.height_px]
    return np.concatenate([inside, corners, [[camera.cx_px, camera.cy_px]]])


def opencv(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    matrix = camera.matrix
    matrix[:2, 2] = pixel_to_opencv(matrix[:2, 2])
    return matrix, np.array([camera.distortion.k1, camera.distortion.k2, 0.0, 0.0])


@CAMERAS
def test_undistorting_is_opencvs_distorting(camera):
    matrix, coefficients = opencv(camera)
    uv = pixels(camera)
    slopes = np.linalg.solve(matrix, np.column_stack([pixel_to_opencv(uv), np.ones(len(uv))]).T).T
    expected, _ = cv2.projectPoints(slopes, np.zeros(3), np.zeros(3), matrix, coefficients)
    np.testing.assert_allclose(camera.undistorted(uv), pixel_from_opencv(expected[:, 0]), atol=1e-9)


@CAMERAS
def test_distorting_is_opencvs_undistorting(camera):
    matrix, coefficients = opencv(camera)
    uv = camera.undistorted(pixels(camera))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-14)
    points = pixel_to_opencv(uv)[:, None]
    expected = cv2.undistortPoints(points, matrix, coefficients, P=matrix, criteria=criteria)[:, 0]
    np.testing.assert_allclose(camera.distorted(uv), pixel_from_opencv(expected), atol=1e-8)


@CALIBRATED
def test_a_calibrated_lens_is_opencvs(camera):
    matrix = camera.matrix
    points = 7.0 * camera.unproject(pixels(camera))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(astuple(camera.distortion)))
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)
    assert np.linalg.norm(expected[:, 0] - camera.pinhole.project(points), axis=1).max() > 5.0
    assert camera.distortion.invertible_within(0.5)


@ALL
def test_project_and_unproject_invert_each_other(camera):
    uv = pixels(camera)
    directions = camera.unproject(uv)
    np.testing.assert_allclose(camera.project(7.0 * directions), uv, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)


@ALL
def test_jacobian_against_central_differences(camera):
    points = 5.0 * camera.unproject(pixels(camera, 40))
    step = 1e-6
    numeric = np.stack(
        [(camera.project(points + step * e) - camera.project(points - step * e)) / (2 * step) for e in np.eye(3)],
        axis=-1,
    )
    np.testing.assert_allclose(camera.jacobian(points), numeric, rtol=1e-5, atol=1e-4)


def test_the_corner_of_amica_moves_by_three_halves_of_a_pixel():
    corner = np.array([1024.0, 1024.0])
    radius_mm = np.hypot(512, 512) * 0.012
    expected_px = 2.8e-5 * radius_mm**2 * np.hypot(512, 512)
    assert np.linalg.norm(AMICA.undistorted(corner) - corner) == pytest.approx(expected_px)
    assert expected_px == pytest.approx(1.53, abs=0.01)


def test_a_pinhole_distorts_nothing():
    uv = pixels(WIDE)
    assert WIDE.pinhole.distortion is None
    np.testing.assert_array_equal(WIDE.pinhole.distorted(uv), uv)
    np.testing.assert_array_equal(WIDE.pinhole.undistorted(uv), uv)


def test_what_the_polynomial_cannot_invert_has_no_pixel():
    # With k1 < 0 no ideal radius beyond 2/3 sqrt(1 / (3 |k1|)) is ever seen.
    lens = RadialDistortion(-0.12)
    largest = 2.0 / 3.0 * np.sqrt(1.0 / 0.36)
    assert np.isfinite(lens.seen(np.array([0.999 * largest, 0.0]))).all()
    assert np.isnan(lens.seen(np.array([1.001 * largest, 0.0]))).all()
    assert lens.invertible_within(np.sqrt(1.0 / 0.36) - 1e-6)
    assert not lens.invertible_within(np.sqrt(1.0 / 0.36) + 1e-6)
    # The slope 1 - 3 r^2 + 2 r^4 is negative between its roots alone, r^2 = 1/2 and 1.
    assert not RadialDistortion(-1.0, 0.4).invertible_within(1.1)


def test_what_has_folded_over_has_no_pixel():
    # r (1 - 0.3 r^2) rises up to r^2 = 1 / 0.9, where 2 / 3 of it is seen; OpenCV maps what lies beyond back inside.
    lens, fold = OpenCVDistortion(-0.3, 0.0, 0.0, 0.0), np.sqrt(1.0 / 0.9)
    across = lens.seen(np.array([[0.999 * fold, 0.0], [1.001 * fold, 0.0]]))
    assert across[0, 0] == pytest.approx(2.0 / 3.0 * fold, rel=1e-5)
    assert np.isnan(across[1]).all()
    assert np.isnan(lens.ideal(np.array([0.67 * fold, 0.0]))).all()
    assert lens.invertible_within(0.66 * fold)
    assert not lens.invertible_within(0.67 * fold)


def test_a_scenario_has_opencvs_vector(tmp_path):
    file = tmp_path / "lens.yaml"
    file.write_text(
        "camera: {fov_deg: 20, distortion: {opencv: [-0.2, 0.01, 0.001, 0, 0.02]}}\nviewpoint: {range_m: 9}\n"
    )
    spec = load_scenario(str(file)).spec.camera
    assert spec.camera().distortion == OpenCVDistortion(-0.2, 0.01, 0.001, 0.0, 0.02)
    assert spec.distortion.scaled(0.5).lens() == OpenCVDistortion(-0.1, 0.005, 0.0005, 0.0, 0.01)
    for change, message in (
        ("k2=1", "k2 has no part"), ("opencv=[1, 2, 3]", "at least 4"),
        ("opencv=[-90, 0, 0, 0]", "folds the image over"),
    ):  # fmt: skip
        with pytest.raises(BoresightError, match=message):
            load_scenario(str(file), (f"camera.distortion.{change}",))


def test_a_scenario_names_the_distortion(tmp_path):
    file = tmp_path / "lens.yaml"
    file.write_text("camera: {fov_deg: 20, distortion: {k1: -0.4}}\nviewpoint: {range_m: 2000}\n")
    assert load_scenario(str(file)).spec.camera.camera().distortion == RadialDistortion(-0.4)
    with pytest.raises(BoresightError, match=r"camera.*folds the image over.*not to mm or pixels"):
        load_scenario(str(file), ("camera.distortion.k1=-40",))


def test_the_corner_farthest_from_the_principal_point_must_not_fold():
    # 1 + k1 r^2 with k1 = -0.12 folds at r = sqrt(1 / 0.36) = 1.67: the corners of a middle are at 1.41 focal lengths.
    lens, size = DistortionSpec(k1=-0.12), {"width_px": 200, "height_px": 200, "focal_px": (100.0, 100.0)}
    assert CameraSpec(**size, distortion=lens).camera().distortion == RadialDistortion(-0.12)
    for place in ((20.0, 100.0), (180.0, 100.0), (100.0, 20.0), (100.0, 180.0)):
        with pytest.raises(ValueError, match="folds the image over"):
            CameraSpec(**size, distortion=lens, principal_point_px=place)
