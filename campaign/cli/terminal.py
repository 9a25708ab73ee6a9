"""What the command line prints: plain text, the progress of runs, and why a file cannot be written."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from boresight.campaign.pool.steps import Step, progress_to
from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError, printable

if TYPE_CHECKING:
    from boresight.campaign.trial.kind import Records

_WIDTH = 160
_SILENCE_S = 30.0
_MOST_MEDIANS = 6


class _Plain(Console):
    """Ignores markup and control characters in printed text."""

    def print(self, *objects: Any, **how: Any) -> None:
        shown = ("\n".join(map(printable, one.split("\n"))) if isinstance(one, str) else one for one in objects)
        super().print(*shown, **how)


def console() -> Console:
    """Return a console on standard output that wraps no text when it is not a terminal; tables are so wide then."""
    plain = _Plain(markup=False, emoji=False)
    if plain.is_terminal:
        return plain
    return _Plain(width=_WIDTH, soft_wrap=True, highlight=False, markup=False, emoji=False)


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """Explain in one line why ``place``, or a file that the error names, could not be written."""
    try:
        yield
    except OSError as error:
        raise BoresightError(explain_write_error(error.filename or place, error)) from error


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


@dataclass(frozen=True, slots=True)
class _Shown:
    """A bar of a step: what it counts, and how many were done when it was first heard of."""

    task: TaskID
    what: str
    first: int
    since: float


class ProgressListener:
    """Shows a run's progress: a live bar in a terminal, a line now and then elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(), TextColumn("{task.fields[median]}"), console=console,
            disable=not console.is_terminal,
        )  # fmt: skip
        self._task: TaskID | None = None
        self._steps: dict[int | None, _Shown] = {}
        self._open = ExitStack()
        self._errors: dict[tuple[str, str], list[float]] = {}
        self._done = self._total = self._fresh = 0
        self._resumed = False
        self._began = self._last_line = time.monotonic()

    def __enter__(self) -> Self:
        self._open.enter_context(self._bar)
        self._open.enter_context(progress_to(self._step))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def message(self, text: str) -> None:
        """Print a step."""
        self._console.print(text)

    def started(self, done: int, total: int) -> None:
        """Show how much is stored already."""
        self._done, self._total, self._began = done, total, time.monotonic()
        self._resumed = done > 0
        if done:
            self._console.print(f"{done} of {total} trials are stored already; continuing")
        self._task = self._bar.add_task("trials", total=total, completed=done, rate="", median="")

    def block(self, records: Records, trials: int) -> None:
        """Count a stored block."""
        for worker in list(self._steps):  # those that go on are heard of again in a second
            self._forget(worker)
        self._done += trials
        self._fresh += trials
        for row in records["rows"]:
            error = row.get("position_error_m")
            if isinstance(error, float):
                self._errors.setdefault((str(row["scenario"]), str(row["estimator"])), []).append(error)
        rate = self._fresh / max(time.monotonic() - self._began, 1e-9)
        median = self._median(str(records["rows"][-1]["scenario"])) if records["rows"] else ""
        if self._task is not None:
            self._bar.update(self._task, completed=self._done, rate=f"{rate:.1f}/s", median=median)
        self._line(self._done, self._total, "trials", rate, median)

    def _step(self, worker: int | None, step: Step) -> None:
        """Show how far a worker is with its call, or this process with the images of a data base."""
        if worker in self._steps and self._steps[worker].what != step.what:
            self._forget(worker)
        if worker not in self._steps:
            task = self._bar.add_task(step.what, total=step.total, rate="", median="")
            self._steps[worker] = _Shown(task, step.what, step.done, time.monotonic())
        shown = self._steps[worker]
        self._bar.update(shown.task, completed=step.done)
        if step.done == step.total:
            self._forget(worker)
        elif step.done > shown.first:
            rate = (step.done - shown.first) / max(time.monotonic() - shown.since, 1e-9)
            so_far = f"{self._done}/{self._total} trials; " if self._total else ""
            self._line(step.done, step.total, step.what, rate, so_far=so_far)

    def _forget(self, worker: int | None) -> None:
        self._bar.remove_task(self._steps.pop(worker).task)

    def _median(self, scenario: str) -> str:
        """Tell the median errors of a scenario as its table has them, over the trials that this start has run.

        Of craters or data bases there is none.
        """
        known = [
            f"{label} {statistics.median(errors):.3g} m"
            for (where, label), errors in self._errors.items()
            if where == scenario
        ]
        of = f" of {scenario}" if len({where for where, _ in self._errors}) > 1 else ""
        new = " of new trials" if self._resumed else ""
        more = f"  and {len(known) - _MOST_MEDIANS} more" if len(known) > _MOST_MEDIANS else ""
        return f"median{of}{new} {'  '.join(known[:_MOST_MEDIANS])}{more}" if known else ""

    def _line(self, done: int, total: int, what: str, rate: float, median: str = "", so_far: str = "") -> None:
        """Print a line where there is no bar, now and then and at the end."""
        due = time.monotonic() - self._last_line > _SILENCE_S or done == total
        if self._bar.disable and due:
            self._last_line = time.monotonic()
            left = (total - done) / max(rate, 1e-9)
            told = (f"{so_far}{done}/{total} {what}", f"{rate:.1f}/s", f"{left:.0f} s left", median)
            self._console.print(", ".join(filter(None, told)))
