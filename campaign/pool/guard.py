"""Time limit of method calls, and a record of the current call for when its process ends.

A method that exceeds its time limit is stopped in two ways. A timer signal raises an exception in it, which ends Python
code. Compiled code that does not return to the interpreter, and may hold its lock, cannot be interrupted:
`faulthandler`, whose watchdog is not a Python thread, writes the traceback and ends the process. The parent then reads
from the note file which call it was, and continues without it (`campaign.runs.execute`).
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")

_AGAIN_S = 1.0
"""Interval of repeated alarms, in case the method catches one."""

_GRACE, _LEAST_GRACE_S = 0.25, 1.0
"""Delay from the alarm to the end of the process: a fraction of the limit, and its least value in s."""


STOPPED = "was stopped: "
"""Start, after the method's name, of the reason in a row whose method exceeded its limit or ended its process."""

ENDED = "its process ended under it, and once more when it was tried again"
"""Reason for a method that was killed, crashed or ran out of memory twice."""


class StoppedError(Exception):
    """A method exceeded its time limit, or ended its process."""


@dataclass(frozen=True, slots=True, order=True)
class Call:
    """Call of one method, by its label, in one trial of a scenario."""

    scenario: str
    trial: int
    label: str


@dataclass(frozen=True, slots=True)
class Loss:
    """Reason why a call was lost, and the traceback of where it was stopped (or '')."""

    reason: str
    trace: str


@dataclass(frozen=True, slots=True)
class Guard:
    """Limits and records for method calls.

    ``limit_s`` is the time limit of a method in a trial, None for no limit. The current call is recorded in the file
    ``note`` for the parent process, None where there is no parent to read it. ``lost`` are calls that ended their
    process before; they are not made again.
    """

    limit_s: float | None = None
    note: Path | None = None
    lost: Mapping[Call, Loss] = field(default_factory=dict)


_GUARD: ContextVar[Guard] = ContextVar("guard", default=Guard())  # noqa: B039  frozen


@contextmanager
def guarding(**changes: Any) -> Iterator[None]:
    """Change fields of the current `Guard` for the calls inside the context."""
    token = _GUARD.set(replace(_GUARD.get(), **changes))
    try:
        yield
    finally:
        _GUARD.reset(token)


@contextmanager
def unmoved() -> Iterator[None]:
    """Restore the working directory, which a method may change, at exit."""
    here = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))  # a folder that one may enter but not list will do
    try:
        yield
    finally:
        os.fchdir(here)
        os.close(here)


def guarded(call: Call, work: Callable[[], T]) -> T:
    """Call a method under the current `Guard` and return its result.

    Raise `StoppedError` if it exceeds its time limit, or ended its process before.
    """
    guard = _GUARD.get()
    if call in guard.lost:
        error = StoppedError(guard.lost[call].reason)
        if guard.lost[call].trace:
            error.add_note(guard.lost[call].trace)
        raise error
    try:
        with _noted(guard, call), _alarm(guard.limit_s):
            return work()
    except _Alarm as alarm:
        # The signal may arrive while the timer is being switched off, and leave it running.
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        raise StoppedError(over_time(guard.limit_s)).with_traceback(alarm.__traceback__) from None


def over_time(limit_s: float | None) -> str:
    """Return the reason for a method that exceeded its time limit."""
    return f"it took longer than the limit of {limit_s or 0.0:g} s for a trial"


def last_call(note: Path) -> tuple[Call, str] | None:
    """Read the current call of an ended process from its note file; None if no method was running.

    Also return the traceback that `faulthandler` wrote at the time limit, '' if the process ended otherwise.
    """
    try:
        first, _, rest = note.read_text(encoding="utf-8", errors="replace").partition("\n")
        call = Call(**json.loads(first)) if first else None
    except (FileNotFoundError, ValueError, TypeError):
        return None
    return None if call is None else (call, rest.strip() if rest.startswith("Timeout") else "")


@contextmanager
def _noted(guard: Guard, call: Call) -> Iterator[None]:
    """Record the current call in the note file, and end the process if the call hangs."""
    if guard.note is None:
        yield
        return
    with guard.note.open("w", encoding="utf-8") as note:
        note.write(json.dumps(asdict(call)) + "\n")
        note.flush()
        if guard.limit_s is not None:
            patience_s = guard.limit_s + max(_GRACE * guard.limit_s, _LEAST_GRACE_S)
            faulthandler.dump_traceback_later(patience_s, exit=True, file=note)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
            os.ftruncate(note.fileno(), 0)


class _Alarm(BaseException):
    """Raised by the timer; not an `Exception`, so that a method's ``except Exception`` does not catch it."""


@contextmanager
def _alarm(limit_s: float | None) -> Iterator[None]:
    """Raise `_Alarm` after ``limit_s`` and repeatedly until exit; only in the main thread, which receives signals."""
    if limit_s is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    on = True

    def ring(number: int, frame: FrameType | None) -> None:
        del number, frame
        if on:
            raise _Alarm

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, limit_s, _AGAIN_S)
    try:
        yield
    finally:
        on = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
