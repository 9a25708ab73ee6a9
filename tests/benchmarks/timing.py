"""Times that hold on a machine with other guests: processor time, pieces in turn, the least of several."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from boresight.campaign.runs.benchmark import yardstick_s

YARDSTICK = "yardstick: Fourier transform of 1024 x 1024"


@dataclass(frozen=True, slots=True)
class Settings:
    """How much is done.

    Parameters
    ----------
    rounds
        How often works are done in turn; the least time of each counts.
    facets
        At least so many of the body whose images are timed.
    views
        Images that are timed.
    blender
        The interpreter that has ``bpy``, where it is named.
    """

    rounds: int = 4
    facets: int = 3_100_000
    views: int = 4
    blender: Path | None = None


@dataclass(frozen=True, slots=True)
class Seconds:
    """Processor time of all threads of a process, and time on the clock."""

    cpu: float
    wall: float


Timed = Callable[[], Seconds]


def timed(work: Callable[[], object]) -> Timed:
    """Return a function that does some work in this process and tells how long it took."""

    def run() -> Seconds:
        cpu, wall = time.process_time(), time.perf_counter()
        work()
        return Seconds(time.process_time() - cpu, time.perf_counter() - wall)

    return run


yardstick = timed(yardstick_s)
"""Times a fixed piece of work, so that a time beside it says little of the machine."""


def in_turn(rounds: int, *works: Timed) -> tuple[Seconds, ...]:
    """Do works in turn, once to warm up and then for some rounds; the least time of each.

    What slows a round slows all of its works, and what slows one alone is seldom there in every round.
    """
    turns = [[work() for work in works] for _ in range(1 + rounds)][1:]
    return tuple(Seconds(min(s.cpu for s in turn), min(s.wall for s in turn)) for turn in zip(*turns, strict=True))
