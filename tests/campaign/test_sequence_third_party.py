"""Estimators of sequences of third parties: those of the page on them, and what breaks the contract."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd
import pytest
from page_blocks import blocks_of

from boresight.campaign.cli import main
from boresight.estimators.slam.dead_reckoning import DeadReckoning
from boresight.estimators.slam.registry import sequence_estimator_class, sequence_estimator_names
from boresight.scenarios.errors import BoresightError

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "estimator-of-sequences.md"
BLOCKS = {block.file: block.body for block in blocks_of(PAGE.read_text(encoding="utf-8")) if block.file}


def install(folder, monkeypatch, module, lines):
    """Leave a package of one module in a folder as pip would."""
    (folder / "my_slam.py").write_text(module, encoding="utf-8")
    info = folder / "my_slam-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_slam\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join(["[boresight.sequence_estimators]", *lines]) + "\n")
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "my_slam", raising=False)


def test_the_estimator_of_the_page_runs_next_to_ours_by_file_and_by_entry_point(tmp_path, monkeypatch, capsys):
    install(tmp_path, monkeypatch, BLOCKS["my_slam.py"], ["drift = my_slam:Drift"])
    campaign = BLOCKS["my_orbits.yaml"].replace("my_slam.py:Drift", "my_slam.py:Drift, drift")
    (tmp_path / "my_orbits.yaml").write_text(campaign, encoding="utf-8")
    assert main(["list", "--all"]) == 0
    assert "drift" in capsys.readouterr().out
    out = tmp_path / "out"
    short = ["--set", "sequence.orbit.revolutions=0.2", "--trials", "2", "--jobs", "1", "--worst", "0"]
    assert main(["run", str(tmp_path / "my_orbits.yaml"), *short, "--out", str(out)]) == 0
    rows = pd.read_parquet(out / "rows")
    assert rows.groupby("estimator").size().to_dict() == {"Drift": 2, "drift": 2, "fixed-lag": 2}
    by_file, by_name = (rows[rows["estimator"] == name] for name in ("Drift", "drift"))
    assert (by_file["status"] == "ok").all()
    assert by_file["position_error_m"].gt(10.0).all()
    assert by_file["position_error_m"].tolist() == by_name["position_error_m"].tolist()


def test_a_name_of_ours_stays_ours(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, BLOCKS["my_slam.py"], ["dead-reckoning = my_slam:Drift"])
    assert sequence_estimator_class("dead-reckoning") is DeadReckoning


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("class Drift: name, version = 'drift', 1", r"'drift' \(my_slam:Drift\) lacks from_options, follow"),
        ("import not_there", "cannot be imported from my_slam:Drift: No module named 'not_there'"),
        ("", "cannot be imported from my_slam:Drift"),
        ("1 / 0", "cannot be imported from my_slam:Drift: division by zero"),
    ],
)
def test_what_does_not_follow_the_contract_is_named(tmp_path, monkeypatch, module, said):
    install(tmp_path, monkeypatch, module, ["drift = my_slam:Drift"])
    assert "drift" in sequence_estimator_names()
    with pytest.raises(BoresightError, match=said):
        sequence_estimator_class("drift")
