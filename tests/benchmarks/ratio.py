"""Ratios of speeds, the history of earlier commits' ratios, and whether one fell since."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError

Clock = Literal["cpu", "wall"]
CLOCKS: tuple[Clock, ...] = get_args(Clock)
HISTORY = Path(__file__).with_name("history.jsonl")
REGRESSION = 0.30
_CHANGE = 0.10


@dataclass(frozen=True, slots=True)
class Ratio:
    """A peer's time over ours for the same work; of what no peer does, the yardstick's time over ours.

    The yardstick is a fixed piece of other work: its ratio compares one state of boresight with another, and says
    nothing of other programs.

    Parameters
    ----------
    work, peer
        What was done, and what it is set beside.
    clock
        ``cpu``: processor time of all threads, which another guest of the machine hardly changes; ``wall``: as it says.
    ours_s, peer_s
        Seconds for the same amount of work, or for one yardstick.
    aim
        The least ratio that is aimed at, where there is one.
    agreement
        By what it is known that both did the same work; beside the yardstick, what ours came to.
    over
        What ours took more of than it may, in words; '' where nothing.
    same_run
        Whether both were timed here; a published time of another machine is shown, never checked.
    """

    work: str
    peer: str
    clock: Clock
    ours_s: float
    peer_s: float
    aim: float | None = None
    agreement: str = ""
    over: str = ""
    same_run: bool = True

    @property
    def value(self) -> float:
        """How many times as long the peer takes."""
        return self.peer_s / self.ours_s

    @property
    def key(self) -> str:
        """Name of the ratio in the history."""
        return f"{self.work} | {self.peer} | {self.clock}"


@dataclass(frozen=True, slots=True)
class Absent:
    """A comparison that was not made, and why."""

    work: str
    why: str


@dataclass(frozen=True, slots=True)
class SpeedTable:
    """All ratios of one run, what could not be compared, and what it was run on."""

    ratios: tuple[Ratio, ...]
    absent: tuple[Absent, ...]
    commit: str
    date: str
    machine: Mapping[str, object]
    versions: Mapping[str, str]

    def plain(self) -> dict[str, object]:
        """Return everything in values that JSON can hold."""
        return {**asdict(self), "ratios": [{**asdict(ratio), "ratio": ratio.value} for ratio in self.ratios]}


@dataclass(frozen=True, slots=True)
class Kept:
    """A ratio as it was when it was last recorded."""

    ratio: float
    commit: str


def read_history(path: Path = HISTORY, processor: str | None = None) -> Mapping[str, Kept]:
    """Return the newest record of each ratio, of one processor by its name or of all; none where there is no file.

    A ratio holds for its processor: Mitsuba's own image takes 0.8 of our time with AVX-512, 1.2 without.

    Raises
    ------
    BoresightError
        If a line is not one of a history.
    """
    newest: dict[str, Kept] = {}
    for number, line in enumerate(_lines(path), start=1):
        try:
            stored: dict[str, Any] = json.loads(line)
            commit, made_on = str(stored["commit"]), str(stored["machine"]["processor"])
            if processor not in (None, made_on):
                continue
            newest |= {str(key): Kept(float(ratio), commit) for key, ratio in stored["ratios"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BoresightError(f"{path}: line {number} is no record of ratios ({error})") from error
    return newest


def checked(table: SpeedTable, history: Mapping[str, Kept]) -> tuple[list[str], list[str]]:
    """Return the ratios of a table that have no record, and what to say of works that took more than they may.

    These are the ones that took too much memory, and those whose ratio fell by more than 30 % since the record.

    Times on the clock are also of other guests' making: such ratios are shown, those by processor time are checked.
    """
    found = [ratio for ratio in table.ratios if ratio.same_run and ratio.clock == "cpu"]
    failed = [f"{ratio.work}: {ratio.over}" for ratio in table.ratios if ratio.over]
    for ratio in found:
        kept = history.get(ratio.key)
        if kept is not None and ratio.value < (1.0 - REGRESSION) * kept.ratio:
            fell = 1.0 - ratio.value / kept.ratio
            failed.append(f"{ratio.key}: {ratio.value:.3g}, {fell:.0%} below the {kept.ratio:.3g} of {kept.commit}")
    return [ratio.key for ratio in found if ratio.key not in history], failed


def record(table: SpeedTable, path: Path = HISTORY) -> int:
    """Add a line with the ratios that are new or changed by more than 10 %; return how many there are."""
    history = read_history(path, str(table.machine["processor"]))
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
