"""De-projection against analytic bodies, brute force in double precision and golden rays."""

import json
from contextlib import nullcontext

import cv2
import numpy as np
import pytest
import trimesh
from mission_data import data_path, needs_data
from scipy.spatial import Delaunay

from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.renderers.mitsuba3.rays import PixelWindow, body_window, check_outside, outline_points
from boresight.scenarios.errors import BoresightError, InsideBodyError
from boresight.scenarios.geometry import Camera, Pose, TriangleMesh, View, look_at
from boresight.scenarios.spec.brdf import LambertSpec

GOLDEN, ITOKAWA = "golden/itokawa_q64_rays.json", "shapes/itokawa_gaskell_q64.ply"


@pytest.fixture(params=["llvm", "scalar"])
def variant(request):
    return request.getfixturevalue(request.param)


def brute_force(mesh: TriangleMesh, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest facet (N,), -1 where missed, and distance (N,) along each ray: every facet tried in turn."""
    a, b, c = np.moveaxis(mesh.corners_m, 1, 0)
    normal = np.cross(b - a, c - a)
    facets, distances = np.full(len(origins), -1), np.full(len(origins), np.inf)
    for k, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.einsum("fi,fi->f", a - origin, normal) / (normal @ direction)
            point = origin + t[:, None] * direction
            inside = t > 0.0
            for p, q in ((a, b), (b, c), (c, a)):
                inside &= np.einsum("fi,fi->f", np.cross(q - p, point - p), normal) >= 0.0
        t = np.where(inside, t, np.inf)
        if np.isfinite(t.min()):
            facets[k], distances[k] = t.argmin(), t.min()
    return facets, distances


def test_points_facets_and_light_are_those_of_brute_force(variant, looking):
    """On a lobed body of 5,120 facets; positions within 1e-6 px of a facet's or a shadow's edge may differ."""
    sphere = trimesh.creation.icosphere(subdivisions=4)
    lobes = 1.0 + 0.4 * np.sin(3.0 * sphere.vertices[:, :1] + 1.0) * np.cos(4.0 * sphere.vertices[:, 1:2])
    mesh = TriangleMesh(sphere.vertices * lobes * [280.0, 160.0, 150.0], sphere.faces)
    camera = Camera(100, 80, 300.0, 330.0, 52.0, 39.0)
    view = looking(camera, [700.0, -1100.0, 500.0], [0.9, -0.1, -0.2])
    uv = np.random.default_rng(2).uniform(0.0, [100.0, 80.0], (400, 2))
    hits = MitsubaRenderer(mesh, LambertSpec(), 1, variant=variant).surface(view, uv)
    origin = view.T_cam_body.camera_position_m
    directions = camera.unproject(uv) @ view.T_cam_body.rotation
    facets, distances = brute_force(mesh, np.tile(origin, (400, 1)), directions)
    assert 60 < hits.hit.sum() < 390
    assert (hits.facets == facets).mean() > 0.995
    agreed = hits.hit & (hits.facets == facets)
    np.testing.assert_allclose(
        hits.points_body_m[agreed], (origin + distances[:, None] * directions)[agreed], atol=1e-6
    )
    np.testing.assert_allclose(hits.normals_body[agreed], mesh.normals[facets[agreed]], atol=1e-12)
    starts = hits.points_body_m[agreed] + 1e-3 * hits.normals_body[agreed]
    blocked, _ = brute_force(mesh, starts, np.tile(view.sun_dir_body, (len(starts), 1)))
    facing = hits.normals_body[agreed] @ view.sun_dir_body > 0.0
    expected = facing & (blocked < 0)
    assert (facing & ~expected).sum() > 10  # cast shadows, not only the night side
    assert (hits.lit[agreed] == expected).mean() > 0.99
    assert np.isnan(hits.points_body_m[~hits.hit]).all()
    assert not hits.lit[~hits.hit].any()


def test_de_projected_points_project_back(variant, rock, looking):
    """To a millionth of a pixel by OpenCV: double precision all the way."""
    camera = Camera.from_fov(128, 128, np.radians(18.0))
    view = looking(camera, [900.0, -1500.0, 700.0], [1.0, 0.0, 0.2])
    uv = np.random.default_rng(5).uniform(30.0, 98.0, (200, 2))
    hits = MitsubaRenderer(rock, LambertSpec(), 1, "smooth", variant).surface(view, uv)
    pose = view.T_cam_body
    back, _ = cv2.projectPoints(
        hits.points_body_m[hits.hit], cv2.Rodrigues(pose.rotation)[0], pose.translation_m, camera.matrix, None
    )
    assert hits.hit.sum() > 100
    np.testing.assert_allclose(back[:, 0], uv[hits.hit], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(hits.normals_body[hits.hit], axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("range_m", [600.0, 2e3, 1e5, 1e7])
def test_precision_does_not_fade_with_range(variant, ball, range_m):
    """Points of a sphere of 250 m, from 600 m to 10,000 km, with the focal length to match."""
    camera = Camera.from_fov(64, 64, 2.0 * np.arctan(280.0 / range_m))
    position = np.array([0.3, -0.8, 0.52]) / np.linalg.norm([0.3, -0.8, 0.52]) * range_m
    view = View(camera, look_at(position), position)
    uv = np.random.default_rng(6).uniform(0.0, 64.0, (300, 2))
    hits = MitsubaRenderer(ball, LambertSpec(), 1, "smooth", variant).surface(view, uv)
    along = camera.unproject(uv) @ view.T_cam_body.rotation
    nearest = np.linalg.norm(np.cross(position, along), axis=1)  # distance of each line of sight from the centre
    np.testing.assert_array_equal(hits.hit[np.abs(nearest - 250.0) > 0.1], nearest[np.abs(nearest - 250.0) > 0.1] < 250)
    radius = np.linalg.norm(hits.points_body_m[hits.hit], axis=1)
    assert radius.max() <= 250.0 + 1e-9
    assert radius.min() > 250.0 - 0.03  # sagitta of a facet
    off_line = np.linalg.norm(np.cross(hits.points_body_m[hits.hit] - position, along[hits.hit]), axis=1)
    assert off_line.max() < 1e-6 + 1e-13 * range_m
    radial = hits.points_body_m[hits.hit] / radius[:, None]
    assert np.einsum("ni,ni->n", radial, hits.normals_body[hits.hit]).min() > 0.99999


@needs_data(GOLDEN, ITOKAWA)
def test_golden_rays_on_itokawa(variant):
    """Rays of an independent ray tracer; its points are given to 0.1 mm."""
    body = trimesh.load(data_path(ITOKAWA), process=False)
    mesh = TriangleMesh(np.asarray(body.vertices) * 1000.0, body.faces)
    renderer = MitsubaRenderer(mesh, LambertSpec(), 1, variant=variant)
    camera = Camera.from_fov(11, 11, np.radians(1.0))
    for ray in json.loads(data_path(GOLDEN).read_text()):
        position, look = np.array(ray["observer_km"]) * 1000.0, np.array(ray["look"], dtype=float)
        right = np.roll(look, 1)
        rotation = np.stack([right, np.cross(look, right), look])
        view = View(camera, Pose(rotation, -rotation @ position), -look)
        hits = renderer.surface(view, np.array([[5.5, 5.5]]))
        first = ray["hits"][0]
        assert hits.facets[0] == first["prim"]
        np.testing.assert_allclose(hits.points_body_m[0], np.array(first["point_km"]) * 1000.0, atol=2e-4)
        np.testing.assert_allclose(hits.normals_body[0], first["normal"], atol=1e-5)
        assert hits.lit[0]


def test_a_body_in_front_of_another_hides_and_shadows_it(variant):
    """Two plates facing the camera and the Sun, one above the other: the upper one's shadow has a known edge."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    lower = np.column_stack([100.0 * square, np.zeros(4)])
    upper = np.column_stack([20.0 * square, np.full(4, 50.0)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = TriangleMesh(np.vstack([lower, upper]), np.vstack([faces, faces + 4]))
    view = View(Camera.from_fov(100, 100, 0.2), look_at(np.array([0.0, 0.0, 5000.0])), np.array([1.0, 0.0, 1.0]))
    shadow = np.array([[-30.0, 0.0, 0.0], [-69.0, 19.0, 0.0], [-71.0, 0.0, 0.0], [-50.0, 21.0, 0.0], [60.0, 0.0, 0.0]])
    uv = view.camera.project(view.T_cam_body.transform(np.vstack([shadow, [[0.0, 0.0, 50.0]]])))
    hits = MitsubaRenderer(mesh, LambertSpec(), 1, variant=variant).surface(view, uv)
    np.testing.assert_allclose(hits.points_body_m[:, 2], [0.0, 0.0, 0.0, 0.0, 0.0, 50.0], atol=1e-6)
    np.testing.assert_array_equal(hits.lit, [False, False, True, True, True, True])


def test_no_positions_give_no_hits(variant, rock, looking):
    view = looking(Camera.from_fov(32, 32, 0.3), [0.0, -2000.0, 0.0], [0.0, -1.0, 0.0])
    hits = MitsubaRenderer(rock, LambertSpec(), 1, variant=variant).surface(view, np.zeros((0, 2)))
    assert hits.points_body_m.shape == (0, 3)
    with pytest.raises(BoresightError, match=r"\(N, 2\)"):
        MitsubaRenderer(rock, LambertSpec(), 1, variant=variant).surface(view, np.zeros(2))


def test_inside_is_told_from_outside(rock):
    """Against the parity of a ray's crossings, for points in the bounding sphere of a watertight body."""
    assert trimesh.Trimesh(rock.vertices_m, rock.faces, process=False).is_watertight
    rng = np.random.default_rng(11)
    points = rng.normal(size=(60, 3))
    points *= (rock.radius_m * rng.random(60) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    crossings = [_crossings(rock, point) for point in points]
    inside = np.array(crossings) % 2 == 1
    assert 5 < inside.sum() < 55
    for point, within in zip(points, inside, strict=True):
        if within:
            with pytest.raises(InsideBodyError, match="inside the body"):
                check_outside(rock, point)
        else:
            check_outside(rock, point)
    check_outside(rock, np.array([0.0, 0.0, 1e9]))


def test_inside_a_needle_is_told_from_outside():
    """Against scipy, in a tetrahedron ten times as long as wide, whose corners are at most unlike distances."""
    corners = np.array([[-1.0, -1.0, -5.0], [1.0, -1.0, -4.0], [0.0, 1.0, -6.0], [0.1, 0.0, 10.0]])
    needle = TriangleMesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    points = np.random.default_rng(1).uniform(corners.min(axis=0), corners.max(axis=0), (400, 3))
    within = Delaunay(corners).find_simplex(points) >= 0
    assert 40 < within.sum() < 360
    for point, inside in zip(points, within, strict=True):
        with pytest.raises(InsideBodyError, match="inside") if inside else nullcontext():
            check_outside(needle, point)


def _crossings(mesh: TriangleMesh, point: np.ndarray) -> int:
    """How many facets a ray in a skew direction crosses."""
    direction = np.array([0.3141, 0.5926, 0.7416])
    a, b, c = np.moveaxis(mesh.corners_m, 1, 0) - point
    signs = [
        np.einsum("fi,fi->f", np.cross(p, q), np.broadcast_to(direction, p.shape)) for p, q in ((a, b), (b, c), (c, a))
    ]
    positive, negative = np.all([s > 0 for s in signs], axis=0), np.all([s < 0 for s in signs], axis=0)
    ahead = np.einsum("fi,fi->f", a, np.cross(b - a, c - a)) / (np.cross(b - a, c - a) @ direction) > 0.0
    return int(((positive | negative) & ahead).sum())


def test_window_bounds_the_body_closely(rock, looking):
    """The window of every view holds all projected vertices and touches the outermost within a pixel."""
    camera = Camera(300, 200, 700.0, 650.0, 140.0, 120.0)
    outline = outline_points(rock)
    assert len(outline) < 0.5 * len(rock.vertices_m)
    for position in ([0.0, -2000.0, 300.0], [1500.0, 900.0, -800.0]):
        view = looking(camera, position, [0.0, -1.0, 0.0])
        window = body_window(view, outline)
        uv = camera.project(view.T_cam_body.transform(rock.vertices_m))
        corner = np.array([window.column, window.row])
        extent = np.array([window.width, window.height])
        assert np.all(uv >= corner)
        assert np.all(uv <= corner + extent)
        assert np.all(uv.min(axis=0) - corner < 1.0)
        assert np.all(corner + extent - uv.max(axis=0) < 1.0)


def test_strips_cover_a_window_once():
    count = np.zeros((60, 50), dtype=int)
    window = PixelWindow(7, 5, 30, 41)
    for strip in window.strips(4):
        assert strip.height <= 4
        count[strip.slices] += 1
    assert np.all(count[window.slices] == 1)
    assert count.sum() == 30 * 41
