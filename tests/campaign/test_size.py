"""Memory of the largest bodies."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.long

_LARGE = """
name: large
description: A ball of 21 million facets in a camera of 4096 x 4096 pixels.
body:
  shape: sphere
  expected_diameter_m: [1, 10000]
  detail:
    facets: 20000000
    boulders: {count: 3000, min_diameter_m: 3, max_diameter_m: 40}
    roughness: {rms_m: 0.8, max_wavelength_m: 100, min_wavelength_m: 4}
camera: {width_px: 4096, height_px: 4096, fov_deg: 18.3}
viewpoint: {range_m: 2000}
lighting: {phase_deg: 40}
pose_error: {position_cam_m: {normal: [5, 5, 5]}}
"""

_RENDER = """
import resource
from pathlib import Path
from boresight.campaign.imaging.world import open_world
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.bodies import load_body
from boresight.scenarios.load import load_scenario

scenario = load_scenario("large.yaml")
facets = len(load_body(scenario.spec.body, scenario.search_dirs).mesh.faces)
seen = open_world(scenario, choose_variant().name).source.trial_image(1, 0).image
print(facets, (seen > 0).sum(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


def test_twenty_million_facets_fit_into_4_gib(tmp_path, monkeypatch):
    """Resident at most, from the making of the body to an image of 16.8 megapixels."""
    (tmp_path / "large.yaml").write_text(_LARGE)
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    ran = subprocess.run([sys.executable, "-c", _RENDER], cwd=tmp_path, capture_output=True, text=True, check=True)
    facets, lit, peak_gib = map(float, ran.stdout.split())
    assert facets >= 20e6
    assert lit > 1e6
    assert peak_gib < 4.0
