"""Embedded bodies, loading by a spec, digests."""

import gc
import os
import subprocess
import sys
import weakref

import numpy as np
import pytest
import trimesh
from mission_data import needs_data
from scipy.ndimage import binary_fill_holes
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from boresight.scenarios.bodies import EMBEDDED, body_digest, load_body
from boresight.scenarios.bodies.readers import READERS
from boresight.scenarios.cache import Cache
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.body import AlbedoSpec, BodySpec, BoulderSpec, DetailSpec

VESTA = "images/dawn_fc_vesta/vesta_5002.ply"
DETAIL = DetailSpec(
    facets=60_000,
    seed=3,
    boulders=BoulderSpec(count=50, min_diameter_m=15.0, max_diameter_m=40.0),
    albedo=AlbedoSpec(sigma=0.1),
)


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "cache", 10**9)


@pytest.fixture
def shape(tmp_path):
    trimesh.creation.icosphere(subdivisions=3, radius=100.0).export(tmp_path / "ball.obj")
    return tmp_path / "ball.obj"


@pytest.mark.parametrize("name", EMBEDDED)
def test_embedded_bodies_are_closed_and_outward(name):
    mesh = EMBEDDED[name]()
    foreign = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert foreign.is_watertight
    assert foreign.is_winding_consistent
    assert foreign.volume == pytest.approx(mesh.volume_m3)
    assert foreign.volume > 0.0
    np.testing.assert_allclose(foreign.center_mass, 0.0, atol=1e-6)


def test_contact_binary_is_like_itokawa():
    mesh = EMBEDDED["contact-binary"]()
    foreign = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    np.testing.assert_allclose(mesh.extent_m, [560.0, 305.0, 243.0])
    assert foreign.euler_number == 2
    assert 0.85 < foreign.volume / foreign.convex_hull.volume < 0.92  # Itokawa: 0.86; convex: 1
    # A neck: cuts across the long axis are larger on both of its sides.
    cuts = [foreign.section([1, 0, 0], [x, 0, 0]).vertices[:, 1:] for x in (-50.0, 120.0, 190.0)]
    areas = [ConvexHull(cut).volume for cut in cuts]
    assert areas[1] < 0.8 * areas[2]
    assert areas[1] < 0.8 * areas[0]


@pytest.mark.parametrize(
    ("name", "box_m", "volume_km3"),
    [
        ("itokawa-like", (562.0, 305.0, 243.0), 0.0178), ("apophis-like", (523.0, 364.0, 314.0), 0.0276),
        # Bennu: Lauretta et al. (2019); Vesta: the ellipsoid in closed form.
        ("bennu-like", (565.0, 535.0, 508.0), 0.0615), ("vesta-like", (572.6e3, 557.2e3, 446.4e3), 7.457e7),
        # Ryugu: Watanabe et al. (2019).
        ("ryugu-like", (1004.0, 1004.0, 875.0), 0.377),
        # Didymos: Daly et al. (2024), and Dimorphos: Daly et al. (2023); ellipsoids in closed form.
        ("didymos-like", (818.0, 796.0, 590.0), 0.20115), ("dimorphos-like", (177.0, 174.0, 116.0), 0.0018706),
    ],
)  # fmt: skip
def test_a_stand_in_has_the_box_and_the_volume_of_the_real_body(name, box_m, volume_km3):
    mesh = EMBEDDED[name]()
    assert trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).euler_number == 2
    np.testing.assert_allclose(mesh.extent_m, box_m, rtol=0.02)
    assert mesh.volume_m3 / 1e9 == pytest.approx(volume_km3, rel=0.02)


def silhouettes(mesh, rotations, rng, pixel_m):
    """Rasterise a shape as seen from afar along each rotation's third axis, by points on its surface."""
    half_m = 200.0 / 3.0 * pixel_m
    corners = np.asarray(mesh.corners_m, dtype=np.float64)
    areas_m2 = mesh.areas_m2
    facet = rng.choice(len(corners), 60_000, p=areas_m2 / areas_m2.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), len(facet))
    points = np.einsum("nk,nki->ni", weights, corners[facet])
    side = round(2.0 * half_m / pixel_m)
    for rotation in rotations:
        grid = np.zeros((side, side), dtype=bool)
        u, v = ((((points @ rotation.T)[:, :2] + half_m) / pixel_m).astype(int)).T
        grid[u, v] = True
        yield binary_fill_holes(grid)


@pytest.mark.parametrize(
    ("shape", "pixel_m"),
    [
        pytest.param(name, size, marks=needs_data(file))
        for name, file, size in (
            ("itokawa_gaskell_q64.ply", "shapes/itokawa_gaskell_q64.ply", 6.0),
            ("apophis_lightcurve.obj", "shapes/apophis_lightcurve.obj", 6.0),
            ("bennu_radar.obj", "shapes/bennu_radar.obj", 6.0),
            (VESTA, VESTA, 6000.0),
        )
    ],
)
def test_a_stand_in_has_the_silhouettes_of_the_real_body(shape, pixel_m):
    """Mean intersection over union in 200 random views; the contact binary has 0.79 with Itokawa."""
    real = BodySpec(shape=shape, unit="km")
    rng, rotations = np.random.default_rng(1), Rotation.random(200, random_state=2).as_matrix()
    pairs = zip(
        *(silhouettes(load_body(one).mesh, rotations, rng, pixel_m) for one in (real, real.embedded())), strict=True
    )
    overlap = np.array([(a & b).sum() / (a | b).sum() for a, b in pairs])
    print(f"{real.embedded().shape}: {overlap.mean():.3f}, at least {overlap.min():.3f}")  # noqa: T201  a number to be read
    assert overlap.mean() > 0.9


