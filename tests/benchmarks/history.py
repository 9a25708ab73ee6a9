"""The ratios of earlier commits, one line of JSON for each that changed some, and whether one fell since."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.ratio import Ratio, SpeedTable
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError

HISTORY = Path(__file__).with_name("history.jsonl")
REGRESSION = 0.30
_CHANGE = 0.10


@dataclass(frozen=True, slots=True)
class Kept:
    """A ratio as it was when it was last recorded."""

    ratio: float
    commit: str


@dataclass(frozen=True, slots=True)
class Regression:
    """A ratio that fell by more than is allowed."""

    key: str
    before: Kept
    now: float

    def __str__(self) -> str:
        """Say what fell, by how much and since when."""
        fell = 1.0 - self.now / self.before.ratio
        return f"{self.key}: {self.now:.3g}, {fell:.0%} below the {self.before.ratio:.3g} of {self.before.commit}"


def read_history(path: Path = HISTORY) -> Mapping[str, Kept]:
    """Return the newest record of each ratio; none where there is no file.

    Raises
    ------
    BoresightError
        If a line is not one of a history.
    """
    newest: dict[str, Kept] = {}
    for number, line in enumerate(_lines(path), start=1):
        try:
            record: dict[str, Any] = json.loads(line)
            commit = str(record["commit"])
            newest |= {str(key): Kept(float(ratio), commit) for key, ratio in record["ratios"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BoresightError(f"{path}: line {number} is no record of ratios ({error})") from error
    return newest


def regressions(table: SpeedTable, history: Mapping[str, Kept]) -> list[Regression]:
    """List the ratios of a table that fell by more than 30 % since they were last recorded.

    Times on the clock are also of other guests' making: such ratios are shown, those by processor time are checked.
    """
    return [
        Regression(ratio.key, history[ratio.key], ratio.value)
        for ratio in checked(table)
        if ratio.key in history and ratio.value < (1.0 - REGRESSION) * history[ratio.key].ratio
    ]


def unrecorded(table: SpeedTable, history: Mapping[str, Kept]) -> list[str]:
    """List the ratios that could be checked but have no record."""
    return [ratio.key for ratio in checked(table) if ratio.key not in history]


def checked(table: SpeedTable) -> list[Ratio]:
    """Return the ratios of one run by processor time."""
    return [ratio for ratio in table.ratios if ratio.same_run and ratio.clock == "cpu"]


def record(table: SpeedTable, path: Path = HISTORY) -> int:
    """Add a line with the ratios that are new or changed by more than 10 %; return how many there are."""
    history = read_history(path)
    changed = {
        ratio.key: float(f"{ratio.value:.4g}")
        for ratio in table.ratios
        if ratio.same_run and (ratio.key not in history or abs(ratio.value / history[ratio.key].ratio - 1.0) > _CHANGE)
    }
    if changed:
        line = {
            "commit": table.commit, "date": table.date, "ratios": changed,
            "machine": table.machine, "versions": table.versions,
        }  # fmt: skip
        write_text(path, "".join(f"{kept}\n" for kept in [*_lines(path), json.dumps(line, ensure_ascii=False)]))
    return len(changed)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    except (OSError, UnicodeDecodeError) as error:
        raise BoresightError(f"{path}: cannot be read ({error})") from error
