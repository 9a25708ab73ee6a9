"""Maplets of a body of kilometres, whose heights are hundreds of metres, in a campaign."""

import numpy as np
import pytest
import trimesh
from tiny_campaign import SCENE, compute, write_campaign

from boresight.campaign.store import RunFolder
from boresight.estimators.maplets.database import MapletDatabase
from boresight.scenarios.bodies import load_body
from boresight.scenarios.spec.body import BodySpec

TIMES = 10.0
CAMPAIGN = """\
scenarios: [scene]
estimators: [prior, lmaps: {maplets: {spacing_m: 30, side: 25}, matching: {height_sigma_m: 0.2}}]
trials: 2
seed: 5
"""


def ten_times_larger(scene: str) -> str:
    """Make all lengths of the scene ten times longer, its shape, in kilometres, included."""
    larger = {
        "min_diameter_m: 25, max_diameter_m: 80": "min_diameter_m: 250, max_diameter_m: 800",
        "rms_m: 1.5, max_wavelength_m: 100": "rms_m: 15, max_wavelength_m: 1000",
        "min_wavelength_m: 25}": "min_wavelength_m: 250}",
        "range_m: 2000}": "range_m: 20000}\npose_error: {position_cam_m: {uniform: [[-50, 50], [-50, 50], [-5, 5]]}}",
        "body:\n": "body:\n  shape: comet.obj\n  unit: km\n",
    }
    for old, new in larger.items():
        assert old in scene
        scene = scene.replace(old, new)
    return scene


@pytest.fixture(scope="module")
def stored(cache, tmp_path_factory):
    folder = tmp_path_factory.mktemp("comet")
    shape = load_body(BodySpec(), ()).mesh
    trimesh.Trimesh(TIMES * shape.vertices_m / 1000.0, shape.faces, process=False).export(folder / "comet.obj")
    compute(write_campaign(folder, CAMPAIGN, ten_times_larger(SCENE)), folder / "run", 2)
    return RunFolder(folder / "run")


def test_the_stored_heights_are_beyond_those_of_whole_centimetres_in_16_bits(stored):
    (folder,) = (stored.path / "products").iterdir()
    heights = MapletDatabase.load(folder).heights_m
    assert np.nanmax(np.abs(heights)) > 327.68


def test_they_lead_to_the_pose(stored):
    """To half a pixel across the line of sight, which is 50 m wide at 20 km; the prior is off by several."""
    rows = stored.table("rows").query("estimator == 'lmaps'")
    assert (rows["status"] == "ok").all()
    assert (rows[["position_error_x_m", "position_error_y_m"]].abs() < 25.0).all(axis=None)
    assert (rows["prior_position_error_m"] > 75.0).all()
