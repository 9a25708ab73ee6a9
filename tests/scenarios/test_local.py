"""A local shape over a global one, against analytic surfaces, rays by brute force and trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from facet_rays import crossings
from scipy.spatial import Delaunay

from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.bodies.topology import find_edges
from boresight.scenarios.cache import Cache
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.body import BodySpec, DetailSpec, HeightErrorSpec, LocalSpec, RoughnessSpec

RADIUS_M = 100.0
REACH_M = 20.0  # half of the side of the local shape, across
EDGE_M = 0.5
UP = np.array([2.0, 1.0, 2.0]) / 3.0
ACROSS = np.array([[1.0, 0.0, -1.0], [-1.0, 4.0, -1.0]]) / np.sqrt([[2.0], [18.0]])


def heights(x, y):
    """Height of the analytic site above the plane through the origin across `UP`: a sphere, 1 m higher, with waves."""
    return np.sqrt(RADIUS_M**2 - x**2 - y**2) + 1.0 + 0.4 * np.sin(x / 4.0) * np.cos(y / 5.0)


def site(step_m=EDGE_M, reach_m=REACH_M, lift_m=0.0):
    """Corners and facets of the site, on a grid that is not that of any other mesh."""
    ticks = np.arange(-reach_m, reach_m + 0.5 * step_m, step_m)
    x, y = (part.ravel() for part in np.meshgrid(ticks, ticks))
    vertices = np.outer(x, ACROSS[0]) + np.outer(y, ACROSS[1]) + np.outer(heights(x, y) + lift_m, UP)
    # Joggled, so that facets at the edge span many others.
    return vertices, Delaunay(np.stack([x, y], axis=1), qhull_options="QJ").simplices


def outward(vertices, faces):
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.cross(b - a, c - a) @ UP < 0.0
    return np.where(inward[:, None], faces[:, ::-1], faces)


def write(path, vertices, faces):
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


@pytest.fixture
def folder(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    write(tmp_path / "ball.ply", ball.vertices, ball.faces)
    vertices, faces = site()
    write(tmp_path / "site.ply", vertices, outward(vertices, faces))
    return tmp_path


def body(**local):
    return BodySpec(shape="ball.ply", local=(LocalSpec(**{"shape": "site.ply", "blend_m": 3.0, **local}),))


def load(spec, folder):
    return load_body(spec, [folder], Cache(folder / "cache", 10**9))


def across(points):
    return points @ ACROSS[0], points @ ACROSS[1], points @ UP


def test_heights_are_those_of_the_analytic_surface(folder):
    loaded = load(body(), folder)
    mesh = loaded.mesh
    foreign = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert foreign.is_watertight
    assert foreign.is_winding_consistent
    assert foreign.euler_number == 2
    x, y, z = across(np.asarray(mesh.vertices_m))
    inside = (np.maximum(np.abs(x), np.abs(y)) < REACH_M - 3.0) & (z > 0.0)
    assert inside.sum() > 4.0 * (REACH_M - 3.0) ** 2 / EDGE_M**2
    # The chord of a facet of the site: an eighth of the square of its diagonal times the curvature.
    chord_m = 0.25 * EDGE_M**2 * (1.0 / RADIUS_M + 0.4 / 16.0)
    error_m = z[inside] - heights(x[inside], y[inside])
    assert np.abs(error_m).max() < chord_m
    # On the facets of the site themselves, to far less.
    part = trimesh.load(folder / "site.ply", process=False)
    for point in np.asarray(mesh.vertices_m)[inside][::97]:
        down_m = crossings(part.triangles, point + 5.0 * UP, -UP)
        np.testing.assert_allclose(down_m, [5.0], atol=1e-3 * EDGE_M)
    assert "site.ply:" in loaded.notes[-1]


def test_finer_meshes_converge_to_a_thousandth_of_the_facet(folder):
    vertices, faces = site(step_m=0.1, reach_m=5.0)
    write(folder / "site.ply", vertices, outward(vertices, faces))
    mesh = load(body(blend_m=1.0), folder).mesh
    x, y, z = across(np.asarray(mesh.vertices_m))
    inside = (np.maximum(np.abs(x), np.abs(y)) < 3.9) & (z > 0.0)
    assert np.abs(z[inside] - heights(x[inside], y[inside])).max() < 1e-3 * 0.15
    edges = find_edges(mesh.faces)
    short = inside[edges.ends].all(axis=1)
    flat = np.stack([x, y], axis=1)
    assert np.linalg.norm(flat[edges.ends[short, 0]] - flat[edges.ends[short, 1]], axis=1).max() < 0.15


def test_it_fades_towards_its_edge_and_leaves_the_rest_bit_for_bit(folder):
    plain, mesh = load(BodySpec(shape="ball.ply"), folder).mesh, load(body(), folder).mesh
    x, y, z = across(np.asarray(mesh.vertices_m))
    within = REACH_M - np.maximum(np.abs(x), np.abs(y))
    near = z > 0.0
    smooth = np.sqrt(np.maximum(RADIUS_M**2 - x**2 - y**2, 0.0))
    # Between the facets of the ball, 0.2 m below the sphere at most, and the site.
    beside = near & (within < 0.0) & (within > -5.0)
    assert np.abs(z[beside] - smooth[beside]).max() < 0.2
    share = np.clip(within / 3.0, 0.0, 1.0)
    share = share**2 * (3.0 - 2.0 * share)
    ring = near & (within > 0.0) & (within < 3.0)
    expected = smooth[ring] + share[ring] * (heights(x[ring], y[ring]) - smooth[ring])
    np.testing.assert_allclose(z[ring], expected, atol=0.25)
    count = len(plain.vertices_m)
    untouched = ~near[:count] | (within[:count] <= 0.0)
    np.testing.assert_array_equal(mesh.vertices_m[:count][untouched], plain.vertices_m[untouched])
    facets = {one.tobytes() for one in np.asarray(mesh.corners_m)}
    far = np.linalg.norm(plain.corners_m.mean(axis=1) - RADIUS_M * UP, axis=1) > 3.0 * REACH_M
    assert all(one.tobytes() in facets for one in np.asarray(plain.corners_m)[far])


def test_no_point_of_the_sky_sees_two_surfaces(folder):
    """Rays down onto the site meet one facet each."""
    mesh = load(body(), folder).mesh
    facets = np.linalg.norm(mesh.corners_m.mean(axis=1) - RADIUS_M * UP, axis=1) < 40.0
    for spot in np.random.default_rng(1).uniform(-24.0, 24.0, (150, 2)):
        assert len(crossings(mesh.corners_m[facets], spot @ ACROSS + 150.0 * UP, -UP)) == 1


def test_a_site_wound_inward_with_holes_over_a_detailed_body_is_as_good(folder):
    vertices, faces = site()
    faces = outward(vertices, faces)[:, ::-1]
    x, y, _ = across(vertices[faces].mean(axis=1))
    write(folder / "site.ply", vertices, faces[np.hypot(x - 5.0, y) > 4.0])
    detail = DetailSpec(facets=20_000, roughness=RoughnessSpec(rms_m=0.3, max_wavelength_m=30.0, min_wavelength_m=5.0))
    plain = BodySpec(shape="ball.ply", detail=detail)
    mesh, before = load(body().model_copy(update={"detail": detail}), folder).mesh, load(plain, folder).mesh
    assert trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).is_watertight
    x, y, z = across(np.asarray(mesh.vertices_m))
    inside = (np.maximum(np.abs(x), np.abs(y)) < 17.0) & (np.hypot(x - 5.0, y) > 7.5) & (z > 0.0)
    assert np.abs(z[inside] - heights(x[inside], y[inside])).max() < 0.01
    count = len(before.vertices_m)
    hole = (np.hypot(x - 5.0, y) < 3.0)[:count] & (z > 0.0)[:count]
    assert hole.any()
    np.testing.assert_array_equal(mesh.vertices_m[:count][hole], before.vertices_m[hole])


def test_a_later_one_lies_over_an_earlier_one_and_a_coarser_edge_is_kept(folder):
    vertices, faces = site(reach_m=8.0, lift_m=0.7)
    write(folder / "top.ply", vertices, outward(vertices, faces))
    both = body().model_copy(
        update={"local": (LocalSpec(shape="site.ply", edge_m=2.0), LocalSpec(shape="top.ply", blend_m=2.0))}
    )
    mesh = load(both, folder).mesh
    x, y, z = across(np.asarray(mesh.vertices_m))
    side = np.where(z > 0.0, np.maximum(np.abs(x), np.abs(y)), np.inf)
    top, first = side < 6.0, (side > 9.0) & (side < 15.5)
    assert np.abs(z[top] - 0.7 - heights(x[top], y[top])).max() < 0.01
    # Chords of edges of 2 m.
    assert np.abs(z[first] - heights(x[first], y[first])).max() < 0.02
    assert first.sum() < (31.0**2 - 18.0**2) / 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unit": "km"}, r"with unit km it is .* m from the body's origin, .*; is the file in m\? set unit: m"),
        ({"blend_m": 25.0}, r"m at most from its edge, less than blend_m: 25; lower it"),
        ({"edge_m": 0.005}, r"edges of 0\.005 m make about .* facets.*; give a greater edge_m"),
    ],
)
def test_a_wrong_key_is_refused(folder, change, words):
    with pytest.raises(BoresightError, match=rf"site\.ply: body\.local: .*{words}"):
        load(body(**change), folder)


def centred(vertices):
    return vertices - RADIUS_M * UP


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        (centred, "its origin and axes must be the body's"),
        (lambda vertices: vertices + 60.0 * UP, r"it is 6.* m from the body's surface \(median\), more than half"),
        (lambda vertices: vertices + 140.0 * ACROSS[0], "no part of the body's surface is below it; check its frame"),
        (lambda vertices: vertices / 1000.0, r"is the file in km\? set unit: km"),
    ],
)  # fmt: skip
def test_a_site_at_another_place_is_refused(folder, moved, words):
    vertices, faces = site()
    write(folder / "site.ply", moved(vertices), outward(vertices, faces))
    with pytest.raises(BoresightError, match=rf"site\.ply: body\.local: .*{words}"):
        load(body(), folder)


def test_a_body_that_overhangs_below_it_is_refused(folder):
    """A hill of 12 m that leans over by three times its height."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)
    hill_m = 12.0 * np.clip(1.0 - np.linalg.norm(ball.vertices - RADIUS_M * UP, axis=1) / 12.0, 0.0, 1.0)
    write(folder / "ball.ply", ball.vertices + np.outer(hill_m, UP + 3.0 * ACROSS[0]), ball.faces)
    with pytest.raises(BoresightError, match=r"site\.ply: body\.local: .* % of the body's surface below it overhangs"):
        load(body(), folder)


def test_a_whole_body_or_no_mesh_is_refused(folder):
    for shape, words in (("ball.ply", "it must be open, and seen whole from one side"), ("nowhere.ply", "not found")):
        with pytest.raises(BoresightError, match=words):
            load(body(shape=shape), folder)
    (folder / "site.ply").write_text("ply but cut")
    with pytest.raises(BoresightError, match=r"site\.ply"):
        load(body(), folder)


def test_the_digest_has_the_local_shape_if_there_is_one(folder):
    plain = BodySpec(shape="ball.ply")
    assert "local" not in plain.model_dump()
    specs = [plain, body(), body(blend_m=4.0), body(edge_m=1.0)]
    digests = {body_digest(one, [folder]) for one in specs}
    vertices, faces = site(lift_m=0.1)
    write(folder / "site.ply", vertices, faces)
    assert len(digests | {body_digest(body(), [folder])}) == 5


def test_height_errors_are_added_to_the_local_shape(folder):
    wrong = body().model_copy(update={"height_error": HeightErrorSpec(rms_m=0.2)})
    moved = load(wrong, folder).mesh.vertices_m - load(body(), folder).mesh.vertices_m
    assert 0.1 < np.sqrt(np.mean(np.sum(moved**2, axis=1))) < 0.3
