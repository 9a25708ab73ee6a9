"""The README's tutorial works as it is printed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from page_blocks import blocks_of, install_entry_points, python_path

from boresight.campaign.runs.read import campaign_names
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import kind_named
from boresight.scenarios.known import known_on_board, merged

README = Path(__file__).parents[2] / "README.md"


@pytest.fixture(scope="module")
def tutorial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write every file of the tutorial and run every command, in the order of the page."""
    folder = tmp_path_factory.mktemp("tutorial")
    text = README.read_text(encoding="utf-8")
    section = text[text.index("## Tutorial") : text.index("## More")]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {
        **os.environ,
        "PATH": path,
        "BORESIGHT_CACHE": str(folder / "cache"),
        "PYTHONPATH": python_path(folder),
    }
    for block in blocks_of(section):
        if block.language == "bash":
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", block.body],
                cwd=folder, env=environment, capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode == 0, f"{block.body}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        elif block.language == "toml":
            install_entry_points(folder, block.body)
        else:
            assert block.file, f"a {block.language} block names no file:\n{block.body}"
            block.write(folder)
    return folder


@pytest.mark.parametrize(("run", "trials"), [("my_run", 20), ("real_run", 18)])
def test_both_campaigns_improve_on_the_prior(tutorial: Path, run: str, trials: int):
    rows = pd.read_parquet(tutorial / run / "rows")
    found = rows[rows["estimator"] == "landmark-harris"]
    assert len(found) == trials
    assert (found["status"] == "ok").sum() >= 0.8 * trials
    assert found["position_error_m"].median() < found["prior_position_error_m"].median()


def test_the_real_campaign_names_its_images(tutorial: Path):
    rows = pd.read_parquet(tutorial / "real_run" / "rows")
    assert sorted(set(rows["image"])) == [f"{i}.png" for i in range(6)]
    assert (tutorial / "real_run" / "report" / "report.html").stat().st_size > 10_000


def test_the_estimator_of_the_page_stands_beside_ours(tutorial: Path):
    rows = pd.read_parquet(tutorial / "my_comparison" / "rows")
    assert rows.groupby("estimator").size().to_dict() == {"prior": 20, "my-centroid": 20, "landmark-harris": 20}
    median = rows.groupby("estimator")["position_error_m"].median()
    assert (rows["status"] == "ok").all()
    assert median["my-centroid"] < 0.8 * median["prior"]


LINES = [line for line in README.read_text(encoding="utf-8").splitlines() if "Known exactly: " in line]


def test_every_table_of_results_says_what_was_known_on_board():
    text = README.read_text(encoding="utf-8")
    results = text[text.index("## What comes out") : text.index("## Campaigns")]
    _, *after = results.split("\n|---")
    assert after
    assert all("Known exactly: " in part for part in after)


@pytest.mark.parametrize("line", LINES)
def test_what_was_known_on_board_is_what_the_scenarios_say(line: str):
    """A line names campaigns, and after a colon those of their scenarios that the table shows, if not all."""
    head, _, _ = line.partition("Known exactly: ")
    names = re.findall(r"`([\w-]+)`", head)
    campaigns = [resolve(name) for name in names if name in campaign_names()]
    shown = {name for name in names if name not in campaign_names()}
    known = [
        known_on_board(one.spec, campaign.spec.experiment)
        for campaign in campaigns
        for one in campaign.scenarios
        if not shown or one.spec.name in shown
    ]
    assert head + merged(known).line(short=True) == line


def test_headline_campaigns_draw_several_data_bases():
    """Intervals that README prints include the variation between data bases, wherever the kind of trial has several."""
    named = {name for line in LINES for name in re.findall(r"`([\w-]+)`", line.partition("Known exactly: ")[0])}
    specs = [resolve(name).spec for name in sorted(named & set(campaign_names()))]
    databases = {spec.name: spec.databases for spec in specs if kind_named(spec.experiment).databases}
    names = ("cheng2003-detection", "cheng2003-orbit", "compare-mismatched", "trade-craters")
    assert databases == dict.fromkeys(names, 5)


TEXTS = ("README.md", "CHANGELOG.md", "ARCHITECTURE.md", "CONTRIBUTING.md")


@pytest.mark.parametrize("name", TEXTS)
def test_texts_name_files_and_modules_that_exist(name: str) -> None:
    text, root = (README.parent / name).read_text(encoding="utf-8"), README.parent
    files = re.findall(r"`((?:scenarios|renderers|estimators|reports|campaign|tests)/[a-z_/0-9]+\.py)`", text)
    modules = [f"{module.replace('.', '/')}.py" for module in re.findall(r"python -m (\w+(?:\.\w+)+)", text)]
    places = (root, root / "tests", root / "tests" / "helpers")
    gone = [one for one in (*files, *modules) if not any((place / one).is_file() for place in places)]
    assert gone == []


def test_hints_name_extras_as_a_checkout_installs_them() -> None:
    root = README.parent
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    places = ("scenarios", "renderers", "estimators", "reports", "campaign", "tests/benchmarks", "tests/fuzz")
    texts = [root / one for one in TEXTS] + [path for one in places for path in (root / one).rglob("*.py")]
    hints = [(path.name, hint) for path in texts for hint in re.findall(r"pip install ([^`\n]*)", path.read_text())]
    assert [where for where, hint in hints if "boresight" in hint] == []
    named = {extra for _, hint in hints for found in re.findall(r"\.\[([\w,]+)\]", hint) for extra in found.split(",")}
    assert named >= {"dask", "gtsam", "rerun", "fuzz"}
    assert named <= set(extras)
