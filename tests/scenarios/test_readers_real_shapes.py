"""Readers on shape models of missions and radar, where BORESIGHT_DATA points at them."""

import numpy as np
import pytest
import trimesh
from mission_data import data_file, needs_data
from scipy.spatial import cKDTree

from boresight.scenarios.bodies import load_body
from boresight.scenarios.bodies.readers import read_shape
from boresight.scenarios.spec.body import BodySpec

pytestmark = needs_data()


def as_trimesh(shape):
    return trimesh.Trimesh(shape.vertices, shape.faces, process=False)


# Facets as the labels state them (Eros, Geographos). Volumes in km3: Eros 2535 (Miller et al. 2002), 67P 18.7 (Jorda
# et al. 2016), Bennu 0.0623 (Nolan et al. 2013), Apophis a sphere of 0.375 km diameter.
@pytest.mark.parametrize(
    ("name", "facets", "volume_km3", "tolerance"),
    [
        ("eros022540.tab", 22540, 2535.0, 0.01),
        ("1620geographos.tab", 16380, None, None),
        ("253mathilde.tab", 2 * 120 * 59, None, None),
        ("67p-16k.obj", 31998, 18.7, 0.02),
        ("apophis_lightcurve.obj", 2024, np.pi / 6.0 * 0.375**3, 1e-6),
        ("itokawa_gaskell_q32.obj", 12288, 0.0178, 0.01),
        ("itokawa_gaskell_q64.ply", 49152, 0.0178, 0.001),
        ("itokawa_gaskell_q64.icq", 49152, 0.0178, 0.001),
        ("bennu_radar.obj", 2692, 0.0623, 0.01),
    ],
)
def test_facets_volume_and_soundness(name, facets, volume_km3, tolerance):
    path = data_file(f"shapes/{name}")
    mesh = as_trimesh(read_shape(path, west_longitudes="mathilde" in name))
    assert len(mesh.faces) == facets
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    if volume_km3:
        assert mesh.volume == pytest.approx(volume_km3, rel=tolerance)


def test_the_two_files_of_one_itokawa_agree():
    icq, ply = (read_shape(data_file(f"shapes/itokawa_gaskell_q64.{suffix}")) for suffix in ("icq", "ply"))
    np.testing.assert_allclose(np.ptp(icq.vertices, axis=0), [0.562, 0.305, 0.243], atol=5e-4)
    used = ply.vertices[np.unique(ply.faces)]
    distance, partner = cKDTree(used).query(icq.vertices)
    assert distance.max() < 1e-6  # km: single against printed precision
    assert len(np.unique(partner)) == len(used) == len(icq.vertices)
    assert as_trimesh(icq).volume == pytest.approx(as_trimesh(ply).volume, rel=1e-4)


def test_west_longitudes_mirror_mathilde():
    path = data_file("shapes/253mathilde.tab")
    rows = np.loadtxt(path)
    row = rows[np.argmax(np.where(abs(rows[:, 0]) < 60.0, rows[:, 2], 0.0))]
    lat, lon = np.radians(row[:2])
    west, east = (read_shape(path, west_longitudes=flag).vertices for flag in (True, False))
    point = row[2] * np.array([np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), np.sin(lat)])
    assert np.linalg.norm(west - point, axis=1).min() < 1e-9
    assert np.linalg.norm(east - point * [1, -1, 1], axis=1).min() < 1e-9


def test_volume_of_a_grid_is_the_integral_of_its_radii():
    path = data_file("shapes/253mathilde.tab")
    lat_deg, lon_deg, radius = np.loadtxt(path).T
    once = lon_deg < 360.0
    step = np.radians(3.0)
    volume = (radius[once] ** 3 * np.cos(np.radians(lat_deg[once]))).sum() * step**2 / 3.0
    assert as_trimesh(read_shape(path, west_longitudes=True)).volume == pytest.approx(volume, rel=0.01)


def test_each_shape_passes_the_checks_in_kilometres():
    folder = data_file("shapes/itokawa_gaskell_q64.ply").parent
    for path in sorted(one for one in folder.iterdir() if one.suffix in (".obj", ".ply", ".icq", ".tab")):
        spec = BodySpec(shape=path.name, unit="km", expected_diameter_m=(300.0, 60_000.0))
        body = load_body(spec, [folder])
        assert body.mesh.volume_m3 > 0.0, path.name
        assert body.source == str(path)


def test_a_file_in_kilometres_read_as_metres_is_named():
    path = data_file("shapes/itokawa_gaskell_q16.obj")
    with pytest.raises(Exception, match=r"q16\.obj: .*0\.5577.*is the file in km\? set body\.unit: km"):
        load_body(BodySpec(shape=str(path)))
