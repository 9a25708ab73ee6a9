"""The page of Cheng et al. (2003), from small runs that go by the names of its campaigns."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import compute, write_campaign
from tiny_pairs import PAIRS

from boresight.campaign.cli import main
from boresight.campaign.store import RunFolder

CRATERED = """\
description: A small cratered sphere.
body: {shape: sphere}
craters:
  {seed: 5, count: 150, min_diameter_m: 20, max_diameter_m: 160, known_diameter_m: 30, edge_m: 4, roughness: null}
camera: {width_px: 240, height_px: 200, fov_deg: 12}
detector: {psf_sigma_px: 0.8}
viewpoint: {range_m: 2000, targets: [nadir, limb, terminator]}
lighting: {phase_deg: {uniform: [30, 70]}, measure: angle}
"""
ORBIT = """\
name: eros-orbit
description: Half a day about a body like Eros.
body: {shape: eros-like}
camera: {width_px: 537, height_px: 412, fov_deg: 2.93}
orbit:
  arc: {days: 0.5, predicted_days: 0.25}
  sightings: {images: 40, craters: 200}
  asteroid: {gravity_degree: 4}
  knowledge: {shape_degree: 8}
"""
CHAIN = """\
name: eros-like-navigation
description: Two dozen images of drawn craters on a body like Eros.
body: {shape: eros-like}
camera: {width_px: 537, height_px: 412, fov_deg: 2.93}
orbit:
  arc: {days: 0.6, predicted_days: 0.5}
  asteroid: {gravity_degree: 4}
  knowledge: {shape_degree: 16}
  imaging: {epochs: 25, detections: drawn}
"""
VOTE = "{crater-navigation: {label: vote, matcher: vote}}"
RUNS = {
    "detection": (CRATERED, "experiment: crater-detection\nestimators: [crater-classic]\ntrials: 3\n"),
    "matching": (PAIRS, "experiment: crater-matching\nestimators: [hybrid, vote]\ntrials: 4\n"),
    "endtoend": (CHAIN, f"experiment: crater-navigation\nestimators: [{VOTE}]\ntrials: 1\n"),
    "orbit": (ORBIT, "experiment: orbit-determination\nestimators: [batch-filter]\ntrials: 1\n"),
}


@pytest.fixture(scope="module")
def runs(cache, tmp_path_factory):
    """Small runs of some of the paper's campaigns."""
    folder = tmp_path_factory.mktemp("cheng")
    for kind, (scene, text) in RUNS.items():
        name = f"cheng2003-{kind}"
        head = f"name: {name}\ntitle: T\nscenarios: [scene]\nseed: 4\nreport: {name}\n"
        file = write_campaign(folder / "files" / kind, head + text, scene)
        compute(file, folder / "runs" / name, int(re.search(r"trials: (\d+)", text)[1]))
    return folder / "runs"


@pytest.fixture(scope="module")
def page(runs):
    """What the command writes."""
    out = runs.parent / "figures"
    assert main(["figures", "cheng2003", "--runs", str(runs), "--out", str(out)]) == 0
    return out


def test_figures_have_the_numbers_of_the_paper(page):
    drawn = {path.stem for path in page.glob("figure_*.png")}
    wanted = {"figure_02", "figure_03_1", "figure_06_cheng2003-matching_hybrid", "figure_09"}
    assert wanted | {"figure_10_eros-orbit_batch-filter"} <= drawn
    text = (page / "table.md").read_text(encoding="utf-8")
    assert "Figure 2. Results of the stages of detection" in text
    for name in ("cheng2003-matching-images", "cheng2003-invariants"):
        assert len(re.findall(rf"^- {name}: no finished run .* boresight run {name} --out .*{name}$", text, re.M)) == 1


def test_the_numbers_are_those_of_the_rows(page, runs):
    table = pd.read_csv(page / "table.csv").set_index("quantity")
    store = RunFolder(runs / "cheng2003-detection")
    found, craters = store.table("detections"), store.table("craters")
    detectable = craters[craters["detectable"]].merge(
        found[found["kept"] & (found["crater"] >= 0)], on=["trial", "crater"], how="left"
    )
    rate = table.loc["detectable craters found, detection"]
    assert rate["ours"] == pytest.approx(100.0 * detectable["rank"].notna().mean())
    assert rate["n"] == int(craters["detectable"].sum())
    errors = RunFolder(runs / "cheng2003-orbit").table("orbit_errors")
    arc = errors.loc[~errors["predicted"], "position_error_m"]
    told = table.loc["RMS position error over the arc, orbit, batch-filter", "ours"]
    assert told == pytest.approx(float(np.sqrt((arc**2).mean())), rel=1e-6)


def test_the_chain_is_told_beside_the_paper(page, runs):
    table = pd.read_csv(page / "table.csv")
    told = table[table["campaign"] == "cheng2003-endtoend"].set_index("quantity")["ours"]
    images = RunFolder(runs / "cheng2003-endtoend").table("navigated_images")
    assert told.filter(like="craters per image").to_list() == pytest.approx(
        [images["n_detections"].mean(), images["n_detections"].median()]
    )
    assert "cheng2003-endtoend: From images to the data base" in (page / "table.md").read_text(encoding="utf-8")


def test_matching_is_told_by_the_angles(page):
    text = (page / "table.md").read_text(encoding="utf-8")
    assert "cheng2003-matching: Matching, tiny-pairs" in text
    table = pd.read_csv(page / "table.csv").set_index("quantity")
    distance = table.loc["largest distance of a crater from its epipolar line, matching, hybrid"]
    assert (distance["campaign"], distance["n"]) == ("cheng2003-matching", 4)
    assert distance["published"].endswith("(read as 20 px)")
    assert "://" not in (page / "index.html").read_text(encoding="utf-8").replace("http://www.w3.org", "")
