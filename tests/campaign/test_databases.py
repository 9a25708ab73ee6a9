"""Several data bases of one campaign: what is drawn for each, which trial has which, and what stays as it was."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import CAMPAIGN, RESULTS, SMALL, assert_same_results, compute, write_campaign

from boresight.campaign.inspection.recompute import Case, recompute, reopened
from boresight.campaign.products.assets import BuiltAssets
from boresight.campaign.products.databases import (
    SEED_STEP,
    with_database_craters,
    with_database_knowledge,
    with_database_seed,
)
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.estimators.maplets.build import MapletOptions, spread_points
from boresight.reports.figures.named import with_trial_counts
from boresight.reports.kinds import report_kind
from boresight.reports.pages.build import html_page, markdown
from boresight.reports.pages.content import read_content
from boresight.scenarios.bodies import load_body
from boresight.scenarios.load import load_scenario
from boresight.scenarios.onboard import onboard_spec

DATABASES, TRIALS = 3, 12
SCENE_ERRED = "onboard: {height_error: {rms_m: 1, min_wavelength_m: 20, seed: 5}}\n"


@pytest.fixture(scope="module")
def several(cache, tmp_path_factory):
    """A run with three data bases, and the same with one."""
    folder = tmp_path_factory.mktemp("databases")
    text = SMALL.replace("trials:", "  - lmaps: {maplets: {spacing_m: 40, side: 15}}\ntrials:")
    files = {
        1: write_campaign(folder / "one", text),
        DATABASES: write_campaign(folder / "several", text + f"databases: {DATABASES}\n"),
    }
    for number, file in files.items():
        compute(file, folder / str(number), TRIALS)
    return {number: folder / str(number) for number in files}


def rows(folder):
    return RunFolder(folder).table("rows")


def test_trials_have_the_data_bases_in_turn_and_the_prior_none(several):
    table = rows(several[DATABASES])
    for estimator, own in table.groupby("estimator"):
        wanted = own["trial"] % DATABASES
        assert own["database"].isna().all() if estimator == "prior" else (own["database"] == wanted).all()


def test_the_first_data_base_is_that_of_a_campaign_with_one(several):
    """Bit for bit: rows of its trials and the products; the other trials have other errors on the same views."""
    one, table = rows(several[1]), rows(several[DATABASES])
    first = table["trial"] % DATABASES == 0
    pd.testing.assert_frame_equal(one[first], table[first], check_exact=True, check_dtype=False)
    errors = [own[~first & (own["estimator"] != "prior")]["position_error_m"].to_numpy() for own in (one, table)]
    assert (errors[0] != errors[1]).all()
    priors = [own["prior_position_error_m"].to_numpy() for own in (one, table)]
    np.testing.assert_array_equal(*priors)


def test_products_are_named_by_their_data_base(several):
    manifest = json.loads((several[DATABASES] / "manifest.json").read_text())
    found = {(one["estimator"], one["database"]): one["folder"] for one in manifest["products"]}
    assert len(found) == len(set(found.values())) == 2 * DATABASES
    alone = json.loads((several[1] / "manifest.json").read_text())
    assert {one["folder"] for one in alone["products"]} == {found[name, 0] for name in ("landmark-harris", "lmaps")}


def test_a_campaign_with_one_has_the_digest_that_it_had(tmp_path):
    """A key of its own enters the digest only where there are several."""
    alone = resolve(str(write_campaign(tmp_path / "a")))
    same = resolve(str(write_campaign(tmp_path / "b", CAMPAIGN + "databases: 1\n")))
    other = resolve(str(write_campaign(tmp_path / "c", CAMPAIGN + "databases: 2\n")))
    assert "databases" not in alone.identity
    assert alone.digest == same.digest != other.digest


def test_workers_and_a_resumed_run_have_the_same_rows(several, tmp_path):
    file = several[1].parent / "several" / "tiny.yaml"
    compute(file, tmp_path / "run", 10)
    compute(file, tmp_path / "run", TRIALS, jobs=2)
    assert_same_results(several[DATABASES], tmp_path / "run")
    assert "rows" in RESULTS


def test_a_case_is_worked_out_again_with_its_data_base(several):
    folder = RunFolder(several[DATABASES])
    campaign = reopened(folder)
    for trial in (0, 4, 5):
        again = recompute(campaign, folder, Case("scene", "landmark-harris", trial))
        assert not again.comparison.differences
        assert again.row["database"] == trial % DATABASES


def page_without_pixels(content):
    figures = [with_trial_counts(figure, [content.run]) for figure in report_kind(content.run).figures(content)]
    return html_page(content, [(figure, b"") for figure in figures])


def test_the_report_takes_the_data_base_for_what_is_independent(several):
    content, alone = read_content(several[DATABASES]), read_content(several[1])
    assert any("drawn 3 times" in note for note in content.notes)
    assert "of one data base" not in page_without_pixels(content)
    assert page_without_pixels(alone).count("of one data base") == 1, "a page says it once, at its top"
    assert "Pose error, scene, of one data base" in markdown(alone, ())


def test_the_knowledge_of_a_data_base_is_its_own(cache, tmp_path):
    """Another error of the heights on the same true shape."""
    (tmp_path / "s.yaml").write_text(
        "body: {height_error: {rms_m: 0}}\ncamera: {width_px: 64, height_px: 64, fov_deg: 18}\n"
        "viewpoint: {range_m: 2000}\nlighting: {phase_deg: {uniform: [0, 50]}}\n" + SCENE_ERRED
    )
    scenario = load_scenario(str(tmp_path / "s.yaml"))
    other = with_database_knowledge(scenario, 2)
    assert other.spec.onboard.height_error.seed == 5 + 2 * SEED_STEP
    assert other.spec.model_copy(update={"onboard": scenario.spec.onboard}) == scenario.spec
    shapes = [load_body(onboard_spec(one.spec).body, ()).mesh.vertices_m for one in (scenario, other)]
    assert shapes[0].shape == shapes[1].shape
    assert not np.allclose(shapes[0], shapes[1])
    assert with_database_knowledge(scenario, 0) is scenario
    for number, shape in ((0, shapes[0]), (2, shapes[1])):
        assets = BuiltAssets(scenario, tmp_path, 1, "", database=number)
        assert not assets.depends_on_database
        np.testing.assert_array_equal(assets.shape().vertices_m, shape)
        assert assets.depends_on_database


def test_a_world_of_craters_is_the_data_bases_own():
    scenario = load_scenario("eros-like-msi")
    one, other = with_database_craters(scenario, 0), with_database_craters(scenario, 1)
    assert one is scenario
    assert other.spec.craters.seed == scenario.spec.craters.seed + SEED_STEP
    assert replace(other, spec=other.spec.model_copy(update={"craters": scenario.spec.craters})).spec == scenario.spec


def test_other_maplets_begin_at_another_place_and_cover_as_well():
    points = np.random.default_rng(1).normal(size=(500, 3))
    first, other = (spread_points(points, 0.8, seed) for seed in (None, with_database_seed(MapletOptions(), 1).seed))
    assert first[0] != other[0]
    for chosen in (first, other):
        assert np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1).max() <= 0.8


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("databases: 0\n", "databases"),
        ("databases: 2\nexperiment: landmark-database\n", "databases: 1 is all that a campaign of landmark-database"),
        (
            "experiment: zebra\n",
            ".yaml:9: experiment: 'zebra' is not a kind of trial; choose one of approach-orbit, crater-detection, "
            "crater-matching",
        ),
    ],
)
def test_a_wrong_key_is_one_line(tmp_path, refused, change, why):
    file = write_campaign(tmp_path / "campaign", CAMPAIGN + change)
    assert why in refused("run", file, "--out", tmp_path / "run")
