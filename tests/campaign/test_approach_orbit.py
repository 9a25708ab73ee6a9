"""The orbit of an approach as a campaign: images, fixes and orbits of one trial, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from orbit_worlds import orbit_world
from tiny_campaign import SCENE, run, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.runs.check import check_scenario
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.known import known_on_board
from boresight.scenarios.load import load_scenario
from boresight.scenarios.orbits.true_orbit import epochs_s, state_at_epoch

CRATERS = "craters={min_diameter_m: 20, max_diameter_m: 100, count: 50, known_diameter_m: 20}"
NAMES = ("prior", "centroid", "limb")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("approach")
    text = (
        "title: T\nexperiment: approach-orbit\nscenarios: [approach-orbit]\n"
        "set: {orbit: {imaging: {epochs: 6}}}\n"
        f"estimators: [{', '.join(NAMES)}]\ntrials: 1\nseed: 5\n"
    )
    assert run(write_campaign(folder / "campaign", text, SCENE), folder / "run") == 0
    return folder / "run"


def test_each_estimator_feeds_an_orbit_of_its_own(out):
    rows = pd.read_parquet(out / "rows").set_index("estimator")
    assert rows["status"].to_dict() == {"prior": "failed", "centroid": "ok", "limb": "ok"}
    assert rows.loc["prior", "reason"] == "0 of 6 images have a fix: at least 3 are needed"
    assert rows.loc[["centroid", "limb"], "range_m"].tolist() == pytest.approx([1e6, 1e6])
    told = pd.read_parquet(out / "diagnostics").pivot_table(index="estimator", columns="name", values="value")
    assert told.loc["centroid", "fixes"] == 6
    assert 3 <= told.loc["limb", "fixes"] == 6 - told.loc["limb", ["failed_images", "gated_images"]].sum() < 6
    orbits = pd.read_parquet(out / "orbits").set_index("estimator")
    # Of 10 km at the epoch, the limb leaves 20 m at the closest approach.
    assert orbits.loc["limb", "predicted_error_m"] < 20.0
    assert orbits.loc["limb", "predicted_sigma_m"] < 0.5 * orbits.loc["centroid", "predicted_sigma_m"]
    assert orbits[["residual_rms_px", "wrong_left_share"]].isna().all(axis=None)


def test_the_orbit_is_predicted_without_an_image(out, capsys, monkeypatch):
    monkeypatch.setattr("boresight.campaign.imaging.image_store.Imager.image", None)
    assert main(["predict", str(out.parent / "campaign" / "tiny.yaml"), "--run", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "no predictor: prior, centroid" in printed
    (line,) = (line for line in printed.splitlines() if line.startswith("approach-orbit"))
    predicted, _, _, _, _, _, stated = line.split("position, m")[1].split()[:7]
    assert float(predicted) == pytest.approx(float(stated), rel=0.2)


def test_it_is_reported_and_inspected(out):
    assert main(["report", str(out), "--worst", "0"]) == 0
    text = (out / "report" / "report.md").read_text()
    assert "Orbit determination" in text
    assert "world of craters" not in text
    assert main(["inspect", str(out), "--trial", "0", "--estimator", "limb"]) == 0
    found = json.loads(next(out.glob("inspect/*limb*/*.json")).read_text())
    assert found["status"] == "ok"
    assert np.linalg.norm(found["state_inertial"][:3]) == pytest.approx(1e6, rel=0.01)


def test_images_are_at_even_steps_of_the_logarithm_of_the_range():
    loaded = load_scenario("approach-orbit", ("orbit.imaging.epochs=7",))
    section = loaded.spec.orbit
    state, times = state_at_epoch(section.arc, 0.0), epochs_s(replace(orbit_world(), spec=section))
    ranges = np.linalg.norm(state[:3] + times[:, None] * state[3:], axis=1)
    np.testing.assert_allclose(ranges, np.geomspace(1e6, section.arc.ranges_m[0], 7), rtol=1e-9)
    assert section.arc.ranges_m[0] == pytest.approx(10_000.0, rel=1e-3)
    assert np.linalg.norm(state[3:]) == pytest.approx(3.0)
    # The impact parameter is the angular momentum over the speed.
    assert np.linalg.norm(np.cross(state[:3], state[3:])) / 3.0 == pytest.approx(2000.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("orbit.arc.days=4",), "orbit.arc: days: 4 is later than the closest approach: give at most 3.858"),
        (("orbit.arc.approach.miss_m=2e6",), "miss_m: 2e[+]06 is not less than range_m, 1e[+]06"),
        (("orbit.imaging=null",), "orbit.imaging: missing, but the experiment approach-orbit needs it"),
        (("orbit.arc.approach=null",), "orbit.arc.approach: missing, but the experiment approach-orbit needs it"),
        (("orbit.arc.eccentricity=0.1",), "orbit.arc: eccentricity has no meaning beside approach: leave it out"),
        (("orbit.arc.semi_major_axis_m=1e6",), "semi_major_axis_m has no meaning beside approach"),
        (("orbit.arc.anomaly_deg=5",), "anomaly_deg has no meaning beside approach"),
        (("camera.distortion={k1: 0.1}",), "camera.distortion: has no effect in approach-orbit: leave it out"),
        (("sensors.altimeter.sigma_m=1",), "sensors: has no effect in approach-orbit"),
        (("orbit.imaging.detections=drawn",), "orbit.imaging.detections: has no effect in approach-orbit"),
        (("orbit.imaging.craters.count=9",), "orbit.imaging.craters: has no effect in approach-orbit"),
        (("orbit.imaging.errors.recall=0.5",), "orbit.imaging.errors: has no effect in approach-orbit"),
        (("orbit.sightings.noise_px=0.1",), "orbit.sightings: has no effect in approach-orbit"),
        ((CRATERS,), "craters: has no effect in approach-orbit"),
        (("orbit.arc.approach.miss_m=100", "orbit.arc.days=3.8579"), "its end at .* choose fewer days, or a larger"),
    ],
)
def test_what_is_no_approach_is_refused(changes, said):
    with pytest.raises(BoresightError, match=said):
        check_scenario(load_scenario("approach-orbit", changes), "approach-orbit")


def test_the_most_days_that_a_message_gives_are_accepted():
    with pytest.raises(BoresightError) as refused:
        load_scenario("approach-orbit", ("orbit.arc.days=4",))
    most = str(refused.value).split("at most ")[1].split()[0].rstrip(".;,")
    assert load_scenario("approach-orbit", (f"orbit.arc.days={most}",)).spec.orbit.arc.days == pytest.approx(
        3.858, abs=1e-3
    )


@pytest.mark.parametrize(
    ("estimator", "named"),
    [
        ("landmark-harris", "landmark-harris"),
        ("tuned: {base: limb}", "tuned"),
        ("approach: {near: landmark-harris}", "landmark-harris"),
    ],
)
def test_an_estimator_that_may_not_fuse_the_prior_is_refused(tmp_path, capsys, estimator, named):
    text = (
        f"experiment: approach-orbit\nscenarios: [approach-orbit]\nestimators: [{{{estimator}}}]\ntrials: 1\nseed: 5\n"
    )
    if ":" not in estimator:
        text = text.replace("{", "").replace("}", "")
    assert run(write_campaign(tmp_path / "campaign", text, SCENE), tmp_path / "run") == 2
    said = capsys.readouterr().err
    assert f"estimator '{named}' does not say that it fuses the prior" in said
    assert said.strip().count("\n") == 0


def test_the_scenario_suits_the_kind_and_says_what_is_known():
    loaded = load_scenario("approach-orbit", ("body.shape=bennu-like",))  # lengths of craters follow from the body
    check_scenario(loaded, "approach-orbit")
    known = known_on_board(loaded.spec, "approach-orbit")
    assert {"shape", "reflectance"} <= {item.name for item in known.items if item.standing == "exactly"}
    assert {"orbit", "attitude", "noise"} <= {item.name for item in known.items if item.standing == "not"}
    assert not any("crater" in item.name for item in known.items)
