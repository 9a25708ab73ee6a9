"""The times of a campaign's stages: all there, on one core, adding up, comparable with those of before."""

import json
import os
from contextlib import chdir, redirect_stdout
from io import StringIO

import numpy as np
import pandas as pd
import pytest
from tiny_campaign import write_campaign

from boresight.campaign.cli import main
from boresight.campaign.runs.benchmark import WHOLE_TRIAL, _whole
from boresight.scenarios.cache import default_cache


@pytest.fixture(scope="module")
def times(cache, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    before = kept_images()
    file = write_campaign(folder)
    with chdir(folder), redirect_stdout(StringIO()) as said:
        assert main(["bench", str(file), "--blocks", "2", "--json", str(folder / "times.json")]) == 0
    assert kept_images() == before, "other trials' images are not to make room for a benchmark's"
    return file, folder / "times.json", said.getvalue()


def kept_images():
    return {entry.path for entry in default_cache().entries() if entry.kind == "images"}


def test_every_stage_is_timed(times):
    _, stored, said = times
    found = json.loads(stored.read_text())
    stages = {(s["estimator"], s["stage"]): s for s in found["stages"]}
    assert {stage for _, stage in stages} == {
        "image", "mesh_rendering", "centroid", "feature_extraction", "recognition", "consistency", WHOLE_TRIAL,
    }  # fmt: skip
    for stage in stages.values():
        assert 0.0 < stage["low_s"] <= stage["median_s"] <= stage["high_s"]
        assert stage["ratio"] == pytest.approx(stage["median_s"] / found["yardstick_s"])
    parts = sum(s["median_s"] for key, s in stages.items() if key[1] != WHOLE_TRIAL)
    assert parts < 1.5 * stages["", WHOLE_TRIAL]["median_s"]
    assert "24 trials take" in said
    assert found["trials"] == 30


def test_the_first_block_of_each_scenario_is_not_counted():
    """It compiles and opens what the others find ready."""
    seconds = {"one": [100.0, 1.0, 3.0, 2.0], "other": [50.0, 8.0]}
    blocks = pd.DataFrame([{"scenario": name, "seconds": s} for name, some in seconds.items() for s in some])
    assert {time.scenario: time.median_s for time in _whole(blocks, 1.0)} == {"one": 2.0, "other": 8.0}


def test_nothing_is_left_behind(times):
    _, stored, _ = times
    assert sorted(path.name for path in stored.parent.iterdir()) == ["scene.yaml", "times.json", "tiny.yaml"]


def test_ratios_are_set_beside_those_of_before(times, tmp_path, capsys):
    file, stored, _ = times
    before = json.loads(stored.read_text())
    for stage in before["stages"]:
        stage["ratio"] *= 1e-3
    (tmp_path / "before.json").write_text(json.dumps(before))
    cores = os.sched_getaffinity(0)
    assert main(["bench", str(file), "--blocks", "1", "--against", str(tmp_path / "before.json")]) == 0
    changes = [
        float(line.split(" x ")[1]) for line in capsys.readouterr().out.splitlines() if line.startswith("scene ")
    ]
    assert len(changes) == 7
    assert 100 < np.median(changes) < 10_000
    assert os.sched_getaffinity(0) == cores
