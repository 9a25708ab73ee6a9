"""Even facets over a shape of slivers, against the planes of a convex hull."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from mission_data import needs_data
from scipy.spatial import ConvexHull

from boresight.scenarios.bodies import body_digest, load_body
from boresight.scenarios.bodies.load import evenly_meshed
from boresight.scenarios.cache import Cache
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.body import BodySpec


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
