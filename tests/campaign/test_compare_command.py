"""`boresight compare` on a run that was made, and what it refuses: one line, exit code 2, nothing written."""

from __future__ import annotations

import json
import shutil

import pandas as pd
import pytest
from tiny_campaign import run

from campaign.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys, *arguments):
    assert main(["compare", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("boresight: ")
    assert error.count("\n") == 1, error
    return error


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


def test_what_cannot_be_compared(tiny_run, here, capsys):
    assert "--metric speed" in refused(capsys, tiny_run.folder, "--metric", "speed")
    assert "--by weather" in refused(capsys, tiny_run.folder, "--by", "weather")
    assert "--by: empty" in refused(capsys, tiny_run.folder, "--by", ",")
    assert "nowhere: no run there" in refused(capsys, "nowhere")
    assert "a run is named twice" in refused(capsys, tiny_run.folder, tiny_run.folder)
    other = here / "other"
    assert run(tiny_run.file, other, "--trials", 4, "--seed", 6) == 0
    capsys.readouterr()
    assert "their seeds are 5 and 6: give --unpaired" in refused(capsys, tiny_run.folder, other)
    assert not (here / "comparisons").exists()
    assert main(["compare", str(tiny_run.folder), str(other), "--unpaired"]) == 0


def half_manifest(folder):
    text = (folder / "manifest.json").read_text()
    (folder / "manifest.json").write_text(text[: len(text) // 2])


def no_rows(folder):
    shutil.rmtree(folder / "rows")


def half_table(folder):
    block = next((folder / "rows").glob("*.parquet"))
    block.write_bytes(block.read_bytes()[:200])


def older(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"format": 1}))


def older_columns(folder):
    for block in (folder / "rows").glob("*.parquet"):
        pd.read_parquet(block).drop(columns="prior_position_error_m").to_parquet(block)
    shutil.rmtree(folder / "checksums")


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (half_manifest, "manifest.json: not readable"),
        (half_table, "damaged, or half of a start that was interrupted"),
        (no_rows, "no finished trial is stored"),
        (older, "stored in format 1, and this version of boresight reads 2"),
        (older_columns, "columns prior_position_error_m are missing"),
    ],
)
def test_a_run_that_is_not_whole(tiny_run, here, capsys, damage, expected):
    shutil.copytree(tiny_run.folder, here / "run")
    damage(here / "run")
    assert expected in refused(capsys, here / "run")
