"""What `boresight figures` takes of a folder of runs: the sound ones, and a line for each that cannot be read."""

from __future__ import annotations

import html
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tiny_campaign import compute
from tiny_sequences import SCENE

from boresight.campaign.cli import main
from boresight.campaign.papers.page import FinishedRun
from boresight.campaign.store import RunFolder
from boresight.scenarios.errors import BoresightError

NAME = "delpech2015-ekf-trace"
CAMPAIGN = f"name: {NAME}\nexperiment: sequence\nscenarios: [orbit.yaml]\nestimators: [ekf-slam]\ntrials: 2\nseed: 5\n"


@pytest.mark.parametrize(
    ("kept", "again"),
    [
        ({}, "run `boresight run rowell2015-database` again"),
        ({"embedded": ["a in place of b"]}, "run `boresight run rowell2015-database --embedded` again"),
        ({"draft": 0.05}, "remove this draft and give the same command again"),
    ],
)
def test_a_run_of_another_version_says_how_to_make_it_again(tmp_path: Path, kept: dict[str, Any], again: str) -> None:
    run = FinishedRun(RunFolder(tmp_path), {"name": "rowell2015-database", **kept})
    with pytest.raises(BoresightError, match=rf"another version.*: to draw this, {again}$"):
        run.campaign()


@pytest.fixture(scope="module")
def sound(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    (folder / "orbit.yaml").write_text(SCENE)
    (folder / "tiny.yaml").write_text(CAMPAIGN)
    compute(folder / "tiny.yaml", folder / "run", 2)
    return folder / "run"


def copied(run: Path, folder: Path, start: int, **changes: object) -> Path:
    """Copy a run, as one of a later start; with entries of its manifest changed."""
    shutil.copytree(run, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"start": start} | changes))
    return folder


def halved(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.fixture
def runs(sound: Path, tmp_path: Path) -> Path:
    """One sound run, and later ones that are not."""
    runs = tmp_path / "runs"
    copied(sound, runs / f"{NAME}-sound", 1)
    halved(next((copied(sound, runs / f"{NAME}-rows", 2) / "rows").glob("*.parquet")))
    halved(next((copied(sound, runs / f"{NAME}-epochs", 3) / "epochs").glob("*.parquet")))
    copied(sound, runs / "older", 4, format=1)
    copied(sound, runs / "another", 6, report="nobody2015")
    for name in (f"{NAME}-manifest", "quickstart-manifest", "nameless"):
        halved(copied(sound, runs / name, 5) / "manifest.json")
    return runs


def test_sound_runs_are_drawn_and_the_others_told(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["figures", "delpech2015", "--runs", str(runs), "--out", str(tmp_path / "out")]) == 3
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("left out: ")]
    reasons = {
        f"{NAME}-rows/rows/": "damaged",
        f"{NAME}-epochs/epochs/": "damaged",
        "older: ": "stored in format 1",
        "another: report: ": "no published values are called 'nobody2015'",
        f"{NAME}-manifest/manifest.json": "not readable as a manifest",
        "nameless/manifest.json": "not readable as a manifest",
    }
    assert len(told) == len(reasons), told
    page, table = ((tmp_path / "out" / name).read_text(encoding="utf-8") for name in ("index.html", "table.md"))
    for place, why in reasons.items():
        (line,) = (line for line in told if f"{runs}/{place}" in line)
        assert why in line
        assert line in html.unescape(page)
        assert f"- {line}" in table
    assert f"{NAME}: {runs}/{NAME}-sound, 2 trials" in table
    assert (tmp_path / "out" / "figure_5.1.png").exists()


def test_a_page_without_a_sound_run_says_so(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(runs / f"{NAME}-sound")
    assert main(["figures", "delpech2015", "--runs", str(runs), "--out", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().out
    assert "delpech2015: no finished run; to run: " in said
    assert said.count("left out: ") == 6


def test_other_papers_are_not_concerned(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(runs / "nameless")
    assert main(["figures", "cheng2003", "--runs", str(runs), "--out", str(tmp_path / "out")]) == 0
    assert "left out" not in capsys.readouterr().out


def test_figures_that_render_nothing_load_no_renderer(sound: Path, tmp_path: Path) -> None:
    copied(sound, tmp_path / "runs" / NAME, 1)
    words = ["figures", "delpech2015", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    code = (
        "import sys\nfrom boresight.campaign.cli import main\nfrom boresight.reports.figures import style\n"
        f"style.render = lambda *_: b''\nprint(main({words!r}), 'mitsuba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 False"
