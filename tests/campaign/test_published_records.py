"""Every published value and statement finds its numbers in a run of its campaign, made tiny and of an embedded body."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from test_paper_cheng import CHAIN, CRATERED, ORBIT
from tiny_campaign import SCENE, compute
from tiny_pairs import PAIRS

from boresight.campaign.runs.read import CATALOG
from boresight.reports.kinds import Content
from boresight.reports.pages.content import read_content
from boresight.reports.published import Comparison, load_published
from boresight.reports.schema.records import DERIVED
from boresight.scenarios.load import load_campaign

DATABASE = {"images": 40, "min_observations": 6, "clusters": {"seed_radius_m": 15, "sigma_floor_m": 0.1}}
PRIOR = "pose_error: {position_cam_m: {uniform: [[-50, 50], [-50, 50], [-5, 5]]}}\n"
SEQUENCE = """\
camera: {width_px: 1024, height_px: 1024, fov_deg: 30}
sequence: {sphere_radius_m: 190, orbit: {radius_m: 790}}
"""
EASED = {
    "sequence.orbit.step_deg": 6,
    "sequence.knowledge.motion_error": 0.1,
    "sequence.vision.repeatability": 0.99,
}
IMAGES = """\
body: {shape: apophis-sphere, detail: {facets: 80000, albedo: {sigma: 0.35, wavelength_m: 40}}}
camera: {width_px: 320, height_px: 320, fov_deg: 30}
sequence:
  orbit: {radius_m: 790, step_deg: 5, revolutions: 1}
  images: {starts: 2, tracks: 20, carry: patch, epipolar: known-attitude}
  knowledge: {motion_error: 0.1, ranges: 1, range_sigma_m: 0.1}
"""
SCENES = {
    "itokawa-2km-altimeter": f"{SCENE}{PRIOR}sensors: {{altimeter: {{sigma_m: 5}}}}\n",
    "apophis-sphere-sequence": SEQUENCE,
    "apophis-sphere-images": IMAGES,
    "eros-like-msi": CRATERED,
    "eros-crater-pairs": PAIRS,
    "eros-like-crater-images": PAIRS,
    "eros-orbit": ORBIT,
    "eros-orbit-combined": ORBIT,
    "eros-like-navigation": CHAIN,
    "eros-survey": CHAIN,
}
"""A small stand-in for each scenario that is not about images of Itokawa or 67P."""
TRIALS = {"cheng2003-matching-images": 12, "rowell2015-convergence": 30}
LONG = {
    "cheng2003-detection",
    "cheng2003-endtoend",
    "cheng2003-orbit",
    "delpech2015-images",
    "delpech2015-images-textures",
}
DELPECH = {f"delpech2015-{kind}" for kind in ("ba-landmarks", "ba-trace", "ba-views", "comparison", "ekf-trace")}
"""Campaigns that test_paper_delpech runs, and looks up all values of."""
CAMPAIGNS = [path.stem for path in sorted(CATALOG.glob("*.yaml")) if load_campaign(path.stem, CATALOG).spec.report]


def tiny(name: str, folder: Path) -> Path:
    """Write a campaign of the catalogue with few trials and small data bases, on small scenes that go by its names."""
    yaml = YAML(typ="safe", pure=True)
    spec = yaml.load((CATALOG / f"{name}.yaml").read_text(encoding="utf-8"))
    for scenario in spec["scenarios"]:
        scene = re.sub("^name: .*\n", "", SCENES.get(scenario, SCENE + PRIOR))
        (folder / f"{scenario}.yaml").write_text(f"name: {scenario}\n{scene}", encoding="utf-8")
    spec["scenarios"] = [f"{scenario}.yaml" for scenario in spec["scenarios"]]
    spec["trials"] = TRIALS.get(name, 2)
    entries = [{one: {}} if isinstance(one, str) else one for one in spec["estimators"]]
    spec["estimators"] = [small(one) for one in asked(spec["report"], entries)]
    if spec["scenarios"] == ["apophis-sphere-sequence.yaml"]:
        spec["set"] = {**spec.get("set", {}), **EASED}
    spec.pop("databases", None)
    if spec.get("grid", {}).get("design") == "one-at-a-time":
        del spec["grid"]  # what is published is of the scenarios as they are stated
    if "texture" in spec.get("grid", {}).get("axes", {}):
        spec["grid"]["axes"]["texture"]["values"] = [11, 12]
    file = folder / "campaign.yaml"
    with file.open("w", encoding="utf-8") as stream:
        yaml.dump(spec, stream)
    return file


def small(entry: dict[str, Any]) -> dict[str, Any]:
    """Make the data base of an estimator small, and let craters be found by geometry."""
    ((method, options),) = entry.items()
    if method == "landmark-database":
        return {method: options | DATABASE}
    if method in ("landmark-harris", "pose-solver", "centroid"):
        return {method: {**options, "database": DATABASE}}
    if method == "lmaps":
        return {method: {**options, "maplets": {"spacing_m": 15, "side": 15}}}
    if method == "landmark-altimeter":
        return {method: {**options, "options": {"database": DATABASE}}}
    return {method: {key: value for key, value in options.items() if key != "detector"}}


def asked(name: str, entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Keep the estimators that what is published names; where it names none, the first of each method."""
    comparison = load_published(name)
    terms = [term for claim in comparison.claims for term in claim.order]
    named = {each.estimator for each in (*comparison.values, *comparison.claims, *terms)}
    named |= {claim.solves for claim in comparison.claims} | {each.against for each in comparison.claims}
    named |= {value.against for value in comparison.values}
    of_label = {label_of(entry): entry for entry in entries}
    found = [entry for label, entry in of_label.items() if label in named]
    return found or list({next(iter(entry)): entry for entry in reversed(entries)}.values())


def label_of(entry: dict[str, Any]) -> str:
    """Return the label under which an estimator runs."""
    ((method, options),) = entry.items()
    return str(options.get("label", method))


def lost(content: Content, comparison: Comparison) -> list[str]:
    """Name the values and statements of which no scenario and estimator has all the numbers."""
    found = {id(item.published) for item in content.compared if item.ours is not None}
    said = {id(item.claim) for item in content.claims if None not in item.ours}
    there = [value for value in comparison.values if value.stage != DERIVED or comparison.radius_m]
    values = [value.model_dump_json() for value in there if id(value) not in found]
    return values + [claim.text for claim in comparison.claims if not claim.unmeasured and id(claim) not in said]


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.long] if name in LONG else []) for name in CAMPAIGNS if name not in DELPECH],
)
def test_every_value_and_statement_finds_its_numbers(name: str, cache: Path, tmp_path: Path) -> None:
    compute(tiny(name, tmp_path), tmp_path / "run", TRIALS.get(name, 2))
    content = read_content(tmp_path / "run")
    assert content.comparison is not None
    assert lost(content, content.comparison) == []
