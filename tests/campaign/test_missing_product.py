"""A method whose product cannot be made: its trials are errors that say why, and no other method is any the wiser."""

from __future__ import annotations

import pandas as pd
import pytest
from tiny_campaign import CAMPAIGN, RESULTS, assert_same_results, compute, files, run, write_campaign

from boresight.campaign.cli import main
from boresight.campaign.store import RunFolder
from boresight.reports.pages.build import markdown
from boresight.reports.pages.content import read_content

HOPELESS = """\
  - landmark-harris:
      label: hopeless
      database: {images: 40, min_observations: 40, clusters: {seed_radius_m: 1}}
trials:"""
WITH_HOPELESS = CAMPAIGN.replace("trials:", HOPELESS)
TRIALS = 12
REASON = "the landmark database of scene cannot be made: 0 landmarks came out of "


@pytest.fixture(scope="module")
def stored(cache, tmp_path_factory):
    """A run with such a method; what was said of it."""
    folder = tmp_path_factory.mktemp("missing")
    file = write_campaign(folder, WITH_HOPELESS)
    return file, RunFolder(folder / "run"), compute(file, folder / "run", TRIALS)


def test_all_its_trials_are_errors_with_the_reason(stored):
    _, folder, said = stored
    rows = folder.table("rows").query("estimator == 'hopeless'")
    assert list(rows["trial"]) == list(range(TRIALS))
    assert (rows["status"] == "error").all()
    (reason,) = set(rows["reason"])
    assert reason.startswith(f"the estimator cannot work: {REASON}")
    (note,) = folder.read_manifest()["notes"]
    assert note in said.splitlines()
    assert note.startswith(f"all trials of hopeless in scene are errors: {REASON}")
    for option in ("images (40)", "clusters.seed_radius_m (1)", "min_observations (40)"):
        assert option in note


def test_the_rows_of_others_are_those_of_a_run_without_it(stored, tmp_path):
    _, folder, _ = stored
    compute(write_campaign(tmp_path), tmp_path / "run", TRIALS)
    for table in RESULTS:
        alone, beside = RunFolder(tmp_path / "run").table(table), folder.table(table)
        if alone.empty:
            continue
        others = beside[beside["estimator"] != "hopeless"].reset_index(drop=True)
        pd.testing.assert_frame_equal(others, alone, check_exact=True)


def test_it_is_the_same_in_another_order_with_workers_and_a_cache_of_its_own(stored, tmp_path, monkeypatch):
    file, folder, _ = stored
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))
    compute(file, tmp_path / "run", 4, jobs=2)
    compute(file, tmp_path / "run", TRIALS, jobs=2)
    assert_same_results(folder.path, tmp_path / "run")
    assert files(folder.path, "tracebacks") == files(tmp_path / "run", "tracebacks")


def test_it_can_be_reported_and_inspected(stored, tmp_path, capsys):
    file, folder, _ = stored
    assert run(file, folder.path, "--trials", TRIALS) == 3
    assert f"all trials of hopeless in scene are errors: {REASON}" in markdown(read_content(folder.path), ())
    assert main(["inspect", str(folder.path), "--estimator", "hopeless", "--out", str(tmp_path / "case")]) == 0
    assert REASON in capsys.readouterr().out
