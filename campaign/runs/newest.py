"""Which of several runs is the newest: a count of starts, which no clock that is set back can turn round."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from scenarios.reading import plain_json

KEY = "start"


def next_start(folder: Path) -> int:
    """Return the number of the start of a run: one more than any of the runs beside it has."""
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
