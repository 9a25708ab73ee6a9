"""The manual: every command has a page, its examples run, and ``--help`` imports no heavy library."""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from crater_scenes import crests, image_of, scattered
from mission_data import needs_data
from page_blocks import run_command, stop_before_long

from boresight.campaign.cli.main import make_parser, manual

PAGES, WHOLE = manual()["commands"], manual()["whole"]

EXAMPLES = [example for page in PAGES.values() for example in page["examples"]]
FIRST = [line.split("   ")[0].strip() for line in WHOLE.splitlines() if line.strip().startswith("boresight ")]


def commands():
    (found,) = (action for action in make_parser()._actions if isinstance(action, argparse._SubParsersAction))
    return found.choices


def test_every_command_has_a_page():
    assert set(PAGES) == set(commands())


NEEDS_EROS = needs_data("images/near_msi", "spice/near_msi_m0126888978", "craters")


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(one, marks=NEEDS_EROS if " craters" in one and "moon.png" not in one else ())
        for one in dict.fromkeys((*EXAMPLES, *FIRST))
    ],
)
def test_every_example_runs(examples, cache, tmp_path, monkeypatch, example):
    """Run it to its end or, where it would take long, to where all its input is read and checked."""
    program, *words = shlex.split(example)
    assert program == "boresight"
    stop_before_long(monkeypatch)
    monkeypatch.chdir(examples)
    if "moon.png" in words:
        bowls = scattered(np.random.default_rng(3), 12)
        image = image_of(bowls, np.radians(200.0), np.radians(55.0), noise=0.02)
        cv2.imwrite("moon.png", np.clip(20_000.0 * image / image.max(), 0.0, 65_535.0).astype(np.uint16))
        rims = crests(bowls)
        rows = "".join(f"{u},{v},{r}\n" for (u, v), r in zip(rims.centre_px, rims.radius_px, strict=True))
        Path("labels.csv").write_text(f"x,y,radius\n{rows}")
    if "--clear" in words:
        shutil.copytree(cache / words[-1], tmp_path / words[-1])
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path))
    assert run_command(words) == 0


@pytest.mark.parametrize("name", sorted(PAGES))
def test_a_page_tells_what_the_command_does_and_how_it_is_called(name, capsys):
    with pytest.raises(SystemExit) as left:
        make_parser().parse_args([name, "--help"])
    assert left.value.code == 0
    said = capsys.readouterr().out
    assert "examples:" in said
    assert all(example in said for example in PAGES[name]["examples"])
    assert PAGES[name]["text"].split()[0] in said


def test_the_whole_names_places_and_exit_codes(capsys):
    with pytest.raises(SystemExit):
        make_parser().parse_args(["--help"])
    said = capsys.readouterr().out
    assert "$BORESIGHT_DATA" in said
    assert "130  interrupted" in said


def loaded_by(*commands: list[str]) -> set[str]:
    """Run commands in another process; return which heavy libraries they imported."""
    heavy = ["scipy", "pandas", "numba", "pyarrow", "matplotlib", "cv2", "mitsuba", "astropy", "joblib", "pydantic"]
    code = (
        "import sys\nfrom campaign.cli import main\n"
        f"for words in {commands!r}:\n    try:\n        main(words)\n    except SystemExit:\n        pass\n"
        f"print(*sorted(set({heavy!r}) & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_help_imports_no_heavy_library():
    assert loaded_by(["--help"]) == set()


def test_a_list_imports_only_the_library_of_its_models_and_show_no_renderer():
    assert loaded_by(["list"]) == {"pydantic"}
    shown = (["show", name] for name in ("rowell2015-simulated", "knowledge-design", "itokawa-2km-lambert"))
    assert not loaded_by(*shown) & {"matplotlib", "mitsuba", "astropy"}


def test_init_imports_no_more_than_the_list(tmp_path):
    assert loaded_by(["init", str(tmp_path / "new")]) == {"pydantic"}


def test_status_imports_only_what_reads_a_run(tiny_run):
    assert loaded_by(["status", str(tiny_run.folder)]) == {"pyarrow", "pydantic"}
