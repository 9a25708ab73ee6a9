"""Run the blocks of a page: commands to where all their input is checked, files as they are written."""

from __future__ import annotations

import os
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from boresight.campaign.cli.main import main

LONG = (
    "boresight.campaign.runs.start.Start.go",
    "boresight.campaign.cli.compare.run_campaign",
    "boresight.campaign.cli.figures.run_missing",
    "boresight.campaign.cli.bench.benchmark",
    "benchmarks.door.speed_table",
    "boresight.campaign.cli.fetch.bring",
    "boresight.campaign.cli.report.write",
    "boresight.campaign.cli.compare.write_comparison",
    "boresight.campaign.cli.predict.predict_errors",
)
"""Where what takes long begins: all that a command names was read and checked by then."""

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A block of code; ``file`` is the name in its first line, ``# file: NAME``, or ''."""

    language: str
    body: str

    @property
    def file(self) -> str:
        found = re.match(r"# file: (\S+)\n", self.body)
        return found.group(1) if found else ""

    def write(self, folder: Path) -> None:
        (folder / self.file).write_text(self.body, encoding="utf-8")


def blocks_of(text: str) -> list[Block]:
    return [Block(*found) for found in _BLOCK.findall(text)]


def python_path(folder: Path) -> str:
    return os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))


def install_entry_points(folder: Path, pyproject: str) -> None:
    """Leave the entry points of the user's package as pip would."""
    groups = tomllib.loads(pyproject)["project"]["entry-points"]
    info = folder / "my_package-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    lines = [
        line for group, names in groups.items() for line in (f"[{group}]", *(f"{n} = {o}" for n, o in names.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


class ReachedError(Exception):
    """What takes long is about to begin."""


def stop_before_long(patch: pytest.MonkeyPatch) -> None:
    """Raise `ReachedError` in place of what takes long."""

    def reached(*arguments: object, **named: object) -> None:
        raise ReachedError

    for name in LONG:
        patch.setattr(name, reached)


def run_command(words: list[str]) -> int:
    """Run a command to its end, or to where `stop_before_long` ends it; return the exit code."""
    try:
        return main(words)
    except ReachedError:
        assert words[0] in ("run", "sensitivity", "figures", "bench", "fetch", "report", "compare", "predict")
        return 0
