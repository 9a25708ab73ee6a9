"""Estimators of sequences of third parties: the page of the README as it is printed, and what breaks the contract."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pandas as pd
import pytest

from boresight.campaign.cli import main
from boresight.estimators.slam.dead_reckoning import DeadReckoning
from boresight.estimators.slam.registry import sequence_estimator_class, sequence_estimator_names
from boresight.scenarios.errors import BoresightError

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
SECTION = README[README.index("## Sequences") : README.index("## Tutorial")]
BLOCKS = {
    name: body
    for _, body in re.findall(r"^```(\w+)\n(.*?)^```$", SECTION, re.MULTILINE | re.DOTALL)
    for name in re.findall(r"\A# file: (\S+)\n", body)
}


def install(folder, monkeypatch, module, lines):
    """Leave a package of one module in a folder as pip would."""
    (folder / "my_slam.py").write_text(module, encoding="utf-8")
    info = folder / "my_slam-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_slam\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join(["[boresight.sequence_estimators]", *lines]) + "\n")
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "my_slam", raising=False)


def test_the_readmes_estimator_runs_beside_ours_on_the_readmes_orbit(tmp_path, monkeypatch, capsys):
    table = re.search(r"\[project\.entry-points\.\"(.*?)\"\]\n(\w.*)", SECTION)
    assert table[1] == "boresight.sequence_estimators"
    install(tmp_path, monkeypatch, BLOCKS["my_slam.py"], [table[2].replace('"', "")])
    for name in ("my_orbit.yaml", "my_orbits.yaml"):
        (tmp_path / name).write_text(BLOCKS[name], encoding="utf-8")
    assert main(["list", "--all"]) == 0
    assert "drift" in capsys.readouterr().out
    out = tmp_path / "out"
    short = ["--set", "sequence.orbit.revolutions=0.2", "--trials", "2", "--jobs", "1", "--worst", "0"]
    assert main(["run", str(tmp_path / "my_orbits.yaml"), *short, "--out", str(out)]) == 0
    rows = pd.read_parquet(out / "rows")
    assert sorted(rows["estimator"]) == ["drift", "drift", "fixed-lag", "fixed-lag"]
    drift = rows[rows["estimator"] == "drift"]
    assert (drift["status"] == "ok").all()
    assert drift["position_error_m"].gt(10.0).all()


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
