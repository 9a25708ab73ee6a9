"""Derivatives of images by the pose: against a sphere in closed form and against differences of renderings."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, RadialDistortion, TriangleMesh, View
from boresight.scenarios.spec.brdf import LambertSpec, LommelSeeligerSpec

CAMERA = Camera.from_fov(160, 140, np.radians(20.0))
BLUR_PX = 1.5
RADIUS_M = 250.0
ALBEDO = 0.2
SUN_CAM = np.array([0.45, -0.25, -1.0]) / np.linalg.norm([0.45, -0.25, -1.0])
# Turns and shifts that move the edge of the body by about half a pixel.
STEPS = np.array([0.01, 0.01, 0.01, 2.5, 2.5, 20.0])


def pose_at(x_m: float, y_m: float, z_m: float) -> Pose:
    turn = cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0]
    return Pose(turn, np.array([x_m, y_m, z_m]))


def view_at(pose: Pose) -> View:
    return View(CAMERA, pose, pose.rotation.T @ SUN_CAM)


def sphere_image(pose: Pose, n: int = 4) -> np.ndarray:
    """Radiance factor of a Lambert sphere in closed form: albedo times cos i, n x n samples a pixel."""
    steps = (np.arange(n) + 0.5) / n
    u = (np.arange(CAMERA.width_px)[:, None] + steps).ravel()
    v = (np.arange(CAMERA.height_px)[:, None] + steps).ravel()
    x, y = np.meshgrid((u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ pose.translation_m
    under = along**2 - pose.translation_m @ pose.translation_m + RADIUS_M**2
    points = rays * (along - np.sqrt(np.maximum(under, 0.0)))[..., None]
    normals = (points - pose.translation_m) / RADIUS_M
    value = np.where(under > 0.0, ALBEDO * np.maximum(normals @ SUN_CAM, 0.0), 0.0)
    return value.reshape(CAMERA.height_px, n, CAMERA.width_px, n).mean(axis=(1, 3))


def differences(image_at, pose: Pose) -> list[np.ndarray]:
    columns = []
    for axis, step in enumerate(STEPS):
        change = np.zeros(6)
        change[axis] = step
        ahead, behind = (image_at(pose.perturbed(sign * change[:3], sign * change[3:])) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * step))
    return columns


def blurred(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(np.asarray(image, dtype=np.float64), (0, 0), BLUR_PX)


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(blurred(found) - blurred(expected)) / np.linalg.norm(blurred(expected)))


@pytest.fixture(scope="module")
def smooth_ball(llvm, ball) -> MitsubaRenderer:
    return MitsubaRenderer(ball, LambertSpec(albedo=ALBEDO), 4, shading="smooth", variant=llvm)


@pytest.mark.parametrize("pose", [pose_at(0.0, 0.0, 2000.0), pose_at(130.0, -80.0, 1700.0)], ids=["centre", "aside"])
def test_a_moving_sphere_has_the_derivatives_of_its_closed_form(smooth_ball, pose):
    """Limb, terminator and shading; what is left is sampling: the renderer has 4 samples a pixel."""
    image, found = smooth_ball.render_with_derivatives(view_at(pose))
    np.testing.assert_allclose(blurred(image), blurred(sphere_image(pose)), atol=0.03 * ALBEDO)
    for axis, expected in enumerate(differences(sphere_image, pose)[3:], start=3):
        assert relative_error(found[axis], expected) < 0.05, axis


def test_a_turn_of_a_sphere_about_its_centre_changes_nothing(smooth_ball):
    _, found = smooth_ball.render_with_derivatives(view_at(pose_at(130.0, -80.0, 1700.0)))
    moved = np.abs(blurred(found[3])).max() * RADIUS_M
    for turn in found[:3]:
        assert np.abs(blurred(turn)).max() < 0.1 * moved


def test_a_turn_moves_the_albedo(llvm, ball):
    """Reference: differences of renderings with 16 samples a pixel, of spots that no shadow touches."""
    spots = 1.0 + 0.4 * np.sin(ball.vertices_m @ np.array([0.04, 0.03, -0.02]))
    painted = TriangleMesh(ball.vertices_m, ball.faces, albedo=spots)
    coarse, fine = (
        MitsubaRenderer(painted, LambertSpec(albedo=ALBEDO), n, shading="smooth", variant=llvm) for n in (4, 16)
    )
    pose = pose_at(40.0, 30.0, 2000.0)
    _, found = coarse.render_with_derivatives(view_at(pose))
    for axis, expected in enumerate(differences(lambda p: fine.render(view_at(p)), pose)):
        assert relative_error(found[axis], expected) < 0.1, axis


def test_emission_and_phase_follow_the_camera(llvm, ball):
    """A turn changes nothing of a sphere, whatever its law; shifts are as differences where it fills the frame."""
    law = LommelSeeligerSpec(kind="lommel-seeliger", w=0.3, b=0.3, c=0.4)
    renderer, near = MitsubaRenderer(ball, law, 4, shading="smooth", variant=llvm), Camera.from_fov(40, 32, 0.05)

    def view(pose: Pose) -> View:
        return View(near, pose, pose.rotation.T @ SUN_CAM)

    pose = pose_at(40.0, 30.0, 2000.0)
    _, found = renderer.render_with_derivatives(view(pose))
    for axis, expected in enumerate(differences(lambda p: renderer.render(view(p)), pose)[3:], start=3):
        assert relative_error(found[axis], expected) < 0.05, axis
    for turn in found[:3]:
        assert np.abs(blurred(turn)).max() < 0.1 * np.abs(blurred(found[3])).max() * RADIUS_M


def test_facets_and_cast_shadows_are_as_differences_but_where_shadows_wander(llvm, rock):
    """Cast shadows move with the surface: shifts are whole, turns that move shadows over it are near."""
    coarse, fine = (MitsubaRenderer(rock, LambertSpec(albedo=ALBEDO), n, variant=llvm) for n in (4, 16))
    pose = pose_at(40.0, 30.0, 2000.0)
    _, found = coarse.render_with_derivatives(view_at(pose))
    expected = differences(lambda p: fine.render(view_at(p)), pose)
    errors = [relative_error(found[axis], column) for axis, column in enumerate(expected)]
    assert max(errors[3:]) < 0.1, errors
    assert max(errors[:3]) < 0.3, errors


def test_the_image_is_the_rendered_one_in_any_strips(llvm, rock, monkeypatch):
    """Windows begin elsewhere, so that a few samples on edges may fall to the other side."""
    renderer = MitsubaRenderer(rock, LambertSpec(), 4, variant=llvm)
    view = view_at(pose_at(40.0, 30.0, 2000.0))
    image, derivatives = renderer.render_with_derivatives(view)
    assert (np.abs(image - renderer.render(view)) > 1e-5).mean() < 1e-3
    monkeypatch.setattr("boresight.renderers.mitsuba3.renderer._MAX_SAMPLES", 6 * 160 * 4 * 16)
    in_strips, derivatives_in_strips = renderer.render_with_derivatives(view)
    assert (np.abs(image - in_strips) > 1e-5).mean() < 1e-3
    scale = np.abs(derivatives).max(axis=(1, 2), keepdims=True)
    assert (np.abs(derivatives - derivatives_in_strips) / scale > 1e-3).mean() < 1e-2


def test_the_same_bits_again_and_nothing_where_the_body_is_out_of_sight(llvm, rock):
    renderer = MitsubaRenderer(rock, LambertSpec(), 4, variant=llvm)
    view = view_at(pose_at(40.0, 30.0, 2000.0))
    for one, other in zip(renderer.render_with_derivatives(view), renderer.render_with_derivatives(view), strict=True):
        np.testing.assert_array_equal(one, other)
    for nothing in renderer.render_with_derivatives(view_at(pose_at(9000.0, 0.0, 2000.0))):
        assert not nothing.any()


def test_what_cannot_be_differentiated_is_refused(scalar, llvm, rock):
    view = view_at(pose_at(0.0, 0.0, 2000.0))
    slow = MitsubaRenderer(rock, LambertSpec(), 1, variant=scalar)
    assert not slow.differentiable
    with pytest.raises(BoresightError, match="scalar_rgb gives no derivatives"):
        slow.render_with_derivatives(view)
    camera = Camera(**{name: getattr(CAMERA, name) for name in ("width_px", "height_px", "fx_px", "fy_px", "cx_px")},
                    cy_px=CAMERA.cy_px, distortion=RadialDistortion(k1=-0.1))  # fmt: skip
    through_a_lens = View(camera, view.T_cam_body, view.sun_dir_body)
    able = MitsubaRenderer(rock, LambertSpec(), 1, variant=llvm)
    assert able.differentiable
    with pytest.raises(BoresightError, match="pinhole"):
        able.render_with_derivatives(through_a_lens)
