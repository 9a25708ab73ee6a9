"""Surface detail: subdivision, features, noise and their combination."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.stats import kstest

from boresight.scenarios.bodies import EMBEDDED
from boresight.scenarios.bodies.detail import RefinedSurface, add_detail, find_feature_vertices, power_law_diameters
from boresight.scenarios.bodies.noise import Band, fractal_field
from boresight.scenarios.bodies.topology import interpolating_control, refine, rounds_for, vertex_normals
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.spec.body import AlbedoSpec, BoulderSpec, CraterSpec, DetailSpec, RedrawnSpec, RoughnessSpec

RUBBLE = DetailSpec(
    facets=150_000,
    seed=7,
    boulders=BoulderSpec(count=600, min_diameter_m=6.0, max_diameter_m=40.0),
    craters=CraterSpec(count=20, min_diameter_m=20.0, max_diameter_m=80.0),
    roughness=RoughnessSpec(rms_m=1.0, max_wavelength_m=60.0, min_wavelength_m=8.0),
    albedo=AlbedoSpec(sigma=0.1),
    redrawn=RedrawnSpec(below_m=12.0, seed=3),
)


def ball(subdivisions=3, radius=100.0):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces))


def ground_of(mesh):
    edge_m = float(np.linalg.norm(np.diff(mesh.corners_m[:, :2], axis=1), axis=-1).mean())
    up = vertex_normals(mesh.vertices_m, mesh.faces)
    return RefinedSurface(mesh.vertices_m, up, edge_m, mesh.vertices_m, mesh.faces)


def relief(spec, mesh):
    """Height of the detailed sphere over its radius."""
    detailed, _ = add_detail(mesh, spec)
    return np.linalg.norm(detailed.vertices_m, axis=1) - 100.0, detailed


@pytest.fixture(scope="module")
def rubble():
    return add_detail(EMBEDDED["contact-binary"](), RUBBLE)[0]


def test_loop_subdivision_against_trimesh():
    coarse = trimesh.creation.torus(major_radius=3.0, minor_radius=1.0, major_sections=12, minor_sections=8)
    foreign = coarse.subdivide_loop(iterations=2)
    vertices, faces = refine(np.array(coarse.vertices), coarse.faces, 2)
    assert len(vertices) == len(foreign.vertices)
    distance, partner = cKDTree(foreign.vertices).query(vertices)
    assert distance.max() < 1e-12
    ours = {tuple(sorted(face)) for face in partner[faces].tolist()}
    assert ours == {tuple(sorted(face)) for face in foreign.faces.tolist()}
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(foreign.volume)


def test_the_refined_surface_passes_through_the_coarse_vertices():
    shape = EMBEDDED["contact-binary"]()
    fitted, _ = refine(interpolating_control(shape.vertices_m, shape.faces), shape.faces, 3)
    plain, _ = refine(shape.vertices_m, shape.faces, 3)
    n = len(shape.vertices_m)
    moved, moved_plain = (np.linalg.norm(v[:n] - shape.vertices_m, axis=1) for v in (fitted, plain))
    assert moved.mean() < 0.01  # m, of edges of 8 m
    assert moved.max() < 0.15
    assert moved.mean() < 0.1 * moved_plain.mean()


def test_a_coarse_ball_becomes_round():
    coarse = ball(1)
    vertices, faces = refine(interpolating_control(coarse.vertices_m, coarse.faces), coarse.faces, 4)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 100.0, rtol=0.01)
    fine = trimesh.Trimesh(vertices, faces, process=False)
    assert np.degrees(fine.face_adjacency_angles.max()) < 4.0  # the coarse facets meet at 18 deg


@pytest.mark.parametrize(("n", "wanted", "rounds"), [(20, 4, 0), (20, 20, 0), (20, 21, 1), (49152, 3_100_000, 3)])
def test_facets_are_at_least_the_wanted_and_less_than_four_times_as_many(n, wanted, rounds):
    assert rounds_for(n, wanted) == rounds
    assert n * 4**rounds >= wanted
    assert rounds == 0 or n * 4 ** (rounds - 1) < wanted


def test_diameters_follow_the_power_law():
    low, high, exponent = 3.0, 40.0, 2.7
    diameters = power_law_diameters(4000, low, high, exponent, np.random.default_rng(11))
    least, most = high**-exponent, low**-exponent

    def cumulative(d):
        return (most - np.asarray(d) ** -exponent) / (most - least)

    assert kstest(diameters, cumulative).pvalue > 1e-3
    assert (np.diff(diameters) <= 0.0).all()


def test_places_are_uniform_over_the_area():
    mesh = EMBEDDED["contact-binary"]()
    places = ground_of(mesh).draw_places(20_000, np.random.default_rng(5))
    east = mesh.vertices_m[places, 0] > 60.0
    centres = mesh.corners_m.mean(axis=1)
    area = mesh.areas_m2
    share = area[centres[:, 0] > 60.0].sum() / area.sum()
    assert east.mean() == pytest.approx(share, abs=0.02)  # 5 sigma of the binomial law, and half a facet


def test_patches_against_brute_force_and_without_the_far_side():
    thin = ball(3)
    thin = TriangleMesh(thin.vertices_m * [1.0, 1.0, 0.05], thin.faces)
    ground = ground_of(thin)
    places = np.array([0, 17, 200])
    reach = np.array([20.0, 40.0, 30.0])
    found = list(find_feature_vertices(ground, places, reach))
    pairs = {(int(f), int(v)) for patch in found for f, v in zip(patch.feature, patch.vertex, strict=True)}
    expected = {
        (k, v)
        for k in range(3)
        for v in range(len(thin.vertices_m))
        if np.linalg.norm(thin.vertices_m[v] - thin.vertices_m[places[k]]) <= reach[k]
        and ground.up[v] @ ground.up[places[k]] > 0.2
    }
    assert pairs == expected
    assert len(expected) > 30


def test_one_crater_has_its_depth_rim_and_place():
    spec = CraterSpec(count=1, min_diameter_m=60.0, max_diameter_m=60.0, depth_ratio=0.15, rim_ratio=0.04)
    heights, detailed = relief(DetailSpec(facets=80_000, craters=spec), ball(4))
    base = relief(DetailSpec(facets=80_000), ball(4))[0]
    heights = heights - base
    floor = np.argmin(heights)
    assert heights[floor] == pytest.approx(60.0 * (0.04 - 0.15), abs=0.05)
    assert 0.5 * 0.04 * 60.0 < heights.max() <= 0.04 * 60.0
    crest = detailed.vertices_m[heights > 0.9 * heights.max()]
    distance = np.linalg.norm(
        crest - detailed.vertices_m[floor] * (100.0 / np.linalg.norm(detailed.vertices_m[floor])), axis=1
    )
    assert 24.0 < distance.min() < distance.max() < 40.0
    far = np.linalg.norm(detailed.vertices_m - detailed.vertices_m[floor], axis=1) > 3.0 * 30.0 + 10.0
    np.testing.assert_allclose(heights[far], 0.0, atol=1e-9)


def test_one_boulder_stands_on_its_footprint_with_steep_sides():
    spec = BoulderSpec(count=1, min_diameter_m=30.0, max_diameter_m=30.0, height_ratio=0.4)
    heights, detailed = relief(DetailSpec(facets=300_000, boulders=spec), ball(4))
    heights = heights - relief(DetailSpec(facets=300_000), ball(4))[0]
    on = heights > 0.05
    top = heights.max()
    assert 0.4 * 30.0 * 0.5 < top < 0.4 * 30.0 * 1.5
    assert heights.min() > -1e-9
    spread = np.ptp(detailed.vertices_m[on], axis=0)
    assert np.linalg.norm(spread) < 1.5 * 30.0
    edges = detailed.vertices_m[detailed.faces[on[detailed.faces].any(axis=1)]]
    normals = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
    centre = edges.mean(axis=1)
    cosine = np.einsum("ni,ni->n", normals, centre) / np.linalg.norm(normals, axis=1) / np.linalg.norm(centre, axis=1)
    assert np.degrees(np.arccos(cosine)).max() > 50.0


def test_overlapping_boulders_do_not_pile_up():
    crowd = BoulderSpec(count=3000, min_diameter_m=30.0, max_diameter_m=30.0, height_ratio=0.4)
    heights, _ = relief(DetailSpec(facets=80_000, boulders=crowd), ball(4))
    assert heights.max() < 0.4 * 30.0 * 1.4 * 1.1 + 1.0


def test_roughness_has_its_rms_and_its_spectrum():
    points = np.zeros((4096, 3))
    points[:, 0] = 0.25 * np.arange(4096)
    band = Band(32.0, 2.0, 0.8)
    spectra = []
    for seed in range(12):
        field, omitted = fractal_field(points, band, 0.0, np.random.SeedSequence(seed))
        assert omitted == 0
        assert field.std() == pytest.approx(1.0)
        spectra.append(np.abs(np.fft.rfft(field)) ** 2)
    power, frequency = np.mean(spectra, axis=0), np.fft.rfftfreq(4096, 0.25)
    # A profile of a surface with Hurst exponent H has a spectrum ~ f**-(2 H + 1) inside the band.
    inside = (frequency > 1.0 / 16.0) & (frequency < 1.0 / 2.5)
    slope = np.polyfit(np.log(frequency[inside]), np.log(power[inside]), 1)[0]
    assert slope == pytest.approx(-2.6, abs=0.4)
    assert power[frequency > 1.5].sum() < 0.01 * power[1:].sum()
    # A height of wavelength L is as L**H: what a mesh cannot show, 4 and 2 m, is missing from the variance.
    coarse, omitted = fractal_field(points, band, 8.0, np.random.SeedSequence(0))
    assert omitted == 2
    assert coarse.var() == pytest.approx((32**1.6 + 16**1.6 + 8**1.6) / (32**1.6 + 16**1.6 + 8**1.6 + 4**1.6 + 2**1.6))


def test_roughness_of_a_body_has_the_stated_rms():
    smooth, _ = relief(DetailSpec(facets=80_000), ball(4))
    rough, _ = relief(
        DetailSpec(facets=80_000, roughness=RoughnessSpec(rms_m=0.7, max_wavelength_m=60.0, min_wavelength_m=8.0)),
        ball(4),
    )
    assert (rough - smooth).std() == pytest.approx(0.7, rel=0.01)


def test_long_wavelengths_do_not_depend_on_the_number_of_facets():
    roughness = RoughnessSpec(rms_m=1.0, max_wavelength_m=80.0, min_wavelength_m=5.0)
    boulders = BoulderSpec(count=30, min_diameter_m=25.0, max_diameter_m=40.0)
    coarse, few = relief(DetailSpec(facets=20_000, roughness=roughness, boulders=boulders), ball(4))
    fine, _ = relief(DetailSpec(facets=80_000, roughness=roughness, boulders=boulders), ball(4))
    shared = len(few.vertices_m)
    assert np.corrcoef(coarse, fine[:shared])[0, 1] > 0.97


def test_albedo_varies_about_one_with_the_stated_sigma():
    detailed, _ = add_detail(ball(4), DetailSpec(facets=80_000, albedo=AlbedoSpec(sigma=0.1)))
    assert detailed.albedo is not None
    assert detailed.albedo.mean() == pytest.approx(1.0, abs=0.01)
    assert detailed.albedo.std() == pytest.approx(0.1, rel=0.05)
    wild, _ = add_detail(ball(4), DetailSpec(facets=80_000, albedo=AlbedoSpec(sigma=1.0)))
    assert wild.albedo is not None
    assert (wild.albedo.min(), wild.albedo.max()) == (0.2, 2.0)


def test_an_albedo_of_the_shape_itself_is_refined_and_not_overruled():
    coarse = ball(2)
    own = TriangleMesh(coarse.vertices_m, coarse.faces, 1.0 + 0.002 * coarse.vertices_m[:, 0])
    detailed, _ = add_detail(own, DetailSpec(facets=10_000))
    assert detailed.albedo is not None
    np.testing.assert_allclose(detailed.albedo, 1.0 + 0.002 * detailed.vertices_m[:, 0], atol=0.01)
    with pytest.raises(BoresightError, match=r"detail\.albedo: the shape has an albedo of its own"):
        add_detail(own, DetailSpec(facets=10_000, albedo=AlbedoSpec(sigma=0.1)))


def test_the_same_seed_gives_the_same_body_and_another_seed_another(rubble):
    shape = EMBEDDED["contact-binary"]()
    again, _ = add_detail(shape, RUBBLE)
    for name in ("vertices_m", "faces", "albedo"):
        assert getattr(again, name).tobytes() == getattr(rubble, name).tobytes()
    other, _ = add_detail(shape, RUBBLE.model_copy(update={"seed": 8}))
    assert abs(other.vertices_m - rubble.vertices_m).max() > 5.0


def bumps(below_m=None, seed=5, smallest=25.0, largest=40.0, wavelengths=(10.0, 10.0)):
    """Boulders and one octave of roughness on a ball, with or without small relief from another seed."""
    return DetailSpec(
        facets=80_000,
        seed=7,
        boulders=BoulderSpec(count=30, min_diameter_m=smallest, max_diameter_m=largest),
        craters=CraterSpec(count=10, min_diameter_m=smallest, max_diameter_m=largest),
        roughness=RoughnessSpec(rms_m=0.5, max_wavelength_m=wavelengths[0], min_wavelength_m=wavelengths[1]),
        redrawn=None if below_m is None else RedrawnSpec(below_m=below_m, seed=seed),
    )


def test_relief_that_is_large_enough_stays_and_small_relief_lies_elsewhere():
    known = relief(bumps(), ball(4))[0] - 100.0
    np.testing.assert_array_equal(relief(bumps(below_m=10.0), ball(4))[0] - 100.0, known)
    np.testing.assert_array_equal(relief(bumps(below_m=100.0, seed=7), ball(4))[0] - 100.0, known)
    others = relief(bumps(below_m=100.0), ball(4))[0] - 100.0
    assert abs(np.corrcoef(known, others)[0, 1]) < 0.2
    assert others.std() == pytest.approx(known.std(), rel=0.2)


def test_redrawing_small_relief_keeps_the_large_relief():
    large = DetailSpec(facets=80_000, seed=7, craters=CraterSpec(count=1, min_diameter_m=80.0, max_diameter_m=80.0))
    both = bumps(below_m=50.0).model_copy(update={"craters": large.craters, "boulders": None})
    crater = relief(large, ball(4))[0]
    rough = relief(both, ball(4))[0] - crater
    own = relief(both.model_copy(update={"redrawn": None}), ball(4))[0] - crater
    assert rough.std() == pytest.approx(0.5, rel=0.02)
    assert abs(np.corrcoef(rough, own)[0, 1]) < 0.1


def test_rubble_is_closed_outward_and_nowhere_folded(rubble):
    foreign = trimesh.Trimesh(rubble.vertices_m, rubble.faces, process=False)
    assert foreign.is_watertight
    assert foreign.is_winding_consistent
    assert foreign.euler_number == 2
    assert foreign.volume == pytest.approx(EMBEDDED["contact-binary"]().volume_m3, rel=0.05)
    smooth, _ = add_detail(EMBEDDED["contact-binary"](), DetailSpec(facets=RUBBLE.facets))
    cosine = np.einsum("fi,fi->f", rubble.normals, smooth.normals)
    assert (cosine > 0.0).all()
    assert len(rubble.faces) == 196_608


@pytest.mark.long
def test_three_million_facets_in_seconds():
    spec = DetailSpec(
        facets=3_100_000,
        boulders=BoulderSpec(count=40_000, min_diameter_m=3.0, max_diameter_m=40.0),
        craters=CraterSpec(count=60, min_diameter_m=15.0, max_diameter_m=60.0),
        roughness=RoughnessSpec(rms_m=0.8, max_wavelength_m=40.0, min_wavelength_m=1.5),
        albedo=AlbedoSpec(sigma=0.05),
    )
    mesh, notes = add_detail(EMBEDDED["contact-binary"](), spec)
    assert len(mesh.faces) == 3_145_728
    assert notes == ()
    smooth, _ = add_detail(EMBEDDED["contact-binary"](), DetailSpec(facets=3_100_000))
    assert (np.einsum("fi,fi->f", mesh.normals, smooth.normals) > 0.0).mean() > 0.9999


def test_features_below_the_resolution_are_left_out_with_a_note():
    spec = DetailSpec(
        facets=4,
        boulders=BoulderSpec(count=20, min_diameter_m=1.0, max_diameter_m=2.0),
        roughness=RoughnessSpec(rms_m=1.0, max_wavelength_m=8.0, min_wavelength_m=2.0),
        albedo=AlbedoSpec(sigma=0.1, wavelength_m=10.0),
    )
    mesh, notes = add_detail(ball(), spec)
    np.testing.assert_array_equal(mesh.vertices_m, ball().vertices_m)
    np.testing.assert_array_equal(mesh.albedo, 1.0)
    assert [note.split(" are smaller than two facet edges")[0] for note in notes] == [
        "20 boulders",
        "3 octaves of roughness",
        "5 octaves of albedo",
    ]


def test_no_features_leave_the_smooth_surface():
    none = DetailSpec(
        facets=5000,
        boulders=BoulderSpec(count=0, min_diameter_m=1.0, max_diameter_m=2.0),
        craters=CraterSpec(count=0, min_diameter_m=1.0, max_diameter_m=2.0),
        roughness=RoughnessSpec(rms_m=0.0),
    )
    np.testing.assert_array_equal(
        add_detail(ball(), none)[0].vertices_m, add_detail(ball(), DetailSpec(facets=5000))[0].vertices_m
    )


@pytest.mark.parametrize(("name", "value"), [("sigma", 0.2), ("wavelength_m", 50.0)])
def test_the_albedo_leaves_the_shape_as_it_is(rubble, name, value):
    albedo = RUBBLE.albedo.model_copy(update={name: value})
    mesh, _ = add_detail(EMBEDDED["contact-binary"](), RUBBLE.model_copy(update={"albedo": albedo}))
    assert np.array_equal(mesh.vertices_m, rubble.vertices_m)
    assert not np.array_equal(mesh.albedo, rubble.albedo)
