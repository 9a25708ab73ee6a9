"""`boresight sensitivity`: what varies moves the errors, what is not applied is told, what is wrong is one line."""

from __future__ import annotations

import re

import pandas as pd
import pytest
from tiny_campaign import CAMPAIGN, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.runs.sensitivity import _setting, make_design
from boresight.reports.compare.global_sensitivity import VariedKey
from boresight.scenarios.load import load_scenario


def sensitivity(file, out, *arguments):
    return main(["sensitivity", str(file), "--jobs", "1", "--out", str(out), *map(str, arguments)])


@pytest.mark.usefixtures("cache")
def test_a_key_that_changes_nothing_is_told(tmp_path, capsys):
    file, out = write_campaign(tmp_path), tmp_path / "run"
    over = ("--over", "pose_error.attitude.angle_deg.max=0.1:20", "--over", "sensors.altimeter.sigma_m=1:10")
    design = ("--method", "latin-hypercube", "--samples", 4, "--trials", 3)
    assert sensitivity(file, out, *over, *design) == 0
    said = capsys.readouterr().out
    assert "sensors.altimeter.sigma_m changes no result of landmark-harris" in said
    assert "angle_deg.max changes no result" not in said
    for text in (said, (out / "sensitivity" / "sensitivity.md").read_text()):
        assert "Perfect knowledge of: shape, reflectance, camera, Sun, spin," in text
    samples = pd.read_csv(out / "sensitivity" / "samples.csv")
    assert len(samples) == 4
    assert len(set(samples["landmark-harris"])) > 1
    rows = pd.read_parquet(out / "rows")
    # Each sample is a scenario with the draws of the base: attitude errors in proportion to the bound.
    base, first = (rows[rows["scenario"] == name].query("estimator == 'prior'") for name in ("base", "sample-00001"))
    bound = samples["pose_error.attitude.angle_deg.max"][0]
    ratio = first["prior_attitude_error_deg"].to_numpy() / base["prior_attitude_error_deg"].to_numpy()
    assert ratio == pytest.approx(bound / 2.0)
    page = (out / "sensitivity" / "sensitivity.html").read_text(encoding="utf-8")
    assert "sensors.altimeter.sigma_m changes no result of landmark-harris" in page
    assert page.count('src="data:image/png;base64,') == 1
    for name in ("sensitivity.md", "sensitivity.png", "sensitivity.pdf", "indices.csv"):
        assert (out / "sensitivity" / name).stat().st_size > 100


GRID = "grid: {axes: {range: {label: range, key: viewpoint.range_m, values: [900, 1000]}}}\n"


@pytest.mark.parametrize(
    ("chosen", "why"),
    [
        ((), "has 2 scenarios: vary one, by --scenario: scene-900, scene-1000"),
        (("--scenario", "scene"), "--scenario scene: .* choose one of scene-900, scene-1000"),
    ],
)
def test_a_campaign_of_several_scenarios_wants_one_named(tmp_path, refused, chosen, why):
    file = write_campaign(tmp_path, CAMPAIGN + GRID)
    assert re.search(why, refused("sensitivity", file, "--over", "camera.fov_deg=10:20", *chosen))


def test_a_scenario_of_a_grid_is_varied_where_it_stands(tmp_path):
    file = write_campaign(tmp_path, CAMPAIGN + GRID)
    resolved = resolve(str(file), ["detector.read_noise_e=3"])
    varied = [VariedKey("camera.fov_deg", 10.0, 20.0)]
    design = make_design(str(file), resolved, "scene-1000", varied, 2, "latin-hypercube")
    specs = {one.spec.name: one.spec for one in design.campaign.scenarios}
    assert {(one.viewpoint.range_m, one.detector.read_noise_e) for one in specs.values()} == {(1000.0, 3.0)}
    assert [specs[f"key-1-{end}"].camera.fov_deg for end in ("low", "high")] == [10.0, 20.0]
    assert specs["base"].camera == resolved.scenario("scene-1000").spec.camera
    assert design.campaign.spec.grid is None


def test_one_bound_of_a_law_is_set_and_the_other_stays():
    law = "lighting.phase_deg={uniform: [10, 60]}"
    spec = load_scenario("quickstart", [law]).spec
    for end, value, bounds in (("min", 20.0, (20.0, 60.0)), ("max", 45.0, (10.0, 45.0))):
        change = _setting(spec, VariedKey(f"lighting.phase_deg.{end}", 0.0, 90.0), value)
        assert load_scenario("quickstart", [law, change]).spec.lighting.phase_deg.uniform == bounds
