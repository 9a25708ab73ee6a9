"""Checks of a shape: unit, closure, orientation, origin."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from mission_data import needs_data
from scipy.spatial import ConvexHull

from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.bodies.load import checked_mesh, evenly_meshed
from boresight.scenarios.bodies.readers import RawShape
from boresight.scenarios.bodies.topology import find_edges, is_closed, vertex_normals
from boresight.scenarios.cache import Cache
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.geometry.mesh import winding_number
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.body import BodySpec

ANY = (1e-3, 1e9)


def ball(radius=100.0, centre=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return RawShape(np.array(mesh.vertices) + centre, np.array(mesh.faces))


def check(shape, unit="m", expected=ANY):
    return checked_mesh(shape, Path("shape.obj"), unit, expected)


def test_a_sound_shape_passes_without_notes_and_kilometres_become_metres():
    mesh, notes = check(ball(0.1), unit="km")
    assert notes == ()
    assert mesh.radius_m == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("radius", "unit", "hint"),
    [(0.1, "m", "is the file in km"), (100.0, "km", "is the file in m"), (5.0, "m", "check body.unit and")],
)
def test_a_wrong_unit_is_refused_with_a_hint(radius, unit, hint):
    with pytest.raises(BoresightError, match=rf"shape\.obj: with body\.unit {unit} .*{hint}"):
        check(ball(radius), unit, (150.0, 300.0))


def test_an_open_mesh_is_refused():
    shape = ball()
    with pytest.raises(BoresightError, match="not closed: 3 facet edges have no partner"):
        check(RawShape(shape.vertices, shape.faces[1:]))


def test_one_turned_facet_is_refused():
    shape = ball()
    faces = shape.faces.copy()
    faces[7] = faces[7, ::-1]
    with pytest.raises(BoresightError, match=r"not closed: 6 facet edges.*the first at facet"):
        check(RawShape(shape.vertices, faces))


def test_a_doubled_shell_is_refused():
    shape = ball()
    with pytest.raises(BoresightError, match="960 edges are shared by more than two facets"):
        check(RawShape(shape.vertices, np.vstack([shape.faces, shape.faces])))


def test_an_inside_out_shape_is_turned_with_a_note():
    shape = ball()
    mesh, notes = check(RawShape(shape.vertices, shape.faces[:, ::-1]))
    assert mesh.volume_m3 == pytest.approx(check(shape)[0].volume_m3)
    assert notes == ("the facets faced inward: all were turned",)


def test_separate_triangles_are_joined_and_leftovers_dropped():
    shape = ball()
    soup = shape.vertices[shape.faces].reshape(-1, 3)
    vertices = np.vstack([soup, [[1e9, 0.0, 0.0]]])
    faces = np.vstack([np.arange(len(soup)).reshape(-1, 3), [[0, 0, 1]]])
    mesh, notes = check(RawShape(vertices, faces))
    assert is_closed(mesh.faces)
    assert len(mesh.vertices_m) == len(shape.vertices)
    assert mesh.volume_m3 == pytest.approx(check(shape)[0].volume_m3)
    assert len(notes) == 3


def test_an_origin_outside_is_refused():
    with pytest.raises(BoresightError, match=r"origin lies outside the body .*150"):
        check(ball(centre=(150.0, 0.0, 0.0)))


def test_a_surface_within_another_is_refused():
    outer, inner = ball(), ball()
    vertices = np.vstack([outer.vertices, 0.5 * inner.vertices])
    with pytest.raises(BoresightError, match="2 closed surfaces lie about the origin: keep the outer one"):
        check(RawShape(vertices, np.vstack([outer.faces, inner.faces + len(outer.vertices)])))


def test_facets_without_area_are_noted():
    shape = ball()
    corner = shape.faces[0]
    middle = len(shape.vertices)
    vertices = np.vstack([shape.vertices, shape.vertices[corner[:2]].mean(axis=0)])
    # A vertex in the middle of one edge, joined by a flat facet on that side only.
    faces = np.vstack([shape.faces[1:], [[corner[0], middle, corner[2]], [middle, corner[1], corner[2]],
                                         [corner[0], corner[1], middle]]])  # fmt: skip
    _, notes = check(RawShape(vertices, faces))
    assert notes == ("1 facets have no area",)


def test_winding_number_of_a_torus():
    torus = trimesh.creation.torus(major_radius=3.0, minor_radius=1.0, major_sections=64, minor_sections=64)
    mesh = TriangleMesh(np.array(torus.vertices), np.array(torus.faces))
    points = np.random.default_rng(3).uniform(-4.5, 4.5, (60, 3)) * [1.0, 1.0, 0.3]
    from_ring = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 3.0, points[:, 2])
    clear = abs(from_ring - 1.0) > 0.02
    turns = [winding_number(mesh, point) for point in points[clear]]
    np.testing.assert_allclose(turns, from_ring[clear] < 1.0, atol=1e-9)
    assert 5 < round(sum(turns)) < 55


def test_edges_and_normals_against_trimesh():
    mesh = trimesh.creation.torus(major_radius=3.0, minor_radius=1.0)
    edges = find_edges(mesh.faces)
    np.testing.assert_array_equal(np.sort(edges.ends, axis=0)[:, 0], np.sort(mesh.edges_unique, axis=0)[:, 0])
    np.testing.assert_array_equal(np.sort(mesh.faces[:, [0, 1]], axis=1), edges.ends[edges.of_face[:, 0]])
    ours = vertex_normals(np.array(mesh.vertices), mesh.faces)
    assert (np.einsum("ni,ni->n", ours, mesh.vertex_normals) > 0.999).all()


# --- Even facets over a shape of slivers, against the planes of a convex hull ----------------------------------------


def polyhedron():
    """Hull of 90 points, most of them crowded at one end: long facets and tiny ones."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(90, 3))
    points *= [300.0, 200.0, 150.0] / np.linalg.norm(points, axis=1)[:, None]
    points[30:] = [330.0, 0.0, 0.0] + rng.normal(size=(60, 3)) * 4.0
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    return TriangleMesh(points, np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)), hull


