"""Find stored runs, the newest first: by a count of starts, which does not depend on the clock."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from boresight.campaign.runs.request import RUNS
from boresight.campaign.store import RunFolder
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import plain_json

KEY = "start"


def next_start(folder: Path) -> int:
    """Return the number of the start of a run: one more than that of any other run in the folder."""
    return 1 + max((start_of(path.parent) for path in folder.absolute().parent.glob("*/manifest.json")), default=0)


def start_of(folder: Path) -> int:
    """Return the number of a run's last start; 0 where its manifest has none, as in earlier versions."""
    try:
        manifest = plain_json(folder / "manifest.json")
        return int(manifest.get(KEY, 0))
    except (OSError, ValueError, TypeError, AttributeError, OverflowError):
        return 0


def newest_first(folders: Iterable[Path]) -> list[Path]:
    """Sort run folders by their last start; those of earlier versions come after, by when they changed last."""
    return sorted(folders, key=lambda path: (start_of(path), path.stat().st_mtime), reverse=True)


def run_words(manifest: Mapping[str, Any]) -> list[str]:
    """Return the words of the command that started a run, ``boresight run ...``; none if it was started otherwise."""
    try:
        words = shlex.split(manifest.get("command") or "")
    except ValueError:  # a quotation that has no end
        return []
    return words if words[:2] == ["boresight", "run"] else []


def find_run(name: str) -> RunFolder:
    """Find a run by its folder, or by a campaign's name under ``runs/`` (the newest of several).

    Raise BoresightError if there is none, or it has no manifest that this version of boresight reads.
    """
    prefix = f"{name}-"
    named = [path for path in RUNS.iterdir() if path.name.startswith(prefix)] if RUNS.is_dir() else []
    candidates = [Path(name), *newest_first(named)]
    for candidate in candidates:
        if (candidate / "manifest.json").exists():
            folder = RunFolder(candidate)
            folder.read_manifest()
            return folder
    raise BoresightError(f"{name}: no run there, nor in {RUNS}/ as {prefix}...: give a run folder, or run it first")
