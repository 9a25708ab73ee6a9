"""Watches a method at its work: for how long it may work, and whether its process has survived it before.

A method that takes too long is stopped in two ways. An alarm raises in it, which ends all that comes back to the
interpreter now and then. What does not, a loop in compiled code that may even hold the interpreter's lock, costs the
process: a watchdog that is no thread of Python (`faulthandler`) writes down where it hangs and ends the process, whose
parent reads what was under way and goes on without it (`campaign.runs.losses`).
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")

_AGAIN_S = 1.0
"""An alarm that is swallowed rings again."""

_GRACE, _LEAST_GRACE_S = 0.25, 1.0
"""The process is ended this much later than the alarm, as a share of the limit."""


STOPPED = "was stopped: "
"""Begins, after the method's name, the reason of a row whose method took too long or ended its process."""

ENDED = "its process ended under it, and once more when it was tried again"
"""Why a method was stopped that was killed, or crashed, or took all memory."""


class StoppedError(Exception):
    """A method took longer than it may, or ended the process that it worked in."""


@dataclass(frozen=True, slots=True, order=True)
class Call:
    """One method at work in one trial."""

    scenario: str
    trial: int
    label: str


@dataclass(frozen=True, slots=True)
class Loss:
    """Why a method was stopped, and where it was (a trace, or '')."""

    reason: str
    trace: str


@dataclass(frozen=True, slots=True)
class Guard:
    """How methods are watched.

    Parameters
    ----------
    limit_s
        How long a method may work in a trial; None for as long as it likes.
    note
        File that tells the parent of this process which call is under way; None where nobody outlives this process.
    lost
        Calls that took their process with them: they are not made again.
    """

    limit_s: float | None = None
    note: Path | None = None
    lost: Mapping[Call, Loss] = field(default_factory=dict)


_GUARD: ContextVar[Guard] = ContextVar("guard", default=Guard())  # noqa: B039  frozen


@contextmanager
def guarding(**changes: Any) -> Iterator[None]:
    """Let all calls in here be watched as before but for what is given: fields of `Guard`."""
    token = _GUARD.set(replace(_GUARD.get(), **changes))
    try:
        yield
    finally:
        _GUARD.reset(token)


def guarded(call: Call, work: Callable[[], T]) -> T:
    """Return what a method answers.

    Raises
    ------
    StoppedError
        If it takes too long, or has taken its process with it before.
    """
    guard = _GUARD.get()
    if call in guard.lost:
        raise _stopped(guard.lost[call])
    try:
        with _noted(guard, call), _alarm(guard.limit_s):
            return work()
    except _Alarm as alarm:
        # It may have rung while the alarm was being switched off.
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        raise StoppedError(over_time(guard.limit_s)).with_traceback(alarm.__traceback__) from None


def over_time(limit_s: float | None) -> str:
    """Say why a method was stopped that took too long."""
    return f"it took longer than the limit of {limit_s or 0.0:g} s for a trial"


def _stopped(loss: Loss) -> StoppedError:
    error = StoppedError(loss.reason)
    if loss.trace:
        error.add_note(loss.trace)
    return error


def last_call(note: Path) -> tuple[Call, str] | None:
    """Read from the note of a process that has ended what it was doing; None where no method was at work.

    With the call comes the trace of where it hung when its time was over, '' where the process ended otherwise.
    """
    try:
        first, _, rest = note.read_text(encoding="utf-8", errors="replace").partition("\n")
        call = Call(**json.loads(first)) if first else None
    except (FileNotFoundError, ValueError, TypeError):
        return None
    return None if call is None else (call, rest.strip() if rest.startswith("Timeout") else "")


@contextmanager
def _noted(guard: Guard, call: Call) -> Iterator[None]:
    """Write down which call is under way, and have the process ended if it hangs."""
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
    """Not an `Exception`, so that a method that catches all of those does not catch this."""


def _alarm(limit_s: float | None) -> AbstractContextManager[object]:
    """Raise after so many seconds, and again until this is left; signals reach the main thread alone."""
    if limit_s is None or threading.current_thread() is not threading.main_thread():
        return nullcontext()
    return _ringing(limit_s)


@contextmanager
def _ringing(limit_s: float) -> Iterator[None]:
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