def test_vertices_lie_on_the_nearest_plane_of_a_convex_body():
    mesh, hull = polyhedron()
    even = evenly_meshed(mesh, 5000, "hull")
    radius = np.linalg.norm(even.vertices_m, axis=1)
    slope = even.vertices_m / radius[:, None] @ hull.equations[:, :3].T
    distance = np.where(slope > 0, -hull.equations[:, 3] / np.where(slope > 0, slope, 1.0), np.inf)
    np.testing.assert_allclose(radius, distance.min(axis=1), rtol=1e-9)
    assert 5000 <= len(even.faces) < 20000
    foreign = trimesh.Trimesh(even.vertices_m, even.faces, process=False)
    assert foreign.is_watertight
    assert 0.98 < foreign.volume / hull.volume < 1.0


def test_facets_are_even_seen_from_the_origin():
    even = evenly_meshed(polyhedron()[0], 5000, "hull")
    a, b, c = np.moveaxis(even.corners_m / np.linalg.norm(even.corners_m, axis=2, keepdims=True), 1, 0)
    triple = np.einsum("fi,fi->f", a, np.cross(b, c))
    cosines = 1.0 + np.einsum("fi,fi->f", a, b) + np.einsum("fi,fi->f", b, c) + np.einsum("fi,fi->f", c, a)
    solid = 2.0 * np.arctan2(triple, cosines)  # van Oosterom and Strackee (1983)
    assert solid.sum() == pytest.approx(4.0 * np.pi)
    assert solid.max() / solid.min() < 2.0


def test_albedo_is_interpolated_on_the_facet_that_is_met():
    mesh, _ = polyhedron()
    slope = np.array([1e-3, -5e-4, 7e-4])
    even = evenly_meshed(TriangleMesh(mesh.vertices_m, mesh.faces, 1.0 + mesh.vertices_m @ slope), 500, "hull")
    np.testing.assert_allclose(even.albedo, 1.0 + even.vertices_m @ slope, rtol=1e-9)


def test_a_shape_that_is_not_star_shaped_is_refused():
    ring = trimesh.creation.torus(major_radius=3.0, minor_radius=1.0)
    with pytest.raises(BoresightError, match=r"ring\.obj: body\.even_facets: \d+ facets cannot be seen"):
        evenly_meshed(TriangleMesh(np.array(ring.vertices), np.array(ring.faces)), 500, "ring.obj")


def test_the_digest_of_a_body_without_the_key_is_unchanged():
    plain = BodySpec(shape="sphere")
    assert "even_facets" not in plain.model_dump()
    even = plain.model_copy(update={"even_facets": 500})
    assert even.model_dump()["even_facets"] == 500
    more = plain.model_copy(update={"even_facets": 501})
    assert len({body_digest(spec) for spec in (plain, even, more)}) == 3
    assert len(load_body(even).mesh.faces) == 1280


@needs_data("shapes/apophis_lightcurve.obj")
def test_the_slivers_of_apophis_no_longer_fold_the_detailed_surface(tmp_path):
    spec = load_scenario("apophis-shape-images").spec.body
    detail = spec.detail.model_copy(
        update={"facets": 80_000, "boulders": None, "craters": None, "roughness": None, "albedo": None}
    )
    folded = {}
    for even_facets in (None, spec.even_facets):
        body = spec.model_copy(update={"detail": detail, "even_facets": even_facets})
        mesh = load_body(body, cache=Cache(tmp_path, 10**9)).mesh
        inward = np.einsum("fi,fi->f", mesh.area_vectors_m2, mesh.corners_m.mean(axis=1)) < 0.0
        folded[even_facets] = inward.sum()
    assert folded[None] > 100
    assert folded[spec.even_facets] == 0
    assert mesh.volume_m3 == pytest.approx(np.pi / 6.0 * 375.0**3, rel=0.01)
