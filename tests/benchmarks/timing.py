"""Times that hold on a machine with other guests: processor time, pieces in turn, the least of several."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Seconds:
    """Processor time of all threads of a process, and time on the clock."""

    cpu: float
    wall: float

    def least(self, other: Seconds) -> Seconds:
        """Return the lesser of each."""
        return Seconds(min(self.cpu, other.cpu), min(self.wall, other.wall))


Timed = Callable[[], Seconds]


def timed(work: Callable[[], object]) -> Timed:
    """Return a function that does some work in this process and tells how long it took."""

    def run() -> Seconds:
        cpu, wall = time.process_time(), time.perf_counter()
        work()
        return Seconds(time.process_time() - cpu, time.perf_counter() - wall)

    return run


def in_turn(rounds: int, *works: Timed) -> tuple[Seconds, ...]:
    """Do works in turn, once to warm up and then for some rounds; the least time of each.

    What slows a round slows all of its works, and what slows one alone is seldom there in every round.
    """
    for work in works:
        work()
    least = [work() for work in works]
    for _ in range(rounds - 1):
        least = [best.least(work()) for best, work in zip(least, works, strict=True)]
    return tuple(least)
