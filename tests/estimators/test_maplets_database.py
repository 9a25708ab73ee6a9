"""Maplets cut from shapes: heights against ray casting, coverage, and the stored form."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from boresight.estimators.maplets.build import (
    MapletOptions,
    Plane,
    Surface,
    build_maplets,
    relief,
    sample_heights,
    spread_points,
)
from boresight.estimators.maplets.database import FILE, MapletDatabase
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.bodies import load_body
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View, look_at
from boresight.scenarios.spec.body import BodySpec, BoulderSpec, DetailSpec
from boresight.scenarios.spec.brdf import LambertSpec

RADIUS_M = 100.0
OPTIONS = MapletOptions(spacing_m=4.0, side=17)


def ball(subdivisions=5, albedo=None):
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS_M)
    values = None if albedo is None else albedo(np.asarray(sphere.vertices))
    return TriangleMesh(sphere.vertices, sphere.faces, values)


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    boulders = BoulderSpec(count=300, min_diameter_m=15.0, max_diameter_m=60.0)
    spec = BodySpec(shape="contact-binary", detail=DetailSpec(facets=20_000, seed=3, boulders=boulders))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        return load_body(spec, ()).mesh


@pytest.fixture(scope="module")
def database(rough):
    return build_maplets(rough, MapletOptions(spacing_m=4.0, side=25))


def axes_about(normal):
    first = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def test_heights_of_a_ball_are_those_of_the_formula():
    normal = np.array([0.36, -0.48, 0.8])
    plane = Plane(RADIUS_M * normal, axes_about(normal), 2.0, 41)
    heights, albedo = sample_heights(Surface(ball(6)), plane)
    x, y = np.meshgrid(np.arange(-20, 21) * 2.0, np.arange(-20, 21) * 2.0)
    np.testing.assert_allclose(heights, np.sqrt(RADIUS_M**2 - x**2 - y**2) - RADIUS_M, atol=0.05)
    assert albedo is None


def test_the_ray_tracer_sees_the_heights_where_they_are(rough):
    surface = Surface(rough)
    centre = surface.centroids_m[4321]
    plane = Plane(centre, axes_about(surface.mean_normal(centre, 30.0)), 3.0, 21)
    heights, _ = sample_heights(surface, plane)
    steps = (np.arange(21) - 10) * 3.0
    x, y = np.meshgrid(steps, steps)
    nodes = centre + np.stack([x, y, heights], axis=-1).reshape(-1, 3) @ plane.axes
    # From so far above that lines of sight are vertical to 0.3 mrad.
    above = centre + 1e5 * plane.axes[2]
    looking_down = np.diag([1.0, -1.0, -1.0]) @ plane.axes
    pose = Pose(looking_down, -looking_down @ above)
    camera = Camera.from_fov(100, 100, 0.01)
    view = View(camera, pose, plane.axes[2])
    met = MitsubaRenderer(rough, LambertSpec()).surface(view, camera.project(pose.transform(nodes))).points_body_m
    assert np.linalg.norm(met - nodes, axis=1).max() < 0.02


def test_albedo_is_that_of_the_place():
    mesh = ball(5, lambda v: 1.0 + 0.4 * v[:, 0] / RADIUS_M)
    normal = np.array([0.6, 0.0, 0.8])
    plane = Plane(RADIUS_M * normal, axes_about(normal), 4.0, 21)
    heights, albedo = sample_heights(Surface(mesh), plane)
    steps = (np.arange(21) - 10) * 4.0
    x, y = np.meshgrid(steps, steps)
    nodes = plane.centre_m + np.stack([x, y, heights], axis=-1) @ plane.axes
    np.testing.assert_allclose(albedo, 1.0 + 0.4 * nodes[..., 0] / RADIUS_M, atol=2e-4)


def test_nothing_is_known_beside_the_body():
    normal = np.array([0.0, 0.0, 1.0])
    heights, _ = sample_heights(Surface(ball()), Plane(RADIUS_M * normal, axes_about(normal), 10.0, 31))
    x, y = np.meshgrid(np.arange(-15, 16) * 10.0, np.arange(-15, 16) * 10.0)
    assert np.isnan(heights[np.hypot(x, y) > RADIUS_M]).all()
    assert np.isfinite(heights[np.hypot(x, y) < 90.0]).all()


def test_the_layer_on_top_counts():
    both = ball(4)
    inner = 0.8 * both.vertices_m
    mesh = TriangleMesh(np.concatenate([inner, both.vertices_m]), np.concatenate([both.faces, both.faces + len(inner)]))
    normal = np.array([0.0, 0.6, 0.8])
    plane = Plane(RADIUS_M * normal, axes_about(normal), 2.0, 31)
    heights, _ = sample_heights(Surface(mesh), plane)
    alone, _ = sample_heights(Surface(both), plane)
    np.testing.assert_array_equal(heights, alone)


def test_spread_points_cover_and_keep_their_distance():
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (3000, 3))
    chosen = points[spread_points(points, 0.4)]
    apart = np.linalg.norm(chosen[:, None] - chosen[None], axis=2) + 9.0 * np.eye(len(chosen))
    assert apart.min() > 0.4
    assert np.linalg.norm(points[:, None] - chosen[None], axis=2).min(axis=1).max() <= 0.4


@pytest.mark.parametrize("seed", [None, 3])
@pytest.mark.parametrize("points", [ball(4).vertices_m / 100.0, np.mgrid[-3:4, -3:4, -2:3].reshape(3, -1).T * 1.0])
def test_spread_points_are_those_of_passes_over_all_points(points, seed):
    """Of points at the same distance, which symmetric bodies have, the first counts."""
    chosen = spread_points(points, 0.45, seed)
    distance = np.full(len(points), np.inf)
    for before, after in pairwise(chosen):
        distance = np.minimum(distance, np.sqrt(((points - points[before]) ** 2).sum(axis=1)))
        assert after == np.argmax(distance)
    assert len(chosen) > 2


def test_relief_is_the_slope_beside_the_curvature():
    x, y = np.meshgrid(np.arange(-30, 31) * 1.0, np.arange(-30, 31) * 1.0)
    bowl = 0.01 * x * x - 0.02 * x * y + 0.3 * y
    # Central differences of a parabola are exact but at the border, where they are one-sided.
    assert relief(bowl, 1.0) < 0.005
    wave = 0.5 * np.sin(2.0 * np.pi * x / 12.0)
    assert relief(bowl + wave, 1.0) == pytest.approx(0.5 * 2.0 * np.pi / 12.0 / np.sqrt(2.0), rel=0.05)


def test_the_mesh_of_all_maplets_is_the_body_once(rough, database):
    mesh = database.mesh()
    area, expected = (float(np.linalg.norm(m.area_vectors_m2, axis=1).sum()) for m in (mesh, rough))
    assert 0.97 < area / expected < 1.3
    camera = Camera.from_fov(256, 256, np.radians(18.3))
    patches, body = (MitsubaRenderer(m, LambertSpec(), 1) for m in (mesh, rough))
    for direction in np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.0, 0.8]]]):
        view = View(camera, look_at(2000.0 * direction), direction)
        seen, whole = patches.render(view) > 0.0, body.render(view) > 0.0
        assert (whole & ~seen).sum() < 0.005 * whole.sum()
        assert (seen & ~whole).sum() < 0.005 * whole.sum()


def test_maplets_keep_their_distance_and_prefer_relief(rough, database):
    options = MapletOptions(spacing_m=4.0, side=25)
    strength = np.array([relief(heights, 4.0) for heights in database.heights_m])
    every = Surface(rough)
    flat = [sample_heights(every, Plane(c, axes_about(every.mean_normal(c, 48.0)), 4.0, 25))[0]
            for c in every.centroids_m[::400]]  # fmt: skip
    assert strength[:20].mean() > 1.2 * np.median([relief(heights, 4.0) for heights in flat])
    first = database.centres_m[:20]
    apart = np.linalg.norm(first[:, None] - first[None], axis=2) + 1e6 * np.eye(20)
    assert apart.min() >= options.separation * options.width_m


def test_a_stored_data_base_is_the_same_to_half_a_step(tmp_path):
    mesh = ball(4, lambda v: 1.0 + 0.4 * v[:, 2] / RADIUS_M)
    database = build_maplets(mesh, OPTIONS)
    database.save(tmp_path)
    again = MapletDatabase.load(tmp_path)
    np.testing.assert_array_equal(again.centres_m, database.centres_m)
    np.testing.assert_allclose(again.axes, database.axes, atol=1e-14)
    np.testing.assert_allclose(again.heights_m, database.heights_m, atol=0.005 + 1e-9)
    known = np.isfinite(database.heights_m)
    np.testing.assert_allclose(again.albedo[known], database.albedo[known], atol=1.4 / 65535)
    assert (again.spacing_m, again.side) == (4.0, 17)
    assert again.provenance == database.provenance
    assert (tmp_path / FILE).stat().st_size < 5 * database.heights_m.size


@pytest.mark.parametrize(("largest_m", "step_m"), [(0.0, 0.01), (327.67, 0.01), (327.68, 0.02), (5e4, 2.56)])
def test_heights_of_any_size_are_stored_to_half_a_step(tmp_path, largest_m, step_m):
    """Heights in 16 bits have an error of at most 1/30,000 of the largest, or half a centimetre for small ones."""
    heights = largest_m * np.array([[-1.0, 0.123456, 1.0], [0.5, 0.0, np.nan], [-0.3333, 0.7, 0.001]])[None]
    MapletDatabase(np.zeros((1, 3)), np.eye(3)[None], heights, 30.0).save(tmp_path)
    again = MapletDatabase.load(tmp_path).heights_m
    np.testing.assert_allclose(again, heights, atol=0.5 * step_m + 1e-9)
    np.testing.assert_allclose(again / step_m, np.round(again / step_m), atol=1e-6)


def test_the_same_shape_gives_the_same_file(tmp_path):
    for name in ("a", "b"):
        build_maplets(ball(4), OPTIONS).save(tmp_path / name)
    assert (tmp_path / "a" / FILE).read_bytes() == (tmp_path / "b" / FILE).read_bytes()


def test_a_damaged_file_is_named(tmp_path):
    with pytest.raises(BoresightError, match=r"maplets\.npz: cannot be read .*build it again"):
        MapletDatabase.load(tmp_path)
    (tmp_path / FILE).write_bytes(b"no archive")
    with pytest.raises(BoresightError, match=r"maplets\.npz: cannot be read"):
        MapletDatabase.load(tmp_path)
    np.savez_compressed(tmp_path / FILE, head=np.frombuffer(b'{"format": "other"}', dtype=np.uint8))
    with pytest.raises(BoresightError, match="is not format 'boresight-maplets'"):
        MapletDatabase.load(tmp_path)


def test_wrong_arrays_are_refused():
    database = build_maplets(ball(4), OPTIONS)
    good = (database.centres_m, database.axes, database.heights_m, 4.0)
    with pytest.raises(BoresightError, match="N, S, S"):
        MapletDatabase(good[0][:-1], *good[1:])
    with pytest.raises(BoresightError, match="right-handed"):
        MapletDatabase(good[0], good[1][:, ::-1], *good[2:])
    with pytest.raises(BoresightError, match="no surface at its centre"):
        MapletDatabase(good[0], good[1], np.full_like(good[2], np.nan), 4.0)


def test_an_even_side_is_refused():
    with pytest.raises(ValueError, match="side must be odd"):
        MapletOptions(side=24)
