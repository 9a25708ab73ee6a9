"""Ellipses in images: against OpenCV's fit of projected points and against closed forms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import (
    Camera,
    Ellipses,
    Pose,
    View,
    pixel_from_opencv,
    pixel_to_opencv,
    project_circles,
)

CAMERA = Camera.from_fov(537, 412, np.radians(2.93))


def drawn(n=40, seed=1):
    rng = np.random.default_rng(seed)
    longer = rng.uniform(3, 80, n)
    return Ellipses(
        rng.uniform(0, 500, (n, 2)), np.stack([longer, longer * rng.uniform(0.3, 0.99, n)], 1), rng.uniform(0, np.pi, n)
    )


def test_points_lie_on_the_conic_and_normals_follow_its_gradient():
    ellipses = drawn()
    points, normals = ellipses.points(48)
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    values = np.einsum("nki,nij,nkj->nk", homogeneous, ellipses.conics(), homogeneous)
    assert np.abs(values).max() < 1e-9
    gradient = np.einsum("nij,nkj->nki", ellipses.conics(), homogeneous)[..., :2]
    gradient /= np.linalg.norm(gradient, axis=-1, keepdims=True)
    np.testing.assert_allclose(normals, gradient, atol=1e-7)


def test_conics_of_any_scale_give_the_ellipses_back():
    ellipses = drawn()
    scales = np.random.default_rng(2).uniform(-3, 3, len(ellipses))
    back = Ellipses.from_conics(ellipses.conics() * scales[:, None, None])
    np.testing.assert_allclose(back.centre_px, ellipses.centre_px, atol=1e-7)
    np.testing.assert_allclose(back.semi_axes_px, ellipses.semi_axes_px, rtol=1e-7)
    np.testing.assert_allclose(np.sin(back.angle_rad - ellipses.angle_rad), 0.0, atol=1e-5)


def test_a_projected_circle_is_what_opencv_fits_to_its_projected_points():
    rng = np.random.default_rng(3)
    pose = Pose(Rotation.random(rng=rng).as_matrix(), np.array([300.0, -200.0, 60e3]))
    view = View(CAMERA, pose, np.array([1.0, 0.0, 0.0]))
    normal = rng.normal(size=(12, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    line = pose.rotation.T @ np.array([0.0, 0.0, 1.0])
    normal[np.abs(normal @ line) < 0.3] = line
    centre, radius = rng.uniform(-500, 500, (12, 3)), rng.uniform(100, 900, 12)
    ellipses = project_circles(view, centre, normal, radius)
    for i in range(12):
        spin = Rotation.from_rotvec(normal[i] * np.linspace(0, 2 * np.pi, 60, endpoint=False)[:, None])
        start = np.cross(normal[i], [0.3, 0.5, 0.8])
        rim = centre[i] + radius[i] * spin.apply(start / np.linalg.norm(start))
        uv = CAMERA.project(rim @ pose.rotation.T + pose.translation_m)
        (u, v), axes, angle = cv2.fitEllipseDirect(pixel_to_opencv(uv).astype(np.float32))
        np.testing.assert_allclose(ellipses.centre_px[i], pixel_from_opencv(np.array([u, v])), atol=2e-3)
        np.testing.assert_allclose(ellipses.semi_axes_px[i], np.sort(axes)[::-1] / 2, atol=2e-3)
        if axes[0] / axes[1] < 0.9:
            assert abs(np.sin(ellipses.angle_rad[i] - np.radians(angle + 90))) < 1e-2


def test_conics_that_are_not_ellipses_are_refused():
    with pytest.raises(BoresightError, match="conic 0 is not a real ellipse"):
        Ellipses.from_conics(np.diag([1.0, -1.0, -1.0])[None])
    with pytest.raises(BoresightError, match="conic 0 is not a real ellipse"):
        Ellipses.from_conics(np.eye(3)[None])
    with pytest.raises(BoresightError, match=r"\(n, 2\) centres"):
        Ellipses(np.zeros((2, 2)), np.zeros((1, 2)), np.zeros(2))


def test_degenerate_conics_are_not_ellipses():
    """The determinant of a degenerate conic has either sign; it must be excluded without an error."""
    some = Ellipses(np.array([[350.0, 120.0], [80.0, 60.0]]), np.array([[9.0, 4.0], [3.0, 3.0]]), np.array([0.4, 0.0]))
    rng = np.random.default_rng(3)
    shapes = rng.normal(size=(500, 2, 2))
    shapes = shapes @ np.swapaxes(shapes, 1, 2)
    centre = rng.uniform(0.0, 500.0, (500, 2, 1))
    pulled = -shapes @ centre
    points = np.block([[shapes, pulled], [np.swapaxes(pulled, 1, 2), -np.swapaxes(pulled, 1, 2) @ centre]])
    broken = np.stack([np.diag([1.0, -1.0, -1.0]), np.eye(3), np.full((3, 3), np.nan)])
    found, real = Ellipses.among(np.concatenate([some.conics(), -some.conics(), broken, points]))
    assert real[:7].tolist() == [True] * 4 + [False] * 3
    np.testing.assert_allclose(found.centre_px[:4], np.tile(some.centre_px, (2, 1)), rtol=1e-12)
    assert (found.semi_axes_px[4:] < 0.1).all()
    assert np.isfinite(found.semi_axes_px).all()


def test_rows_can_be_taken_and_none_is_empty():
    ellipses = drawn()
    assert len(ellipses[:3]) == 3 and len(Ellipses.none()) == 0
    np.testing.assert_allclose(ellipses[:3].radius_px ** 2, ellipses.semi_axes_px[:3].prod(axis=1))
    assert Ellipses.none().points(8)[0].shape == (0, 8, 2)
