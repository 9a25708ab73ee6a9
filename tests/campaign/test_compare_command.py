"""`boresight compare` on runs that were made."""

from __future__ import annotations

import pandas as pd
import pytest
from page_blocks import run_command, stop_before_long
from tiny_campaign import run

from boresight.campaign.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_run_is_compared(tiny_run, here, capsys):
    assert main(["compare", str(tiny_run.folder)]) == 0
    said = capsys.readouterr().out
    assert "landmark-harris" in said
    folder = here / "comparisons" / tiny_run.folder.name
    subjects = pd.read_csv(folder / "subjects.csv")
    rows = pd.read_parquet(tiny_run.folder / "rows")
    errors = rows.loc[(rows["estimator"] == "landmark-harris") & (rows["status"] == "ok"), "position_error_m"]
    line = subjects.query("estimator == 'landmark-harris' and trials == 'solved' and statistic == 'median'")
    assert line["value"].item() == pytest.approx(errors.median())
    assert line["n_ok"].item() == len(errors)
    assert main(["compare", str(tiny_run.folder), "--by", "brdf"]) == 0
    assert "\nLeft out: the prior, which is no estimator" in capsys.readouterr().out


def test_runs_of_other_seeds_are_compared_unpaired_alone(tiny_run, here, refused, monkeypatch):
    other = here / "other"
    assert run(tiny_run.file, other, "--trials", 4, "--seed", 6) == 0
    assert "their seeds are 5 and 6: give --unpaired" in refused("compare", tiny_run.folder, other)
    assert not (here / "comparisons").exists()
    stop_before_long(monkeypatch)
    assert run_command(["compare", str(tiny_run.folder), str(other), "--unpaired"]) == 0
