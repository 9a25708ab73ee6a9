"""A progress bar with rate, remaining time and running median."""

from __future__ import annotations

import math
import time
from collections import Counter
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from campaign.experiments.registry import Records

_BINS_PER_DECADE = 200
_SILENCE_S = 30.0


class RunningMedian:
    """A median within 0.6 % from a histogram of logarithmic bins: memory does not grow with the trials."""

    def __init__(self) -> None:
        self._bins: Counter[int] = Counter()

    def add(self, value: float) -> None:
        """Count one positive value."""
        self._bins[math.floor(_BINS_PER_DECADE * math.log10(max(value, 1e-9)))] += 1

    @property
    def value(self) -> float | None:
        """The median so far, or None."""
        half, seen = self._bins.total() / 2, 0
        for index in sorted(self._bins):
            seen += self._bins[index]
            if seen >= half:
                return float(10 ** ((index + 0.5) / _BINS_PER_DECADE))
        return None


class NamedLines:
    """Prints the steps of one of several runs that go on side by side."""

    def __init__(self, console: Console, name: str) -> None:
        self._console = console
        self._name = name

    def message(self, text: str) -> None:
        """Print a step."""
        self._console.print(f"{self._name}: {text}")

    def started(self, done: int, total: int) -> None:
        """Tell how much is stored already."""
        if done:
            self.message(f"{done} of {total} trials are stored already; continuing")

    def block(self, records: Records, trials: int) -> None:
        """Print nothing of a stored block."""


class ProgressListener:
    """Shows a run's progress: a live bar in a terminal, a line now and then elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(), TextColumn("{task.fields[median]}"), console=console,
            disable=not console.is_terminal,
        )  # fmt: skip
        self._task: TaskID | None = None
        self._medians: dict[str, RunningMedian] = {}
        self._done = self._total = self._fresh = 0
        self._began = self._last_line = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def message(self, text: str) -> None:
        """Print a step."""
        self._console.print(text)

    def started(self, done: int, total: int) -> None:
        """Show how much is stored already."""
        self._done, self._total, self._began = done, total, time.monotonic()
        if done:
            self._console.print(f"{done} of {total} trials are stored already; continuing")
        self._task = self._bar.add_task("", total=total, completed=done, rate="", median="")

    def block(self, records: Records, trials: int) -> None:
        """Count a stored block."""
        self._done += trials
        self._fresh += trials
        for row in records["rows"]:
            error = row["position_error_m"]
            if isinstance(error, float):
                self._medians.setdefault(str(row["estimator"]), RunningMedian()).add(error)
        rate = self._fresh / max(time.monotonic() - self._began, 1e-9)
        known = [f"{label} {m.value:.3g} m" for label, m in self._medians.items() if m.value is not None]
        median = "median " + "  ".join(known) if known else ""  # of craters or data bases there is none
        if self._task is not None:
            self._bar.update(self._task, completed=self._done, rate=f"{rate:.1f}/s", median=median)
        self._line(rate, median)

    def _line(self, rate: float, median: str) -> None:
        due = time.monotonic() - self._last_line > _SILENCE_S or self._done == self._total
        if self._bar.disable and due:
            self._last_line = time.monotonic()
            left = (self._total - self._done) / max(rate, 1e-9)
            told = (f"{self._done}/{self._total} trials", f"{rate:.1f}/s", f"{left:.0f} s left", median)
            self._console.print(", ".join(filter(None, told)))
