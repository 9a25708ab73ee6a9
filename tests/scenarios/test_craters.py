"""Cratered surfaces: profiles, relief, crests, and true craters of an image."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from small_craters import BODY, craters_spec, small_ground

from boresight.renderers.mitsuba3 import choose_variant
from boresight.renderers.mitsuba3.scene import build_shape
from boresight.renderers.mitsuba3.variant import load_mitsuba
from boresight.scenarios.bodies import load_body
from boresight.scenarios.bodies.topology import is_closed
from boresight.scenarios.craters import build_surfaces, cratered_surface, surface
from boresight.scenarios.craters.kernels import add_octave, profile_height
from boresight.scenarios.craters.relief import REACH, Craters, Profiles, crater_relief, draw_craters
from boresight.scenarios.craters.surface import lower_envelope, smooth_tiles
from boresight.scenarios.craters.tiles import Tiling, check_size, expected_size
from boresight.scenarios.craters.truth import CraterTruth, find_rims
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, TriangleMesh
from boresight.scenarios.spec.scenario import ScenarioSpec

ANGLES = {"uniform": [0, 20]}
SCENE = {"name": "scene", "camera": {"focal_px": [10_000, 10_000]}, "craters": {}}
"""At 10 km a pixel is 1 m."""


@pytest.mark.parametrize(
    ("sections", "listed_m"),
    [
        ({"viewpoint": {"range_m": 20_000}}, 12.0),
        ({"viewpoint": {"range_m": 20_000}, "craters": {"known_diameter_m": 150}}, 150.0),
        ({"crater_pairs": {"range_m": 5_000, "view_deg": ANGLES, "sun_deg": ANGLES, "images": {}}}, 3.0),
        ({"orbit": {"arc": {"semi_major_axis_m": 1e5}}}, 60.0),
    ],
)
def test_craters_are_listed_from_six_pixels_on_or_from_the_given_size(sections: dict, listed_m: float) -> None:
    spec = ScenarioSpec.model_validate(SCENE | sections)
    assert spec.craters.listed_from_m == pytest.approx(listed_m, rel=1e-12)
    assert ScenarioSpec.model_validate(spec.model_dump(by_alias=True)) == spec


def test_real_images_with_craters_need_the_size_as_they_give_no_range() -> None:
    images = SCENE | {"images": {"folder": "x", "truth": "t"}}
    with pytest.raises(ValueError, match=r"craters.known_diameter_m: missing, but a scenario with images has no range"):
        ScenarioSpec.model_validate(images)
    assert ScenarioSpec.model_validate(images | {"craters": {"known_diameter_m": 9}}).craters.listed_from_m == 9.0


def test_shares_of_a_population_are_those_of_drawn_diameters() -> None:
    """Three standard deviations of a share of 20,000 draws are 1.1 % at most."""
    spec = craters_spec(count=20_000, known_diameter_m=30.0, exponent=1.5)
    diameter_m = 2.0 * draw_craters(spec, *smooth_tiles(load_body(BODY, ()), spec)).radius_m
    for least_m in (10.0, 20.0, 25.0, 60.0, 120.0):
        assert spec.share_from(least_m) == pytest.approx((diameter_m >= least_m).mean(), abs=0.011)
        large = diameter_m[diameter_m >= least_m]
        if len(large):
            assert spec.unlisted_share(least_m) == pytest.approx((large < 30.0).mean(), abs=0.02)


ROUGHNESS = {"rms_m": 0.5, "max_wavelength_m": 60.0, "min_wavelength_m": 15.0}


def test_profile_has_its_crest_at_the_radius_and_its_floor_at_the_depth() -> None:
    degradation, depth = np.array([0.0, 0.4, 1.0]), np.array([0.2, 0.15, 0.08])
    profiles = Profiles.of(degradation, depth, 0.036, 0.2)
    for k in range(3):

        def minus_height(r: float, k: int = k) -> float:
            return -float(profiles.heights(np.array([r]))[k, 0])

        crest = minimize_scalar(minus_height, bounds=(0.5, 1.8), method="bounded", options={"xatol": 1e-9})
        assert crest.x == pytest.approx(1.0, abs=1e-5)
        assert -crest.fun + minus_height(0.0) == pytest.approx(depth[k], abs=1e-12)
    # A fresh rim stands about 0.036 diameters over the ground (Pike 1977), a worn one lower and rounder.
    r = np.linspace(0.0, REACH, 3001)
    height = profiles.heights(r)
    assert height[0, 1000] == pytest.approx(0.036, rel=0.15)
    curvature = np.diff(height, 2, axis=1)[:, 999] / height.max(axis=1)
    assert np.all(np.diff(np.abs(curvature)) < 0)
    assert np.all(height[:, -1] == 0.0)
    assert np.all(height[:, 1000:].min(axis=1) >= -1e-12)


def test_kernel_of_the_profile_is_the_profile() -> None:
    profiles = Profiles.of(np.array([0.3]), np.array([0.12]), 0.036, 0.2)
    r = np.linspace(0.0, 3.5, 200)
    shape = (profiles.rim[0], profiles.rounding[0], profiles.stretch[0], profiles.scale[0])
    one_by_one = [profile_height(float(x), *map(float, shape)) for x in r]
    np.testing.assert_allclose(one_by_one, profiles.heights(r)[0], atol=1e-15)


def test_population_follows_its_power_law_and_lies_evenly() -> None:
    spec = craters_spec(count=20_000, exponent=2.0)
    smooth, up = smooth_tiles(load_body(BODY), spec)
    craters = draw_craters(spec, smooth, up)
    diameter = 2.0 * craters.radius_m
    # N(>D) ~ D^-2 between the bounds: a quarter of those above 20 m are above 40 m, but for the cut at 120 m.
    share = np.mean(diameter > 40.0)
    expected = (40.0**-2 - 120.0**-2) / (20.0**-2 - 120.0**-2)
    assert abs(share - expected) < 4.0 * np.sqrt(expected * (1 - expected) / len(craters))
    north = np.mean(craters.centre_m[:, 2] > 0.0)
    assert abs(north - 0.5) < 4.0 * 0.5 / np.sqrt(len(craters))
    assert np.all(np.diff(craters.degradation) <= 0.0)
    assert craters.depth_ratio.min() >= 0.08
    assert craters.depth_ratio.max() <= 0.2
    assert np.corrcoef(craters.degradation, craters.depth_ratio)[0, 1] < -0.9


def test_a_body_too_small_for_its_craters_is_refused() -> None:
    spec = craters_spec(count=3, min_diameter_m=500.0, max_diameter_m=600.0)
    smooth, up = smooth_tiles(load_body(BODY), spec)
    with pytest.raises(BoresightError, match="no place for a crater"):
        draw_craters(spec, smooth, up)


@pytest.mark.parametrize("edge_m", [4.0, 2.0])
@pytest.mark.parametrize("times", [1.0, 6.0])
def test_the_expected_size_is_that_of_the_tiling_but_for_a_third(times: float, edge_m: float) -> None:
    body = load_body(BODY)
    larger = replace(body, mesh=TriangleMesh(times * body.mesh.vertices_m, body.mesh.faces))
    spec = craters_spec(edge_m=edge_m)
    tiling = Tiling.of(*smooth_tiles(larger, spec), edge_m)
    tiles, facets = expected_size(larger.mesh, spec)
    assert tiles == len(tiling.mesh.faces)
    assert facets == pytest.approx(tiling.n_facets, rel=0.35)
    assert facets // 2 == pytest.approx(tiling.n_vertices, rel=0.35)


@pytest.mark.parametrize(("radius_m", "edge_m"), [(250e3, 5.0), (40e3, 1.0)])
def test_a_surface_that_exceeds_the_memory_is_refused_before_it_is_built(
    monkeypatch: pytest.MonkeyPatch, radius_m: float, edge_m: float
) -> None:
    monkeypatch.setattr("boresight.scenarios.craters.tiles.installed_memory_bytes", lambda: 24 * 10**9)
    body = load_body(BODY).mesh
    mesh = TriangleMesh(radius_m / body.radius_m * body.vertices_m, body.faces)
    remedy = rf"raise craters.edge_m \({edge_m:g}\), with min_diameter_m four times as much, or take a smaller body"
    said = rf"on a body {radius_m / 500:g} km across .*this machine has 24 GB: {remedy}"
    with pytest.raises(BoresightError, match=said):
        check_size(mesh, craters_spec(edge_m=edge_m))
    check_size(mesh, craters_spec(edge_m=200.0, min_diameter_m=800.0, max_diameter_m=9000.0))
    check_size(body, craters_spec(edge_m=edge_m))


@pytest.fixture(scope="module")
def tiling() -> Tiling:
    spec = craters_spec()
    return Tiling.of(*smooth_tiles(load_body(BODY), spec), 4.0)


def test_subdivided_tiles_have_no_cracks(tiling: Tiling) -> None:
    points, up = tiling.places()
    facets = tiling.facets(np.arange(len(tiling.mesh.faces)))
    assert is_closed(facets)
    assert np.array_equal(np.unique(facets), np.arange(tiling.n_vertices))
    # On a sphere the curved tiles keep to it far better than flat ones, and so do the directions.
    radius = np.linalg.norm(points, axis=1)
    assert np.abs(radius - 250.0).max() < 0.05
    np.testing.assert_allclose(up, points / radius[:, None], atol=0.02)
    ball = trimesh.Trimesh(points, facets, process=False)
    assert ball.volume == pytest.approx(4.0 / 3.0 * np.pi * 250.0**3, rel=2e-3)
    assert np.percentile(ball.edges_unique_length, 99) <= 4.0


def one_crater(radius_m: float, depth_ratio: float = 0.15, degradation: float = 0.2) -> Craters:
    centre, axis = np.array([[0.0, 0.0, 250.0]]), np.array([[0.0, 0.0, 1.0]])
    return Craters(centre, axis, np.array([radius_m]), np.array([degradation]), np.array([depth_ratio]))


def heights_by_mitsuba(mesh: TriangleMesh, xy_m: np.ndarray) -> np.ndarray:
    """Heights z, (n,), of the intersections of vertical rays at (n, 2) with a mesh."""
    mi = load_mitsuba(choose_variant())
    scene = mi.load_dict({"type": "scene", "shape": build_shape(mi, mesh)})
    origins = np.column_stack([xy_m, np.full(len(xy_m), 400.0)]).T.astype(np.float32)
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(origins), mi.Vector3f(0.0, 0.0, -1.0)))
    return 400.0 - hit.t.numpy().astype(float)


def test_one_crater_has_its_depth_and_its_crest_where_rays_meet_it(tiling: Tiling) -> None:
    points, up = tiling.places()
    crater = one_crater(40.0)
    heights = crater_relief(craters_spec(), crater, tiling, points, up)
    vertices = (points + heights[:, None] * up).astype(np.float32)
    rims = find_rims(crater, 30.0, tiling, points, vertices)
    mesh = TriangleMesh(vertices, tiling.facets(np.arange(len(tiling.mesh.faces))).astype(np.int32))
    # Rays of Mitsuba from above, outward from the axis in all azimuths: their highest point is the crest.
    azimuth = np.arange(12) * np.pi / 6.0
    out = np.linspace(30.0, 50.0, 81)
    xy = (out[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)).reshape(-1, 2)
    top = heights_by_mitsuba(mesh, np.concatenate([xy, [[0.3, 0.2]]]))
    top, floor = top[:-1], top[-1]
    # Over the sphere of the old ground the crest is where the rim's height is greatest.
    over = top - np.sqrt(250.0**2 - (xy**2).sum(axis=1))
    crest_m = out[np.nanargmax(over.reshape(81, 12), axis=0)]
    chord_m = np.linalg.norm(rims.crest_m[0][:, :2], axis=1)
    assert np.abs(np.median(crest_m) - np.median(chord_m)) < 1.5
    assert rims.crest_m[0][:, 2].mean() - floor == pytest.approx(0.15 * 80.0, rel=0.05)
    assert rims.normal_body[0] @ [0.0, 0.0, 1.0] > 0.9999
    assert not rims.cut.any()


def test_depth_is_along_the_axis_where_relief_is_aslant(tiling: Tiling) -> None:
    points, up = tiling.places()
    aslant = Rotation.from_rotvec([0.0, 30.0, 0.0], degrees=True).apply(up)
    z_m = points[:, 2] + crater_relief(craters_spec(), one_crater(40.0), tiling, points, aslant) * aslant[:, 2]
    off_axis_m = np.linalg.norm(points - [0.0, 0.0, 250.0], axis=1)
    crest_m = z_m[np.abs(off_axis_m - 40.0) < 1.0].mean()
    assert crest_m - z_m[np.argmin(off_axis_m)] == pytest.approx(0.15 * 80.0, rel=0.03)


def test_younger_craters_cut_older_ones(tiling: Tiling) -> None:
    points, up = tiling.places()
    old, young = one_crater(40.0, degradation=0.9), one_crater(20.0, degradation=0.1)
    place = np.array([[40.0, 0.0, np.sqrt(250.0**2 - 40.0**2)]])
    young = replace(young, centre_m=place, axis_body=place / 250.0)
    both = Craters(
        *(np.concatenate([getattr(old, f), getattr(young, f)]) for f in ("centre_m", "axis_body", "radius_m")),
        np.array([0.9, 0.1]),
        np.array([0.15, 0.15]),
    )
    heights = crater_relief(craters_spec(), both, tiling, points, up)
    vertices = (points + heights[:, None] * up).astype(np.float32)
    rims = find_rims(both, 30.0, tiling, points, vertices)
    # Circles of radii 40 and 20 m, the second one's middle on the first: it takes 2 x 2 asin(20 / 80) of the rim.
    assert rims.cut[0].mean() == pytest.approx(4.0 * np.arcsin(0.25) / (2.0 * np.pi), abs=2.0 / 72.0)
    assert not rims.cut[1].any()
    # Of what was there before, nothing is left in the inner half of a younger crater but a slope.
    offset_m = points - place
    inner = np.linalg.norm(offset_m, axis=1) < 10.0
    axes = np.linalg.svd(young.axis_body)[2]
    x, y, height = ((vertices[inner] - place) @ axes.T).T[[1, 2, 0]]
    profile = Profiles.of(np.array([0.1]), np.array([0.15]), craters_spec().rim_ratio, craters_spec().depth_ratio[1])
    own = 40.0 * profile.heights(np.linalg.norm(offset_m[inner], axis=1) / 20.0)[0]
    rest = np.sign(axes[0] @ young.axis_body[0]) * height - own
    slope = np.stack([np.ones_like(x), x, y], axis=1)
    assert abs(rest - slope @ np.linalg.lstsq(slope, rest, rcond=None)[0]).max() < 0.2
    middle = np.argmin(np.linalg.norm(points - place, axis=1))
    ring = np.abs(np.linalg.norm(points - place, axis=1) - 20.0) < 2.0
    assert heights[ring].mean() - heights[middle] > 0.7 * 0.15 * 40.0


def check_below_every_facet(tiling: Tiling, vertices_m: np.ndarray, under: TriangleMesh) -> None:
    for tile in range(0, len(tiling.mesh.faces), 37):
        fine = np.asarray(vertices_m, dtype=float)[np.unique(tiling.facets(np.array([tile])))]
        assert ((fine - under.corners_m[tile, 0]) @ under.normals[tile]).min() > 0.0


def test_the_coarse_body_lies_below_every_facet() -> None:
    ground = small_ground()
    tiling = ground.tiling
    check_below_every_facet(tiling, ground.vertices_m, ground.under)
    assert is_closed(ground.under.faces)
    assert ground.under.volume_m3 > 0.9 * tiling.mesh.volume_m3
    # A ground 7.5 m lower, and directions of the relief 45 deg off the normals.
    aslant = replace(tiling, up=Rotation.from_rotvec([0.0, 45.0, 0.0], degrees=True).apply(tiling.up))
    lower = (0.97 * tiling.places()[0]).astype(np.float32)
    check_below_every_facet(aslant, lower, TriangleMesh(lower_envelope(aslant, lower), tiling.mesh.faces))


def test_planes_of_rims_face_outward() -> None:
    rims = small_ground().rims
    outward = rims.centre_m / np.linalg.norm(rims.centre_m, axis=1, keepdims=True)
    assert len(rims) > 10
    assert (np.einsum("ni,ni->n", rims.normal_body, outward) > 0.8).all()


def test_surface_is_the_same_each_time_and_another_for_another_seed() -> None:
    one, again, other = small_ground(), small_ground(), small_ground(seed=6)
    assert np.array_equal(one.vertices_m, again.vertices_m)
    assert one.sha256 == again.sha256 != other.sha256
    assert not np.array_equal(one.vertices_m, other.vertices_m)


def test_surfaces_built_at_once_are_those_built_one_by_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path))
    at_work, most = set[int](), []
    draw = surface.draw_craters

    def noted(*given: object) -> Craters:
        at_work.add(threading.get_ident())
        most.append(len(at_work))
        return draw(*given)

    monkeypatch.setattr(surface, "draw_craters", noted)
    specs = [craters_spec(seed=seed, roughness=ROUGHNESS) for seed in (5, 6, 7)]
    said: list[str] = []
    cratered_surface(BODY, specs[0])
    at_work.clear()
    build_surfaces(BODY, specs, (), 3, said.append)
    assert max(most) > 1
    assert [line.partition(" of ")[0] for line in said] == ["building 2 cratered surface(s)"], "one is there"
    build_surfaces(BODY, specs, (), 3, said.append)
    assert len(said) == 1, "all are there"
    monkeypatch.setattr("boresight.scenarios.craters.surface.installed_memory_bytes", lambda: 1)
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "another"))
    at_work.clear()
    most.clear()
    build_surfaces(BODY, specs, (), 3)
    assert max(most) == 1, "one at a time where the memory is small"
    assert len(list((tmp_path / "another" / "craters").iterdir())) == 3
    for spec in specs:
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path))
        one = cratered_surface(BODY, spec)
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "another"))
        assert np.array_equal(one.vertices_m, cratered_surface(BODY, spec).vertices_m)


def test_an_octave_is_scipys_periodic_spline() -> None:
    rng = np.random.default_rng(1)
    lattice, points = rng.standard_normal((8, 8, 8)), rng.uniform(-30.0, 30.0, (200, 3))
    turn, shift = rng.normal(size=(3, 3)), rng.uniform(0.0, 8.0, 3)
    heights = np.ones(200)
    add_octave(heights, points, lattice, turn, shift, 0.7)
    at = (points @ turn.T + shift).T
    expected = map_coordinates(lattice, at, order=3, mode="grid-wrap", prefilter=False)
    np.testing.assert_allclose(heights, 1.0 + 0.7 * expected, atol=1e-12)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("edge_m", 9.0, "too coarse"), ("depth_ratio", (0.3, 0.2), "depth_ratio"), ("min_diameter_m", 500.0, "above")],
)
def test_bad_sections_are_refused(key: str, value: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        craters_spec(**{key: value})


GOOD = {
    "radius_px": 10.0, "visible": 1.0, "in_frame": 1.0, "lit": 1.0, "emission_deg": 30.0, "incidence_deg": 45.0,
    "degradation": 0.2, "cut": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("radius_px", 5.9), ("visible", 0.89), ("in_frame", 0.94), ("lit", 0.49), ("emission_deg", 60.0),
        ("incidence_deg", 19.9), ("incidence_deg", 75.1), ("degradation", 0.61), ("cut", 0.26),
    ],
)  # fmt: skip
def test_each_criterion_alone_keeps_a_crater_from_being_detectable(name, value):
    """Two craters that differ in one property, which is just beyond its limit in the second."""
    numbers = {key: np.array([good, value if key == name else good]) for key, good in GOOD.items()}
    radius = numbers.pop("radius_px")
    ones = np.ones(2)
    ellipses = Ellipses(np.full((2, 2), 50.0), np.column_stack([radius, radius]), np.zeros(2))
    truth = CraterTruth(
        crater=np.arange(2), ellipses=ellipses, deviation=0.0 * ones, centre_m=np.zeros((2, 3)),
        diameter_m=200.0 * ones, depth_m=20.0 * ones, **numbers,
    )  # fmt: skip
    assert truth.detectable.tolist() == truth.clean.tolist() == [True, False]
