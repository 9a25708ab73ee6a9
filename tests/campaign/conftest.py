"""Small runs that many tests read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from posed_spheres import write_posed
from tiny_campaign import CAMPAIGN, TRIALS, compute, write_campaign
from undrawn import undrawn

from boresight.campaign.cli.main import main


@dataclass(frozen=True)
class TinyRun:
    """A finished run and the campaign file that it came from; tests only read it."""

    file: Path
    folder: Path


EMPTY = {
    **dict.fromkeys(("test_paper", "test_sensitivity_command"), ()),
    **dict.fromkeys(
        ("test_crater_pose_campaign", "test_inspect", "test_real_craters", "test_sequence_experiment"), ("pdf",)
    ),
}
"""Kinds of figures that a module leaves empty, if not all: PDF where pictures are looked at, none where both are."""


@pytest.fixture(scope="module", autouse=True)
def quick_figures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Leave the files of figures empty, which are drawn all the same."""
    with undrawn(*EMPTY.get(request.module.__name__, ("png", "pdf"))):
        yield


@pytest.fixture(scope="session")
def tiny_run(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> TinyRun:
    file = write_campaign(tmp_path_factory.mktemp("tiny"))
    folder = file.parent / "run"
    compute(file, folder)
    return TinyRun(file, folder)


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must be refused, and return the one line that it prints on standard error."""

    def line(*words: object) -> str:
        capsys.readouterr()
        assert main([str(word) for word in words]) == 2
        error = capsys.readouterr().err
        assert error.startswith("boresight: ")
        assert error.endswith("\n")
        assert error.count("\n") == 1, error
        return error

    return line


@pytest.fixture
def tiny_file(cache: Path, tmp_path: Path) -> Path:
    """A campaign file of the test's own."""
    return write_campaign(tmp_path / "campaign")


@pytest.fixture(scope="session")
def examples(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that holds the files and the runs that examples of the manual and of pages name.

    The run of the quickstart is one of the tiny campaign by that name.
    """
    folder = tmp_path_factory.mktemp("examples")
    one = CAMPAIGN.replace("scenarios: [scene]", "scenarios: [scene]\ntrials: 2").replace(f"trials: {TRIALS}\n", "")
    write_campaign(folder, one).rename(folder / "my_campaign.yaml")
    write_campaign(folder / "small").rename(folder / "small" / "quickstart.yaml")
    (folder / "before.json").write_text('{"stages": []}')
    write_posed(folder, (0.0, 6.0, 12.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in (
            "small/quickstart.yaml --trials 9 --out runs/quickstart-1a2b3c4d",
            "delpech2015-smoke --trials 2 --set sequence.orbit.step_deg=6",
            "my_campaign.yaml --out runs/a",
            "my_campaign.yaml --out runs/b --set brdf.kind=lommel-seeliger",
        ):
            assert main(["run", *words.split(), "--jobs", "1", "--no-report"]) == 0
    return folder
