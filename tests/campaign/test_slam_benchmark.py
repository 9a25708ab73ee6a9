"""The comparison with other engines: equal costs, and a missing engine is named."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from benchmarks import windows as slam_benchmark
from benchmarks.windows import make_window

from campaign.cli.main import main
from estimators.slam.solver import StoppingRule, minimise


def test_window_starts_away_from_its_minimum_and_has_one() -> None:
    problem, start = make_window(10, 4, 1)
    found = minimise(problem, start, StoppingRule(1e-6))
    assert found.converged
    assert found.cost < 1e-2 * minimise(problem, start, StoppingRule(1e-6, 0)).cost
    freedom = 2 * len(problem.pixels.view) + 1 - 3 * (3 + len(start.points_m))
    assert 0.2 * freedom < 2.0 * found.cost < 3.0 * freedom


def test_missing_engines_are_named_and_no_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "gtsam", None)
    monkeypatch.setitem(sys.modules, "pyceres", None)
    assert main(["bench", "adjustment", "--blocks", "1"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "not compared: adjustment of a window: left out: gtsam: cannot be imported" in told
    assert "not compared: adjustment of a window: left out: pyceres: cannot be imported" in told
    assert "pip install 'boresight[peers]'" in told


def test_costs_are_equal_and_stored(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("gtsam", "pyceres", "pycolmap"):
        pytest.importorskip(name, reason=f"{name} is not installed")
    monkeypatch.setattr(slam_benchmark, "WINDOWS", ((10, 3), (20, 4)))
    monkeypatch.setattr(slam_benchmark, "LANDMARKS", (10,))
    windows = list(slam_benchmark.window_ratios(2, print))
    assert {(row.peer, row.landmarks) for row in windows} == {(p, n) for p in ("gtsam", "pyceres") for n in (10, 20)}
    assert all(row.cost_gap < 1e-6 and row.solve_alone < row.whole for row in windows)
    assert next(slam_benchmark.cycle_ratios(45, print)).apart_sigma < 0.2
    assert main(["bench", "adjustment", "--blocks", "2", "--json", str(tmp_path / "x.json")]) == 0
    stored = json.loads((tmp_path / "x.json").read_text())
    works = ("adjustment of 10 landmarks in 3 views", "adjustment of 20 landmarks in 4 views")
    found = {(ratio["peer"], ratio["work"]) for ratio in stored["ratios"]}
    assert found >= {(peer, work) for peer in ("gtsam", "pyceres") for work in works}
