"""Checks of a shape: unit, closure, orientation, origin."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from boresight.scenarios.bodies.checks import checked_mesh, winding_number
from boresight.scenarios.bodies.readers import RawShape
from boresight.scenarios.bodies.topology import find_edges, is_closed, vertex_normals
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh

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
