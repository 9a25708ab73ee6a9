"""``boresight init`` writes files that run at once, and changes none."""

from __future__ import annotations

import re

import pandas as pd
import pytest

from boresight.campaign.cli.catalog import FILES
from boresight.campaign.cli.main import main

SMALLER = ["--set", "camera.width_px=128", "--set", "camera.height_px=128", "--set", "body.detail.facets=20000"]


@pytest.mark.parametrize("changes", [SMALLER, pytest.param([], marks=pytest.mark.long)], ids=["smaller", "as written"])
def test_the_campaign_runs(cache, tmp_path, monkeypatch, capsys, changes):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "mine"]) == 0
    said = capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "mine").iterdir()) == sorted(FILES)
    assert "boresight run mine/campaign.yaml" in said
    assert main(["validate", "mine/campaign.yaml"]) == 0
    assert (
        main(["run", "mine/campaign.yaml", "--trials", "4", "--out", "run", "--no-report", "--jobs", "1", *changes])
        == 0
    )
    rows = pd.read_parquet(tmp_path / "run" / "rows")
    assert rows.groupby("estimator").size().to_dict() == {"landmark-harris": 4, "landmark-ransac": 4, "prior": 4}
    assert (rows["status"] != "error").all()


def test_files_that_are_there_stay_as_they_are(tmp_path, refused):
    (tmp_path / "campaign.yaml").write_text("mine")
    assert "campaign.yaml: is there already" in refused("init", tmp_path)
    assert (tmp_path / "campaign.yaml").read_text() == "mine"
    assert not (tmp_path / "scenario.yaml").exists()


def test_a_folder_that_cannot_be_made_is_said_in_one_line(tmp_path, refused):
    (tmp_path / "file").write_text("")
    said = refused("init", tmp_path / "file" / "below")
    assert "could not be written" in said
    assert "--out" not in said


def test_every_section_is_explained(tmp_path):
    assert main(["init", str(tmp_path)]) == 0
    for name in FILES:
        lines = (tmp_path / name).read_text().splitlines()
        keys = [number for number, line in enumerate(lines) if re.match(r"[a-z_]+:", line)]
        ends = [*keys[1:], len(lines)]
        # The description and the title say what they are.
        sections = {lines[first]: lines[first - 1 : end] for first, end in zip(keys, ends, strict=True)}
        bare = [key for key, told in sections.items() if not any("#" in line for line in told)]
        assert [key for key in bare if not key.startswith(("description", "title"))] == []
