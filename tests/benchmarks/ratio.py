"""What a comparison of speeds comes to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal, get_args

Clock = Literal["cpu", "wall"]
CLOCKS: tuple[Clock, ...] = get_args(Clock)


@dataclass(frozen=True, slots=True)
class Ratio:
    """A peer's time over ours for the same work.

    Parameters
    ----------
    work, peer
        What was done, and what it is set beside.
    clock
        ``cpu``: processor time of all threads, which another guest of the machine hardly changes; ``wall``: as it says.
    ours_s, peer_s
        Seconds for the same amount of work.
    aim
        The least ratio that is aimed at, where there is one.
    agreement
        By what it is known that both did the same work.
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
    same_run: bool = True

    @property
    def value(self) -> float:
        """How many times as long the peer takes."""
        return self.peer_s / self.ours_s

    @property
    def key(self) -> str:
        """Name of the ratio in the history."""
        return f"{self.work} | {self.peer} | {self.clock}"

    def plain(self) -> dict[str, object]:
        """Return everything in values that JSON can hold."""
        return {**asdict(self), "ratio": self.value}


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
        return {**asdict(self), "ratios": [ratio.plain() for ratio in self.ratios]}
