"""Data bases as trials: each from images of its own, the same ones however a run comes about."""

import pytest
from tiny_campaign import SCENE, compute, run, write_campaign

from boresight.campaign.kinds.landmark_database import at_trial
from boresight.campaign.products import landmark_database, product_key
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.store import RunFolder
from boresight.estimators.landmark.database import DatabaseOptions, LandmarkDatabase
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.kinds import brief_grids, report_grids
from boresight.reports.pages.content import read_content

DATABASES = """\
title: Data bases
experiment: landmark-database
scenarios: [scene]
estimators:
  - landmark-database:
      {label: base, images: 40, min_observations: 6, clusters: &wide {seed_radius_m: 15, sigma_floor_m: 0.1}}
  - landmark-database: {label: strict, images: 40, min_observations: 12, clusters: *wide}
  - landmark-database: {label: hopeless, images: 40, min_observations: 40, clusters: {seed_radius_m: 1}}
trials: 3
seed: 100
"""


@pytest.fixture(scope="module")
def file(cache, tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("databases"), DATABASES, SCENE)


@pytest.fixture(scope="module")
def stored(file):
    compute(file, file.parent / "run", 3)
    return RunFolder(file.parent / "run")


def numbers(folder):
    return folder.table("diagnostics").pivot_table(index=["estimator", "trial"], columns="name", values="value")


def test_the_counts_are_those_of_the_data_base(file, stored):
    """Trial 0 is in the run folder; a closed surface of Euler characteristic 2 has 2n - 4 facets."""
    campaign = resolve(str(file), variant=choose_variant().name)
    options = DatabaseOptions(images=40, min_observations=6, clusters={"seed_radius_m": 15}, seed=100)
    key = product_key(campaign.scenarios[0], landmark_database.KIND, options, campaign.variant)
    database = LandmarkDatabase.load(stored.path / "products" / f"{landmark_database.KIND}-{key}")
    found = numbers(stored).loc[("base", 0)]
    assert found["landmarks"] == len(database)
    assert found["facets"] == len(database.facets) == 2 * len(database) - 4
    assert found["candidates"] == database.provenance["candidates"]
    assert found["merged_clusters"] - found["landmarks"] == database.provenance["dropped_by_mesh"]
    assert found["candidates_an_image"] == pytest.approx(found["candidates"] / 40)


def test_clusters_become_fewer_at_each_stage(stored):
    found = numbers(stored)
    for fewer, more in (("merged_clusters", "kept_clusters"), ("kept_clusters", "seed_clusters")):
        assert (found[fewer] <= found[more]).all()
    assert (found.loc["strict", "landmarks"] < found.loc["base", "landmarks"]).all()
    assert (found.loc["strict", "candidates"] == found.loc["base", "candidates"]).all()


def test_trials_are_independent(stored):
    assert numbers(stored).loc["base", "candidates"].nunique() == 3


def test_the_seeds_of_the_options_and_of_the_campaign_and_the_trial_all_count():
    seeds = [at_trial(DatabaseOptions(seed=own), *of).seed for own, *of in ((0, 0, 0), (5, 0, 0), (0, 9, 0), (0, 0, 1))]
    assert len(set(seeds)) == 4


def test_a_data_base_that_does_not_come_out_is_a_failure_with_a_reason(stored):
    rows = stored.table("rows").set_index("estimator")
    assert (rows.loc["hopeless", "status"] == "failed").all()
    assert rows.loc["hopeless", "reason"].str.contains("at least 4 are").all()
    assert "hopeless" not in numbers(stored).index.get_level_values("estimator")


def test_the_report_says_how_many_and_draws_no_poses(stored):
    content = read_content(stored.path)
    titles = [grid.title for grid in report_grids(content)]
    assert "Diagnostics" in titles
    assert not any(title.startswith("Pose error") for title in titles)
    means = {r.measure: r for r in content.records if r.estimator == "base" and r.statistic == "mean"}
    assert means["landmarks"].low <= means["landmarks"].value <= means["landmarks"].high


def test_the_whole_command_ends_with_a_report(file, stored, capsys):
    assert run(file, stored.path, "--worst", 0) == 0
    assert "report.html" in capsys.readouterr().out


def test_workers_give_the_same_rows(file, stored, tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    compute(file, tmp_path / "run", 3, jobs=2)
    for table in ("rows", "diagnostics"):
        assert RunFolder(tmp_path / "run").table(table).equals(stored.table(table))


def test_another_method_is_refused(tmp_path, capsys):
    bad = write_campaign(tmp_path, DATABASES.replace("landmark-database:\n", "prior:\n"), SCENE)
    assert run(bad, tmp_path / "run") == 2
    assert "the only method is landmark-database" in capsys.readouterr().err


def test_the_terminal_shows_the_counts(stored):
    (grid,) = brief_grids(read_content(stored.path))
    landmarks = numbers(stored)["landmarks"].groupby("estimator").median()
    shown = {row[0]: float(row[2].split()[0]) for row in grid.rows if row[1] == "landmarks"}
    assert shown == pytest.approx({name: landmarks[name] for name in shown}, rel=5e-3)
    assert {"base", "strict"} <= set(shown)
