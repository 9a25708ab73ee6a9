"""A method that changes the working directory moves no file of the run."""

from __future__ import annotations

from pathlib import Path

import pytest
from tiny_campaign import SCENE, boresight, write_campaign

MODULE = """
import os
from boresight.estimators.contract import Estimate

class Moves:
    name, version = "moves", 1
    @classmethod
    def from_options(cls, options, assets):
        os.chdir("/")
        return cls()
    def estimate(self, observation, *, rng):
        os.chdir("/proc")
        return Estimate("ok", pose=observation.frame.prior_T_cam_body)
"""


@pytest.mark.parametrize(("jobs", "out"), [(1, "here"), pytest.param(2, "runs/here", marks=pytest.mark.long)])
def test_a_method_that_changes_the_directory_moves_no_file(tmp_path, jobs, out):
    site, here = tmp_path / "site", tmp_path / "campaign"
    info = site / "moves-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "moving.py").write_text(MODULE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: moves\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[boresight.estimators]\nmoves = moving:Moves\n")
    write_campaign(here, "scenarios: [scene]\nestimators: [moves, prior]\ntrials: 12\nseed: 5\n", SCENE)
    asked = ["--jobs", jobs, "--worst", 1, "--out", out]
    path = f"{site}:{Path(__file__).parents[2]}"
    done = boresight("run", "tiny.yaml", *asked, cwd=here, PYTHONPATH=path, BORESIGHT_CACHE="cache")
    assert done.returncode == 0, done.stderr
    named = next(line.removeprefix("report: ") for line in done.stdout.splitlines() if line.startswith("report: "))
    assert (here / named).is_file(), named
    assert {"manifest.json", "rows", "checksums", "report"} <= {path.name for path in (here / out).iterdir()}
    assert list((here / "cache" / "images").glob("*")), "nor what is written to a cache in a relative folder"
