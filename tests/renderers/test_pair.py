"""Two bodies in one image against closed forms of spheres, and OpenCV's projection."""

import cv2
import numpy as np
import pytest
import trimesh

from boresight.renderers.mitsuba3 import MitsubaRenderer, PairRenderer, outlines_m
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View, look_at
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera(240, 224, 217.0, 225.0, 118.3, 113.8)
FIRST_M, SECOND_M = 400.0, 90.0
SUN = np.array([0.8, 0.0, 0.6])


def sphere(radius_m: float) -> TriangleMesh:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius_m)
    return TriangleMesh(np.array(ball.vertices), np.array(ball.faces))


@pytest.fixture(scope="module", params=["llvm", "scalar"])
def pair(request):
    variant = request.getfixturevalue(request.param)
    spheres = sphere(FIRST_M), sphere(SECOND_M)

    def renderer_of(mesh, outline_m):
        return MitsubaRenderer(mesh, LambertSpec(), 1, "flat", variant, outline_m)

    return PairRenderer(*spheres, 0.5, renderer_of)


def at(camera_m, second_m) -> View:
    turn = cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0]
    second = None if second_m is None else Pose(turn, np.asarray(second_m, dtype=float))
    return View(CAMERA, look_at(np.asarray(camera_m, dtype=float), 0.4), SUN, second)


def centres() -> np.ndarray:
    v, u = np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5
    return np.column_stack([u.ravel(), v.ravel()])


def test_the_shadow_on_the_first_body_is_a_cylinder_about_the_sun_line(pair):
    """The Sun is a point at infinity: the umbra is all within a radius of the second body of the line to the Sun."""
    offset_m = np.array([0.0, 150.0, 0.0])
    view = at([1200.0, -900.0, 2000.0], 1190.0 * SUN + offset_m)
    seen, image = pair.surface(view, centres()), pair.render(view).ravel()
    first = seen.hit & (seen.facets < len(pair.first.faces))
    points, towards = seen.points_body_m[first], seen.points_body_m[first] @ SUN
    across_m = np.linalg.norm(points - towards[:, None] * SUN - offset_m, axis=1)
    sure = (np.abs(across_m - SECOND_M) > 1.0) & (np.abs(towards) > 30.0)
    lit = (towards > 0.0) & (across_m > SECOND_M)
    assert (lit[sure] == seen.lit[first][sure]).all()
    assert ((image[first] > 0.0)[sure] == lit[sure]).all()
    dark = (towards > 30.0) & ~seen.lit[first]
    assert dark.sum() > 100
    # The pixel of the middle of the umbra, where the axis of the cylinder enters the first body.
    entry = offset_m + np.sqrt(FIRST_M**2 - 150.0**2) * SUN
    expected = cv2.projectPoints(
        entry[None], cv2.Rodrigues(view.T_cam_body.rotation)[0], view.T_cam_body.translation_m, CAMERA.matrix, None
    )[0].ravel()
    near = np.linalg.norm(centres()[first] - expected, axis=1) < 3.0
    assert near.sum() > 20
    assert dark[near].all()


def test_the_first_body_shadows_the_second(pair):
    view = at([1200.0, -900.0, 2000.0], -1190.0 * SUN)
    seen = pair.surface(view, centres())
    second = seen.facets >= len(pair.first.faces)
    assert second.sum() > 60
    assert not seen.lit[second].any()
    assert not pair.render(view).ravel()[second].any()


