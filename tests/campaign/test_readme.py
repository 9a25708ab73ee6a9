"""The README's examples work as they are printed, and what it and the pages of the papers say holds."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from page_blocks import blocks_of
from undrawn import undrawn

from boresight.campaign.cli import main
from boresight.campaign.runs.read import campaign_names
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.trial.kind import kind_named
from boresight.scenarios.known import known_on_board, merged

README = Path(__file__).parents[2] / "README.md"


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the files of the page, with its estimator in its campaign."""
    folder = tmp_path_factory.mktemp("examples")
    blocks = blocks_of(README.read_text(encoding="utf-8"))
    for block in (block for block in blocks if block.file):
        block.write(folder)
    file = folder / "my_campaign.yaml"
    file.write_text(file.read_text().replace("lmaps]", "lmaps, my_estimator.py:Correlate]"))
    return folder


def run(folder: Path, *words: str) -> str:
    """Run a command as a user does, and return what it prints on a wide terminal."""
    done = subprocess.run(
        [sys.executable, "-m", "boresight", *words],
        cwd=folder, env={**os.environ, "COLUMNS": "200"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{words}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


def test_the_page_is_one_page():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150


def test_the_examples_of_the_page_run(
    examples: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With smaller images and small data bases, which are most of the work."""
    file = examples / "short.yaml"
    text = (examples / "my_campaign.yaml").read_text()
    text = text.replace("landmark-harris", "landmark-harris: {database: {images: 30, min_observations: 4}}")
    text = text.replace("lmaps", "lmaps: {maplets: {spacing_m: 8, side: 15}}")
    smaller = {"camera.width_px": 192, "camera.height_px": 192, "body.detail.facets": 20000}
    file.write_text(f"{text}set: {json.dumps(smaller)}\n")
    monkeypatch.chdir(examples)
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["run", file.name, "--trials", "5", "--jobs", "1", "--out", "short", "--no-report"]) == 0
    rows = pd.read_parquet(examples / "short" / "rows")
    assert set(rows["estimator"]) == {"prior", "landmark-harris", "lmaps", "Correlate"}
    assert (rows.query("estimator != 'landmark-harris'")["status"] == "ok").all()
    median = rows.groupby("estimator")["position_error_m"].median()
    assert median["lmaps"] < 0.5 * median["prior"]
    assert median["Correlate"] < 0.8 * median["prior"]
    capsys.readouterr()
    with undrawn("png", "pdf"):
        assert main(["compare", "short", "--by", "estimator"]) == 0
    assert "Correlate" in capsys.readouterr().out


@pytest.mark.long
def test_the_examples_print_what_the_page_says(examples: Path):
    printed = run(examples, "run", "my_campaign.yaml", "--out", "my_run")
    printed += run(examples, "compare", "my_run", "--by", "estimator")
    texts = [
        block.body
        for block in blocks_of(README.read_text(encoding="utf-8"))
        if "my_run" in block.body or "my_campaign" in block.body
    ]
    told = [line.split() for text in texts for line in text.splitlines() if " [" in line]
    assert len(told) > 10
    lines = [line.split() for line in printed.splitlines()]
    assert [line for line in told if line not in lines] == []


PAGES = (README, *sorted((README.parent / "docs" / "papers").glob("*.md")))
LINES = sorted(
    {
        line.removeprefix("- ")
        for page in PAGES
        for line in page.read_text(encoding="utf-8").splitlines()
        if re.match(r"(- )?`[\w-]+`.*Perfect knowledge of: ", line)
    }
)


def test_every_table_of_results_says_what_was_known_on_board():
    text = README.read_text(encoding="utf-8")
    results = text[text.index("## What comes out") : text.index("## What is in it")]
    _, *after = results.split("\n|---")
    assert after
    assert all("Perfect knowledge of: " in part for part in after)


@pytest.mark.parametrize("line", LINES)
def test_what_was_known_on_board_is_what_the_scenarios_say(line: str):
    """A line names campaigns, and after a colon those of their scenarios that the table shows, if not all."""
    head, _, _ = line.partition("Perfect knowledge of: ")
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
    """Intervals that are printed include the variation between data bases, wherever the kind of trial has several."""
    named = {name for line in LINES for name in re.findall(r"`([\w-]+)`", line.partition("Perfect knowledge of: ")[0])}
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
    assert named >= {"dask", "gtsam", "fuzz"}
    assert named <= set(extras)
