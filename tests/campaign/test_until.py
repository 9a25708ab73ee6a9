"""`boresight run --until`: where it stops, what it refuses, and what stopping by width does to coverage."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import Heard, run

from campaign import until as module
from campaign.request import RunRequest
from campaign.resolve import resolve
from campaign.until import looks, parse_until, run_until
from renderers.mitsuba3 import choose_variant
from reports.statistics import MEDIAN, large_sample_interval
from scenarios.errors import BoresightError


def test_looks_are_whole_blocks_and_end_at_the_cap():
    assert looks(100, 10) == [30, 40, 50, 60, 80, 100]
    assert looks(24, 10) == [24]
    points = looks(5000, 5)
    assert points == sorted(set(points))
    assert all(point % 5 == 0 for point in points)
    assert looks(400, 5)[:8] == points[:8], "the cap does not move the looks before it"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("position_error_m < 3", "write it as"),
        ("ci(position_error_m, median) < 3; import os", "write it as"),
        ("ci(position_error_m, median) < -3", "write it as"),
        ("ci(position_error_m, median) < 0", "never reached"),
        ("ci(velocity, median) < 3", "velocity is no metric of this campaign: choose one of position_error_m"),
        ("ci(error_after_1_m, median) < 3", "error_after_1_m is no metric"),
        ("ci(position_error_m, mode) < 3", "mode is no statistic: choose one of median"),
    ],
)
def test_a_wrong_condition_is_one_line_before_anything_runs(tiny_file, tmp_path, capsys, text, why):
    with pytest.raises(BoresightError, match=why):
        parse_until(text, "single-image")
    assert run(tiny_file, tmp_path / "run", "--until", text) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_condition_is_read():
    found = parse_until(" CI( error_after_2_m ,p95)<5 %", "sequence")
    assert (found.metric.name, found.statistic.name) == ("error_after_2_m", "95th percentile")
    assert found.relative
    assert found.width == 0.05
    assert parse_until("ci(position_error_m,rms) < 1.5e-2", "single-image").width == 0.015


@pytest.mark.parametrize(("width", "trials", "word"), [("1e4", 10, "stopped"), ("1e-9", 24, "reached the most")])
def test_it_stops_at_the_first_look_whatever_is_stored(tiny_run, tmp_path, monkeypatch, width, trials, word):
    monkeypatch.setattr(module, "_FIRST_LOOK", 10)
    folder = tmp_path / "run"
    shutil.copytree(tiny_run.folder, folder)
    for block in sorted((folder / "rows").glob("*.parquet"))[1:] if trials == 10 else ():
        block.unlink()
    campaign = resolve(str(tiny_run.file), variant=choose_variant().name)
    condition = parse_until(f"ci(position_error_m, median) < {width}", "single-image")
    run_until(campaign, RunRequest(folder, 24, 1), condition, Heard())
    rows, whole = (pd.read_parquet(one / "rows") for one in (folder, tiny_run.folder))
    pd.testing.assert_frame_equal(rows, whole[whole["trial"] < trials])
    (note,) = json.loads((folder / "manifest.json").read_text())["notes"]
    assert word in note


def test_intervals_of_runs_that_stop_by_width_hold_nearly_what_they_say():
    """2,000 runs on a skewed error of known median: at the look where they stop, 9 of 10 intervals still hold it."""
    rng, true, points = np.random.default_rng(12), np.exp(2.0), looks(1000, 10)
    held, stops = [], []
    for values in rng.lognormal(2.0, 0.8, (2000, points[-1])):
        for n in points:
            low, high = large_sample_interval(values[:n], MEDIAN)
            if high - low < 1.8:
                break
        held.append(low < true < high)
        stops.append(n)
    assert 0.90 < np.mean(held) < 0.97
    assert len(set(stops)) > 4, "they stop at many looks"
    assert np.mean([n < points[-1] for n in stops]) > 0.99
