"""`boresight board`: an index page of the runs in a folder, and what it says of those that cannot be read."""

from __future__ import annotations

import pandas as pd
import pytest

from boresight.campaign.cli import main
from boresight.reports.schema.grid import number


@pytest.fixture
def runs(tiny_run, tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "tiny one").symlink_to(tiny_run.folder)
    return folder


def test_a_run_has_a_line_with_its_numbers(tiny_run, runs, capsys):
    assert main(["board", str(runs)]) == 0
    assert f"board of 1 of 1 runs: {runs / 'index.html'}" in capsys.readouterr().out
    page = (runs / "index.html").read_text(encoding="utf-8")
    rows = pd.read_parquet(tiny_run.folder / "rows").query("estimator == 'landmark-harris'")
    errors = rows.loc[rows["status"] == "ok", "position_error_m"]
    assert f"{len(errors)}/{len(rows)}" in page
    assert number(errors.median()) in page
    assert number(rows["prior_position_error_m"].median()) in page
    assert ('href="tiny%20one/report/report.html"' in page) == (tiny_run.folder / "report" / "report.html").exists()


def test_a_run_that_cannot_be_read_is_named(runs, capsys):
    (runs / "broken").mkdir()
    (runs / "broken" / "manifest.json").write_text("{}")
    assert main(["board", str(runs)]) == 3
    assert "not read: " in capsys.readouterr().out
    page = (runs / "index.html").read_text(encoding="utf-8")
    assert "broken: stored in format unknown" in page
    assert "tiny one" in page