def test_sphere_has_the_volume_of_its_radius():
    assert EMBEDDED["sphere"]().volume_m3 == pytest.approx(4.0 / 3.0 * np.pi * 250.0**3, rel=3e-3)


def test_a_body_in_use_is_shared_and_checked_against_every_spec(shape, cache):
    spec = BodySpec(shape=str(shape), unit="m", detail=DETAIL)
    body = load_body(spec, cache=cache)
    assert load_body(spec, cache=cache) is body
    with pytest.raises(BoresightError, match="expected_diameter_m"):
        load_body(spec.model_copy(update={"expected_diameter_m": (1.0, 2.0)}), cache=cache)
    kept = weakref.ref(body)
    del body
    gc.collect()
    assert kept() is None  # what nobody uses takes no memory
    shape.write_text(shape.read_text().replace("v ", "v  "))
    assert load_body(spec, cache=cache).sha256 == body_digest(spec)


def test_another_process_makes_the_same_body_bit_for_bit():
    code = (
        "import hashlib, scenarios.bodies.embedded as e; m = e.contact_binary();"
        "print(hashlib.sha256(m.vertices_m.tobytes() + m.faces.tobytes()).hexdigest())"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads},
            check=True, capture_output=True, text=True,
        ).stdout
        for threads in ("1", "2")
    }  # fmt: skip
    assert len(digests) == 1


def test_formats_of_the_schema_are_those_of_the_readers():
    formats = set(BodySpec.model_fields["format"].annotation.__args__)
    assert formats == {*READERS, "auto"} - {"pds-grid-west"}


def test_a_shape_is_searched_in_the_scenario_folder_then_in_the_data_folder(tmp_path, shape, monkeypatch):
    monkeypatch.delenv("BORESIGHT_DATA", raising=False)
    spec = BodySpec(shape="ball.obj")
    assert load_body(spec, [tmp_path / "elsewhere", tmp_path]).source == str(shape)
    with pytest.raises(
        BoresightError, match=r"body\.shape: ball\.obj was not found; looked for .*elsewhere.*set BORESIG"
    ):
        load_body(spec, [tmp_path / "elsewhere"])
    monkeypatch.setenv("BORESIGHT_DATA", str(tmp_path / "data"))
    (tmp_path / "data" / "shapes").mkdir(parents=True)
    shape.rename(tmp_path / "data" / "shapes" / "ball.obj")
    body = load_body(spec, [tmp_path])
    assert body.source == str(tmp_path / "data" / "shapes" / "ball.obj")
    assert body.name == "ball.obj"


@pytest.mark.parametrize("options", [{"unit": "km"}, {"format": "ply"}, {"longitude": "west"}])
def test_a_key_without_meaning_for_an_embedded_body_is_refused(options):
    with pytest.raises(BoresightError, match=rf"body\.{next(iter(options))}: .* has no meaning for the embedded body"):
        load_body(BodySpec(shape="sphere", **options))


def test_the_digest_depends_on_the_content_and_not_on_the_path(tmp_path, shape):
    spec = BodySpec(shape="ball.obj")
    digest = body_digest(spec, [tmp_path])
    copy = tmp_path / "copy.obj"
    copy.write_bytes(shape.read_bytes())
    assert body_digest(spec.model_copy(update={"shape": str(copy)})) == digest
    assert body_digest(spec.model_copy(update={"shading": "smooth"}), [tmp_path]) == digest
    assert load_body(spec, [tmp_path]).sha256 == digest
    others = [
        body_digest(spec.model_copy(update={"unit": "km"}), [tmp_path]),
        body_digest(spec.model_copy(update={"detail": DETAIL}), [tmp_path]),
        body_digest(spec.model_copy(update={"detail": DETAIL.model_copy(update={"seed": 4})}), [tmp_path]),
        body_digest(BodySpec(shape="sphere")),
    ]
    shape.write_text(shape.read_text() + "\n# edited\n")
    others.append(body_digest(spec, [tmp_path]))
    assert len({digest, *others}) == 6


def test_a_detailed_body_comes_back_from_the_cache_unchanged(cache):
    spec = BodySpec(shape="sphere", detail=DETAIL)
    first = load_body(spec, cache=cache)
    (entry,) = cache.entries()
    written = (entry.path / "vertices_m.npy").stat().st_mtime_ns
    second = load_body(spec, cache=cache)
    assert (entry.path / "vertices_m.npy").stat().st_mtime_ns == written
    for name in ("vertices_m", "faces", "albedo"):
        np.testing.assert_array_equal(getattr(first.mesh, name), getattr(second.mesh, name))
    assert first.notes == second.notes
    (entry.path / "faces.npy").write_bytes(b"rubbish")
    third = load_body(spec, cache=cache)
    np.testing.assert_array_equal(first.mesh.faces, third.mesh.faces)


def test_notes_name_features_that_the_mesh_cannot_resolve(cache):
    detail = DetailSpec(facets=4, boulders=BoulderSpec(count=20, min_diameter_m=1.0, max_diameter_m=2.0))
    body = load_body(BodySpec(shape="sphere", detail=detail), cache=cache)
    (note,) = body.notes
    assert note.startswith("20 boulders are smaller than two facet edges (")
    np.testing.assert_array_equal(body.mesh.vertices_m, EMBEDDED["sphere"]().vertices_m)
