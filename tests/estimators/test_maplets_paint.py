"""Albedo of maplets from images: a ball of known albedo, drawn in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import trimesh

import boresight
from boresight.estimators.contract import NoProductError
from boresight.estimators.maplets.build import MapletOptions, build_maplets
from boresight.estimators.maplets.paint import paint, seen
from boresight.scenarios.geometry import Camera, View, look_at
from boresight.scenarios.spec.brdf import LambertSpec

RADIUS_M, RANGE_M = 100.0, 600.0
CAMERA = Camera(300, 300, 700.0, 700.0, 150.0, 150.0)
SUN = np.array([0.8, 0.36, 0.48])
STRIPES = np.array([0.03, 0.12, 0.05])


def albedo(points_m):
    return 1.0 + 0.4 * np.sin(points_m @ STRIPES)


@dataclass
class Drawn:
    """An image of the ball: Lambert's law at the intersection of each line of sight with the sphere."""

    view: View
    exposure: float = 1.0

    def deproject(self, uv_px):
        pose = self.view.T_cam_body
        rays = CAMERA.unproject(uv_px) @ pose.rotation
        start = pose.camera_position_m
        along = rays @ start
        root = along**2 - start @ start + RADIUS_M**2
        return start + (-along - np.sqrt(np.where(root < 0.0, np.nan, root)))[:, None] * rays

    @property
    def pixels(self):
        v, u = np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5
        points = self.deproject(np.stack([u.ravel(), v.ravel()], axis=1))
        value = albedo(points) * np.maximum(points @ self.view.sun_dir_body / RADIUS_M, 0.0)
        return (self.exposure * np.nan_to_num(value)).reshape(v.shape).astype(np.float32)


def drawn(x, y, z, exposure=1.0, range_m=RANGE_M, sun=SUN):
    return Drawn(View(CAMERA, look_at(range_m * np.array([x, y, z]), np.zeros(3)), sun), exposure)


@pytest.fixture(scope="module")
def mesh():
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)
    return boresight.TriangleMesh(np.asarray(sphere.vertices), np.asarray(sphere.faces, dtype=np.int32))


@pytest.fixture(scope="module")
def painted(mesh):
    """Paint maplets that are built once with the brightness of images."""
    maplets = build_maplets(mesh, MapletOptions(spacing_m=1.5, side=25))
    renderer = boresight.MitsubaRenderer(maplets.mesh(), LambertSpec(albedo=1.0), 4)
    return lambda images: paint(maplets, renderer, images)


def test_the_albedo_is_that_of_the_ground_whatever_the_exposure(painted):
    images = [drawn(1.0, 0.0, 0.0), drawn(0.96, 0.28, 0.0, exposure=300.0)]
    found = painted(images)
    nodes = found.nodes_m.reshape(-1, 3)
    values = found.albedo.reshape(-1)
    inner = nodes @ np.array([1.0, 0.0, 0.0]) > 0.7 * RADIUS_M
    lit = inner & (nodes @ SUN > 0.5 * RADIUS_M)
    ratio = values[lit] / albedo(nodes[lit])
    assert lit.sum() > 3000
    # Facets are 4 m wide, and stripes 46 m: the common scale apart, shading of facets is what is left.
    assert np.std(ratio / np.median(ratio)) < 0.02
    # The far side, which no image shows.
    assert (values[nodes[:, 0] < -0.3 * RADIUS_M] == 1.0).all()


def test_ground_that_fills_the_frame_is_not_taken_for_sky(painted):
    image = drawn(1.0, 0.0, 0.0, range_m=280.0, sun=np.array([1.0, 0.0, 0.0]))
    assert image.pixels[::299, ::299].min() > 0.3 * image.pixels.max()
    found = painted([image])
    nodes, values = found.nodes_m.reshape(-1, 3), found.albedo.reshape(-1)
    shown = values != 1.0
    ratio = values[shown] / albedo(nodes[shown])
    assert shown.sum() > 3000
    assert np.std(ratio / np.median(ratio)) < 0.03


def test_the_background_beside_the_body_is_taken_off(painted):
    image = drawn(1.0, 0.0, 0.0)

    class Raised(Drawn):
        @property
        def pixels(self):
            return super().pixels + np.float32(0.4)

    plain, raised = painted([image]), painted([Raised(image.view)])
    np.testing.assert_allclose(raised.albedo, plain.albedo, atol=0.02)


def test_a_black_image_paints_nothing(painted):
    image = drawn(1.0, 0.0, 0.0)
    black = drawn(1.0, 0.0, 0.0, exposure=0.0)
    np.testing.assert_array_equal(painted([image, black]).albedo, painted([image]).albedo)
    with pytest.raises(NoProductError, match="no image of the survey shows a lit part"):
        painted([black])


def test_points_are_seen_in_the_image_before_the_limb_and_not_behind_the_body(mesh):
    image = drawn(1.0, 0.0, 0.0)
    angle = np.radians([0.0, 40.0, 68.0, 180.0])
    points = RADIUS_M * np.stack([np.cos(angle), np.sin(angle), np.zeros(4)], axis=1)
    normals = points / RADIUS_M
    # At 68 deg from the line to the camera the sight is 77 deg from the normal.
    np.testing.assert_array_equal(seen(points, normals, image, 1.0), [True, True, False, False])
    # A point on a normal towards the camera, but 20 m below the surface.
    np.testing.assert_array_equal(seen(0.8 * points, normals, image, 1.0), [False] * 4)


def test_maplets_cover_what_is_wanted(mesh):
    image = drawn(1.0, 0.0, 0.0)
    middles = mesh.corners_m.mean(axis=1)
    wanted = seen(middles, mesh.normals, image, 1.5)
    maplets = build_maplets(mesh, MapletOptions(spacing_m=1.5, side=25), wanted)
    covered = np.any([maplets.contains(i, middles[wanted]) for i in range(len(maplets))], axis=0)
    assert covered.mean() > 0.97
    assert seen(maplets.anchors_m, maplets.axes[:, 2], image, 1.5).mean() > 0.9


def test_images_that_show_nothing_make_no_maplets(mesh, painted):
    with pytest.raises(NoProductError, match="the middle of no facet"):
        build_maplets(mesh, MapletOptions(), np.zeros(len(mesh.faces), dtype=bool))
    night = Drawn(View(CAMERA, look_at(RANGE_M * -SUN, np.zeros(3)), SUN))
    with pytest.raises(NoProductError, match="no image of the survey shows a lit part"):
        painted([night])
