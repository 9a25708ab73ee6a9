"""A campaign's grid becomes scenarios, rows and a report."""

import json
from pathlib import Path

import pytest
from tiny_campaign import SCENE, compute

from boresight.campaign.runs.read import CATALOG, campaign_names
from boresight.campaign.runs.resolve import reload, resolve
from boresight.reports.pages.build import write_report
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_campaign

CAMPAIGN = """\
scenarios: [scene]
set: {brdf.albedo: 0.2}
grid:
  design: one-at-a-time
  axes:
    rotation: {label: "rotation, deg", key: onboard.rotation_error_deg.normal, values: [0, 3]}
    sky: {levels: {clear: {}, dull: {brdf.albedo: 0.1}}}
estimators: [prior]
trials: 3
seed: 5
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "many.yaml").write_text(CAMPAIGN)
    return tmp_path / "many.yaml"


def test_levels_lie_on_the_campaigns_overrides_and_below_the_command_lines(file):
    campaign = resolve(str(file))
    assert [s.spec.name for s in campaign.scenarios] == ["scene", "scene-rotation-3", "scene-sky-dull"]
    assert [s.spec.brdf.albedo for s in campaign.scenarios] == [0.2, 0.2, 0.1]
    assert campaign.scenarios[1].spec.onboard.rotation_error_deg.normal == 3
    above = resolve(str(file), ["brdf.albedo=0.5"])
    assert [s.spec.brdf.albedo for s in above.scenarios] == [0.5, 0.5, 0.5]


def test_a_level_that_the_scenario_refuses_is_told(file):
    file.write_text(CAMPAIGN.replace("values: [0, 3]", "values: [0, -3]"))
    with pytest.raises(BoresightError, match=r"many.yaml:6: onboard.rotation_error_deg.normal: -3.0 is not at least 0"):
        resolve(str(file))


def test_a_run_keeps_the_grid_and_its_report_shows_it(file, tmp_path):
    compute(file, tmp_path / "run", trials=3)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert [axis["name"] for axis in manifest["grid"]["axes"]] == ["rotation", "sky"]
    assert [one["name"] for one in manifest["grid"]["scenarios"]] == ["scene", "scene-rotation-3", "scene-sky-dull"]
    again = reload(manifest)
    assert again is not None
    assert {s.spec.name for s in again.scenarios} == {"scene", "scene-rotation-3", "scene-sky-dull"}
    assert write_report(tmp_path / "run").html.exists()


SPECS = {name: load_campaign(name, CATALOG).spec for name in campaign_names()}
WITHOUT_ONBOARD = {"sequence", "crater-matching", "orbit-determination", "crater-navigation", "approach-orbit"}
# Of real images nobody knows all.
WITHOUT_REFERENCE = {"approach-67p-real", "compare-navcam67p", "dawn-vesta-real", "dawn-vesta-survey-real"}
GRIDS_OF_IMAGES = [
    name
    for name, spec in SPECS.items()
    if spec.grid and spec.experiment not in WITHOUT_ONBOARD and name not in WITHOUT_REFERENCE
]


@pytest.mark.parametrize("name", GRIDS_OF_IMAGES)
def test_campaigns_of_the_catalogue_begin_with_a_reference_that_knows_all(name):
    """The first scenario is believed as it is but for the albedo's variation, of which there is none in it."""
    spec = resolve(name).scenarios[0].spec
    onboard = spec.onboard
    assert onboard.brdf in (None, spec.brdf)
    assert onboard.focal_error == onboard.distortion_error == 0.0
    assert all(law is None or law.normal == 0.0 for law in (onboard.pole_error_deg, onboard.sun_error_deg))
    assert onboard.facets is None or onboard.facets == spec.body.detail.facets
    assert onboard.height_error is None or onboard.height_error.rms_m == 0.0
    detail = spec.body.detail
    assert detail is None or detail.albedo is None or detail.albedo.sigma == 0.0