@pytest.mark.parametrize("towards", [1190.0, -1190.0, 0.0], ids=["transit", "occultation", "beside"])
def test_the_nearer_body_hides_the_other(pair, towards):
    """Against circles of contact of the lines of sight with each sphere, projected and filled by OpenCV."""
    camera_m = np.array([2500.0, 300.0, 700.0])
    across = np.array([-0.1, 0.8, 0.59])
    view = at(camera_m, towards * camera_m / np.linalg.norm(camera_m) + (240.0 if towards else 600.0) * across)
    discs = [disc(view, np.zeros(3), FIRST_M), disc(view, view.T_body_second.translation_m, SECOND_M)]
    assert all(one.sum() > 100 for one in discs)
    assert (discs[0] & discs[1]).any() == bool(towards)
    expected = np.where(discs[1], 2, np.where(discs[0], 1, 0))
    if towards < 0.0:
        expected = np.where(discs[0], 1, np.where(discs[1], 2, 0))
    seen = pair.surface(view, centres())
    hits, lit = seen.facets.reshape(expected.shape), seen.lit.reshape(expected.shape)
    found = np.where(hits >= len(pair.first.faces), 2, np.where(hits >= 0, 1, 0))
    edges = np.zeros(expected.shape, dtype=np.uint8)
    for one in discs:
        edges |= cv2.morphologyEx(one.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8))
    np.testing.assert_array_equal(found[edges == 0], expected[edges == 0])
    np.testing.assert_array_equal((pair.render(view) > 0.0)[edges == 0], lit[edges == 0])


def disc(view: View, centre_m: np.ndarray, radius_m: float) -> np.ndarray:
    to_centre = centre_m - view.T_cam_body.camera_position_m
    distance_m = np.linalg.norm(to_centre)
    axis = to_centre / distance_m
    x = np.cross(axis, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    turn = np.linspace(0.0, 2.0 * np.pi, 400)[:, None]
    rim = np.cos(turn) * x + np.sin(turn) * np.cross(axis, x)
    sine = radius_m / distance_m
    points = centre_m - radius_m * sine * axis + radius_m * np.sqrt(1.0 - sine**2) * rim
    pose = view.T_cam_body
    uv = cv2.projectPoints(points, cv2.Rodrigues(pose.rotation)[0], pose.translation_m, CAMERA.matrix, None)[0]
    mask = np.zeros((CAMERA.height_px, CAMERA.width_px), dtype=np.uint8)
    cv2.fillPoly(mask, [np.round(16.0 * (uv - 0.5)).astype(np.int32)], 1, shift=4)
    return mask.astype(bool)


def test_the_albedo_of_the_second_body_is_its_own(pair):
    """At one incidence both are as bright as their albedos."""
    view = at(3500.0 * SUN, 1190.0 * np.array([0.0, 1.0, 0.0]))
    image = pair.render(view)
    middles = view.T_cam_body.transform(np.array([FIRST_M * SUN, [SECOND_M * 0.8, 1190.0, SECOND_M * 0.6]]))
    (u, v), (u2, v2) = CAMERA.project(middles).astype(int)
    assert image[v2, u2] / image[v, u] == pytest.approx(0.5, rel=0.02)


def test_a_view_without_a_second_body_shows_the_first_alone(pair):
    view = at([1200.0, -900.0, 2000.0], 1190.0 * SUN)
    both = pair.render(view)
    alone = pair.render(at([1200.0, -900.0, 2000.0], None))
    assert (both != alone).any()
    np.testing.assert_array_equal(alone, pair.renderer_of(pair.first, None).render(view))
    np.testing.assert_array_equal(pair.render(view), both)


def test_outlines_hold_each_body(pair):
    view = at([2500.0, 300.0, 700.0], [0.0, 1190.0, 30.0])
    (first, second), (alone,) = outlines_m(pair, view), outlines_m(pair, at([2500.0, 300.0, 700.0], None))
    assert np.abs(np.linalg.norm(first, axis=1) - FIRST_M).max() < 1.0
    assert np.abs(np.linalg.norm(second - [0.0, 1190.0, 30.0], axis=1) - SECOND_M).max() < 1.0
    np.testing.assert_array_equal(first, alone)


def test_a_camera_inside_the_second_body_is_refused(pair):
    with pytest.raises(BoresightError, match="inside the body"):
        pair.render(at([0.0, 1200.0, 20.0], [0.0, 1190.0, 0.0]))
