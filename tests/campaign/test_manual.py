"""The manual: every command has a page, its examples run, and ``--help`` imports no heavy library."""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys

import pytest
from mission_data import needs_data
from tiny_campaign import CAMPAIGN, TRIALS, write_campaign

from boresight.campaign.cli.main import main, make_parser, manual

PAGES, WHOLE = manual().commands, manual().whole

EXAMPLES = [example for page in PAGES.values() for example in page.examples]
FIRST = [line.split("   ")[0].strip() for line in WHOLE.splitlines() if line.strip().startswith("boresight ")]


def commands():
    (found,) = (action for action in make_parser()._actions if isinstance(action, argparse._SubParsersAction))
    return found.choices


def test_every_command_has_a_page():
    assert set(PAGES) == set(commands())


class ReachedError(Exception):
    """An example that takes long is about to begin: all that it names was read and checked."""


LONG = (
    "boresight.campaign.runs.start.Start.go",
    "boresight.campaign.cli.sensitivity.run_campaign",
    "boresight.campaign.cli.figures.run_missing",
    "boresight.campaign.cli.bench.benchmark",
    "benchmarks.door.speed_table",
    "boresight.campaign.cli.fetch.bring",
)


NEEDS_EROS = needs_data("images/near_msi", "spice/near_msi_m0126888978", "craters")


@pytest.fixture(scope="module")
def place(cache, tmp_path_factory):
    """Return a folder that holds the files and the runs that the examples name."""
    folder = tmp_path_factory.mktemp("manual")
    one = CAMPAIGN.replace("scenarios: [scene]", "scenarios: [scene]\ntrials: 2").replace(f"trials: {TRIALS}\n", "")
    write_campaign(folder, one).rename(folder / "my_campaign.yaml")
    (folder / "before.json").write_text('{"stages": []}')
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in (
            "quickstart --trials 8 --out runs/quickstart-1a2b3c4d",
            "delpech2015-smoke --trials 2",
            "my_campaign.yaml --out runs/a",
            "my_campaign.yaml --out runs/b --set brdf.kind=lommel-seeliger",
        ):
            assert main(["run", *words.split(), "--jobs", "1", "--no-report"]) == 0
    return folder


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(
            one,
            marks=needs_data("images/near_msi", "spice/near_msi_m0126888978", "craters") if " craters" in one else (),
        )
        for one in dict.fromkeys((*EXAMPLES, *FIRST))
    ],
)
def test_every_example_runs(place, cache, tmp_path, monkeypatch, example):
    """Run it to its end or, where it would take long, to where all its input is read and checked."""

    def reached(*arguments, **named):
        raise ReachedError

    program, *words = shlex.split(example)
    assert program == "boresight"
    for name in LONG:
        monkeypatch.setattr(name, reached)
    monkeypatch.chdir(place)
    if "--clear" in words:
        shutil.copytree(cache / words[-1], tmp_path / words[-1])
        monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path))
    try:
        assert main(words) == 0
    except ReachedError:
        assert words[0] in ("run", "sensitivity", "figures", "bench", "fetch")


@pytest.mark.parametrize("name", sorted(PAGES))
def test_a_page_tells_what_the_command_does_and_how_it_is_called(name, capsys):
    with pytest.raises(SystemExit) as left:
        make_parser().parse_args([name, "--help"])
    assert left.value.code == 0
    said = capsys.readouterr().out
    assert "examples:" in said
    assert all(example in said for example in PAGES[name].examples)
    assert PAGES[name].text.split()[0] in said


def test_the_whole_names_places_and_exit_codes(capsys):
    with pytest.raises(SystemExit):
        make_parser().parse_args(["--help"])
    said = capsys.readouterr().out
    assert "$BORESIGHT_DATA" in said
    assert "130  interrupted" in said


def loaded_by(words: list[str]) -> set[str]:
    """Run a command in another process; return which heavy libraries it imported."""
    heavy = ["scipy", "pandas", "numba", "pyarrow", "matplotlib", "cv2", "mitsuba", "astropy", "joblib", "pydantic"]
    code = (
        "import sys\nfrom campaign.cli import main\n"
        f"try:\n    main({words!r})\nexcept SystemExit:\n    pass\n"
        f"print(*sorted(set({heavy!r}) & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_help_imports_no_heavy_library():
    assert loaded_by(["--help"]) == set()


@pytest.mark.parametrize(
    "words",
    [["list"], ["show", "rowell2015-simulated"], ["show", "knowledge-design"], ["show", "itokawa-2km-lambert"]],
)
def test_reading_files_imports_only_the_library_of_their_models(words):
    assert loaded_by(words) == {"pydantic"}


def test_status_imports_only_what_reads_a_run(tiny_run):
    assert loaded_by(["status", str(tiny_run.folder)]) == {"pyarrow", "pydantic"}
