"""A cache of the tests' own, and one small run that many tests read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tiny_campaign import CAMPAIGN, TRIALS, compute, write_campaign

from boresight.campaign.cli.main import main


@dataclass(frozen=True)
class TinyRun:
    """A finished run and the campaign file that it came from; tests only read it."""

    file: Path
    folder: Path


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Keep bodies and data bases away from the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("BORESIGHT_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def tiny_run(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> TinyRun:
    file = write_campaign(tmp_path_factory.mktemp("tiny"))
    folder = file.parent / "run"
    compute(file, folder)
    return TinyRun(file, folder)


@pytest.fixture
def tiny_file(cache: Path, tmp_path: Path) -> Path:
    """A campaign file of the test's own."""
    return write_campaign(tmp_path / "campaign")


@pytest.fixture(scope="session")
def examples(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that holds the files and the runs that examples of the manual and of pages name."""
    folder = tmp_path_factory.mktemp("examples")
    one = CAMPAIGN.replace("scenarios: [scene]", "scenarios: [scene]\ntrials: 2").replace(f"trials: {TRIALS}\n", "")
    write_campaign(folder, one).rename(folder / "my_campaign.yaml")
    (folder / "before.json").write_text('{"stages": []}')
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in (
            "quickstart --trials 9 --out runs/quickstart-1a2b3c4d",
            "delpech2015-smoke --trials 2",
            "my_campaign.yaml --out runs/a",
            "my_campaign.yaml --out runs/b --set brdf.kind=lommel-seeliger",
        ):
            assert main(["run", *words.split(), "--jobs", "1", "--no-report"]) == 0
    return folder
