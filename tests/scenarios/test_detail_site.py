"""A site of finer facets within the detail, against the body without it and the body that is as fine everywhere."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from facet_rays import crossings
from pydantic import ValidationError

from boresight.scenarios.bodies.detail import add_detail
from boresight.scenarios.bodies.embedded import EMBEDDED
from boresight.scenarios.bodies.topology import find_edges, refine_where
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.body import AlbedoSpec, BoulderSpec, CraterSpec, DetailSpec, RoughnessSpec, SiteSpec

DIRECTION = np.array([0.3, -0.5, 0.8])
ROUGH = DetailSpec(
    facets=20_000, seed=5, roughness=RoughnessSpec(rms_m=3.0, max_wavelength_m=100.0, min_wavelength_m=4.0)
)
SITE = SiteSpec(direction=tuple(DIRECTION), radius_m=40.0, edge_m=1.5)
FULL = ROUGH.model_copy(
    update={
        "boulders": BoulderSpec(count=4000, min_diameter_m=3.5, max_diameter_m=60.0),
        "craters": CraterSpec(count=30, min_diameter_m=20.0, max_diameter_m=100.0),
        "albedo": AlbedoSpec(sigma=0.2, wavelength_m=50.0),
    }
)


def made(detail, site=SITE):
    return add_detail(EMBEDDED["sphere"](), detail.model_copy(update={"site": site}))[0]


def triangles(mesh):
    """Corners and albedo of the facets, as bytes."""
    parts = np.concatenate([mesh.corners_m.reshape(len(mesh.faces), 9), mesh.albedo[mesh.faces]], axis=1)
    return [row.tobytes() for row in parts]


def centre_of(mesh):
    """Point of the smooth sphere in the direction of the site."""
    return DIRECTION / np.linalg.norm(DIRECTION) * np.linalg.norm(mesh.vertices_m, axis=1).mean()


def test_refined_facets_are_closed_flat_and_not_thin():
    mesh = EMBEDDED["sphere"]()
    centre = centre_of(mesh)

    def near(corners, reach):
        return np.linalg.norm(corners.mean(axis=1) - centre, axis=1) < 30.0 + reach

    before = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    points, faces = refine_where(np.asarray(mesh.vertices_m), np.asarray(mesh.faces), 0.7, near)
    after = trimesh.Trimesh(points, faces, process=False)
    assert after.is_watertight
    assert after.is_winding_consistent
    assert after.volume == pytest.approx(before.volume, rel=1e-12)
    assert after.area == pytest.approx(before.area, rel=1e-12)
    # Rivara: no angle is less than half of the smallest.
    assert after.face_angles.min() > 0.5 * before.face_angles.min()
    edges = find_edges(faces)
    inside = np.linalg.norm(points[edges.ends].mean(axis=1) - centre, axis=1) < 30.0
    assert edges.lengths(points)[inside].max() <= 0.7


def test_facets_beside_the_site_are_those_of_the_body_without_it():
    plain, with_site = made(FULL, None), made(FULL)
    assert trimesh.Trimesh(with_site.vertices_m, with_site.faces, process=False).is_watertight
    count = len(plain.vertices_m)
    away = np.linalg.norm(plain.vertices_m - centre_of(plain), axis=1) > 60.0
    np.testing.assert_array_equal(with_site.vertices_m[:count][away], plain.vertices_m[away])
    left = set(triangles(plain)) & set(triangles(with_site))
    beside = np.linalg.norm(plain.corners_m - centre_of(plain), axis=2).min(axis=1) > 90.0
    assert {one for one, out in zip(triangles(plain), beside, strict=True) if out} <= left
    assert len(left) > 0.9 * len(plain.faces)


def test_inside_it_is_the_body_that_is_as_fine_everywhere():
    """Radii along random directions; everything is twice as coarse as in the other tests."""
    rng = np.random.default_rng(4)
    towards = DIRECTION / np.linalg.norm(DIRECTION) + 0.07 * rng.normal(size=(150, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    rough = ROUGH.model_copy(
        update={
            "facets": 5_000,
            "roughness": RoughnessSpec(rms_m=3.0, max_wavelength_m=100.0, min_wavelength_m=8.0),
        }
    )

    def radii(mesh):
        near = np.linalg.norm(mesh.corners_m.mean(axis=1) - centre_of(mesh), axis=1) < 45.0
        return np.array([crossings(mesh.corners_m[near], np.zeros(3), one)[0] for one in towards])

    fine = made(rough.model_copy(update={"facets": 250_000}), None)
    along = np.arccos(towards @ (DIRECTION / np.linalg.norm(DIRECTION))) * np.linalg.norm(centre_of(fine))
    towards = towards[along < 30.0]
    site = SITE.model_copy(update={"edge_m": 3.0})
    coarse, site, whole = (radii(mesh) for mesh in (made(rough, None), made(rough, site), fine))
    assert len(towards) > 100
    # Waves of 8 to 40 m, which facets of 16 m do not resolve.
    assert np.std(coarse - whole) > 0.6
    assert np.std(site - whole) < 0.08


def test_boulders_too_small_for_the_body_are_at_the_site_alone():
    small = DetailSpec(facets=20_000, boulders=BoulderSpec(count=60_000, min_diameter_m=4.0, max_diameter_m=9.0))
    site = made(small)
    out_m = np.linalg.norm(site.vertices_m, axis=1) - np.linalg.norm(made(small, None).vertices_m, axis=1).max()
    assert (out_m > 0.3).any()
    distance = np.linalg.norm(site.vertices_m - centre_of(site), axis=1)
    assert distance[out_m > 0.3].max() < 42.0
    assert 0.1 < (out_m[distance < 30.0] > 0.3).mean() < 0.9


def test_a_site_that_is_not_finer_or_leads_nowhere_is_refused():
    with pytest.raises(BoresightError, match=r"detail\.site\.edge_m: 20 m is not below the .* m of all facets"):
        made(ROUGH, SITE.model_copy(update={"edge_m": 20.0}))
    with pytest.raises(ValidationError, match="no length"):
        SiteSpec(direction=(0.0, 0.0, 0.0), radius_m=10.0, edge_m=1.0)
    with pytest.raises(ValidationError, match="above 1000 edge_m"):
        SiteSpec(direction=(0.0, 0.0, 1.0), radius_m=10.0, edge_m=0.001)


def test_a_detail_without_a_site_is_dumped_as_before():
    assert "site" not in ROUGH.model_dump()


def test_features_none_of_which_reach_the_site_are_left_out():
    few = ROUGH.model_copy(update={"craters": CraterSpec(count=0, min_diameter_m=8.0, max_diameter_m=9.0)})
    np.testing.assert_array_equal(made(few).vertices_m, made(ROUGH).vertices_m)
