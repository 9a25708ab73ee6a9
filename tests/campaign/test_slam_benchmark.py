"""The comparison with other engines: equal costs, and a missing engine is named."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest
from benchmarks import ceres
from benchmarks import sequences as slam_benchmark
from benchmarks.ratio import Absent, Ratio
from benchmarks.sequences import adjustment_ratios, make_window, our_cycles, smoother_ratios
from benchmarks.timing import Settings
from needs_ceres import skip_without_ceres

from boresight.campaign.cli.main import main
from boresight.estimators.slam.adjustment.solver import StoppingRule, minimise
from boresight.estimators.slam.smoothing.smoother import FixedLagSmoother
from boresight.scenarios.errors import BoresightError


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
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert main(["bench", "adjustment", "--blocks", "1"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "not compared: adjustment of a window: left out: gtsam: cannot be imported" in told
    assert "left out: Ceres: there is no compiler no-such-compiler; install a compiler and Ceres: apt-get" in told


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_missing_ceres_headers_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A compiler that looks for no header of the system, as one without libceres-dev finds none of Ceres."""
    compiler = tmp_path / "g++"
    compiler.write_text('#!/bin/sh\nexec g++ -nostdinc "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CXX", str(compiler))
    with pytest.raises(BoresightError, match="Ceres: its headers are not installed; install a compiler and Ceres"):
        ceres.version()


def test_costs_are_equal_and_stored(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason="gtsam is not installed")
    skip_without_ceres()
    monkeypatch.setattr(slam_benchmark, "WINDOWS", ((10, 3), (20, 4)))
    assert main(["bench", "adjustment", "--blocks", "2", "--json", str(tmp_path / "x.json")]) == 0
    stored = json.loads((tmp_path / "x.json").read_text())
    works = ("adjustment of 10 landmarks in 3 views", "adjustment of 20 landmarks in 4 views")
    peers = (slam_benchmark.GTSAM, slam_benchmark.CERES, f"{slam_benchmark.CERES}, its problem built as well")
    ratios = {(ratio["work"], ratio["peer"]): ratio["ratio"] for ratio in stored["ratios"]}
    assert set(ratios) == {(work, peer) for work in works for peer in peers}
    assert all(ratios[work, peers[1]] < ratios[work, peers[2]] for work in works)
    assert stored["versions"]["Ceres"][0].isdigit()


def test_a_cost_above_the_minimum_is_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    skip_without_ceres()
    monkeypatch.setitem(sys.modules, "gtsam", None)
    monkeypatch.setattr(slam_benchmark, "WINDOWS", ((10, 3),))
    monkeypatch.setattr(slam_benchmark, "_STEP", 1.0)  # ours ends after its first step
    found = list(adjustment_ratios(Settings(rounds=1)))
    assert any("end above the minimum" in item.why for item in found if isinstance(item, Absent))
    assert not any(isinstance(item, Ratio) for item in found)


def test_updates_of_gtsam_are_timed_apart_from_what_feeds_them(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("gtsam", reason="gtsam is not installed")
    monkeypatch.setattr(slam_benchmark, "LANDMARKS", (10,))
    monkeypatch.setattr(slam_benchmark, "CYCLE_FRAMES", 30)
    two, fed, one = smoother_ratios(Settings(rounds=1))
    assert [ratio.peer.partition(",")[0] for ratio in (two, fed, one)] == [
        "gtsam's update alone", "gtsam", "gtsam's update alone",
    ]  # fmt: skip
    assert 0.0 < one.value < two.value < fed.value
    apart = [float(ratio.agreement.split()[0]) for ratio in (two, one)]
    assert apart[0] < apart[1] < 0.2


def test_frames_are_timed_since_the_window_is_full() -> None:
    sequence = slam_benchmark._draw(10, 14, 0)[1]
    cycles = our_cycles(sequence, FixedLagSmoother.from_options({}))
    assert len(cycles) == len(sequence.frames) - 12
