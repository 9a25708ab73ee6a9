"""Images of a local shape and of an albedo map against the analytic surface, pixel by pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.bodies import load_body
from boresight.scenarios.bodies.albedo import with_albedo_map
from boresight.scenarios.cache import Cache
from boresight.scenarios.geometry import Camera, View, look_at
from boresight.scenarios.spec.body import AlbedoMapSpec, BodySpec, LocalSpec
from boresight.scenarios.spec.brdf import LambertSpec

RADIUS_M = 100.0
UP = np.array([0.0, 0.6, 0.8])
ACROSS = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
# 48 degrees from `UP`: no slope of the site is in shadow.
SUN = 0.67 * UP + 0.65 * ACROSS[0] + 0.36 * ACROSS[1]


@pytest.fixture(params=["llvm", "scalar"])
def variant(request):
    return request.getfixturevalue(request.param)


def heights(x, y):
    return np.sqrt(RADIUS_M**2 - x**2 - y**2) + 0.5 + 0.3 * np.sin(x / 3.0) * np.cos(y / 4.0)


def slopes(x, y):
    step = 1e-5
    return [(heights(x + a, y + b) - heights(x - a, y - b)) / (2.0 * step) for a, b in ((step, 0.0), (0.0, step))]


def rays(view):
    rows, columns = np.mgrid[: view.camera.height_px, : view.camera.width_px] + 0.5
    uv = np.stack([columns.ravel(), rows.ravel()], axis=1)
    directions = view.camera.unproject(uv) @ view.T_cam_body.rotation
    return directions / np.linalg.norm(directions, axis=1)[:, None]


def analytic_image(view):
    """Lambert's law on the analytic site, met by Newton's method from the plane on its top."""
    directions, origin = rays(view), view.T_cam_body.camera_position_m
    along = (RADIUS_M - origin @ UP) / (directions @ UP)
    for _ in range(40):
        points = origin + along[:, None] * directions
        x, y = points @ ACROSS[0], points @ ACROSS[1]
        along += (heights(x, y) - points @ UP) / (directions @ UP)
    normals = np.outer(np.ones_like(x), UP) - sum(np.outer(s, a) for s, a in zip(slopes(x, y), ACROSS, strict=True))
    cosines = normals @ view.sun_dir_body / np.linalg.norm(normals, axis=1)
    shape = (view.camera.height_px, view.camera.width_px)
    return 0.3 * cosines.reshape(shape), np.maximum(np.abs(x), np.abs(y)).max()


def test_the_image_of_a_local_shape_is_that_of_the_analytic_surface(variant, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS_M)  # facets of 15 m
    ball.export(tmp_path / "ball.ply")
    ticks = np.linspace(-15.0, 15.0, 151)
    x, y = (part.ravel() for part in np.meshgrid(ticks, ticks))
    first = (np.arange(150)[:, None] * 151 + np.arange(150)).ravel()
    faces = np.concatenate(
        [np.stack([first, first + 1, first + 152], 1), np.stack([first, first + 152, first + 151], 1)]
    )
    vertices = np.outer(x, ACROSS[0]) + np.outer(y, ACROSS[1]) + np.outer(heights(x, y), UP)
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "site.ply")
    spec = BodySpec(shape="ball.ply", local=(LocalSpec(shape="site.ply", blend_m=2.0),))
    view = View(Camera.from_fov(64, 64, np.radians(20.0)), look_at(150.0 * UP, 0.3), SUN)
    images = {}
    for name, one in (("site", spec), ("globe", spec.model_copy(update={"local": None}))):
        mesh = load_body(one, [tmp_path], Cache(tmp_path / "cache", 10**9)).mesh
        images[name] = MitsubaRenderer(mesh, LambertSpec(albedo=0.3), 16, variant=variant).render(view)
    expected, reach_m = analytic_image(view)
    assert reach_m < 12.9, "all of the image is within the site, where it has its full height"
    relative = np.abs(images["site"] / expected - 1.0)
    assert np.median(relative) < 3e-3
    assert relative.max() < 0.03
    assert np.abs(images["globe"] / expected - 1.0).max() > 0.15


def test_the_image_of_a_map_is_the_image_without_it_times_the_map(variant, tmp_path):
    longitude = np.radians(-180.0 + (np.arange(360) + 0.5))
    values = np.tile(20000.0 + 10000.0 * np.cos(longitude), (180, 1))
    cv2.imwrite(str(tmp_path / "map.png"), np.round(values).astype(np.uint16))
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)
    ball.export(tmp_path / "ball.ply")
    plain = load_body(BodySpec(shape="ball.ply"), [tmp_path]).mesh
    mapped = with_albedo_map(plain, AlbedoMapSpec(file="map.png", unity=20000.0), tmp_path / "map.png")
    # From the far side of the map, over its seam at 180 deg.
    view = View(Camera.from_fov(48, 48, np.radians(20.0)), look_at(np.array([-600.0, 30.0, 150.0])), [-1.0, 0.4, 0.2])
    bare, painted = (MitsubaRenderer(one, LambertSpec(), 4, variant=variant).render(view) for one in (plain, mapped))
    directions, origin = rays(view), view.T_cam_body.camera_position_m
    along = -(directions @ origin)
    half = along**2 - origin @ origin + RADIUS_M**2
    points = origin + (along - np.sqrt(np.maximum(half, 0.0)))[:, None] * directions
    factor = 1.0 + 0.5 * points[:, 0] / np.hypot(points[:, 0], points[:, 1])
    # Not where a pixel is over the limb or the pole.
    seen = (half > (0.45 * RADIUS_M) ** 2) & (bare.ravel() > 0.02) & (np.abs(points[:, 2]) < 60.0)
    assert seen.sum() > 300
    assert np.ptp(factor[seen]) > 0.2
    np.testing.assert_allclose((painted / np.where(bare > 0.0, bare, 1.0)).ravel()[seen], factor[seen], atol=4e-3)
