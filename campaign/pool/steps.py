"""Progress of long computations, passed from worker processes to the listener that shows it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

_WRITTEN_S = 0.5
"""Interval at which a worker writes how far it is."""


@dataclass(frozen=True, slots=True)
class Step:
    """Number of items done and of all, for example the images of a trial."""

    what: str
    done: int
    total: int


Listener = Callable[[int | None, Step], None]
"""Called with the index of a worker, or None for this process, and how far it is; at the end all are done."""

_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def progress_to(listener: Listener) -> Iterator[None]:
    """Call a function with the progress of this process and its workers inside the context."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def progress_listener() -> Listener | None:
    """Return the current listener; None if there is none."""
    return _LISTENER.get()


def report_progress(what: str, done: int, total: int) -> None:
    """Report the progress of this process to the listener, if there is one."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(None, Step(what, done, total))


@contextmanager
def written_to(file: Path) -> Iterator[None]:
    """Write the progress inside the context to a file at intervals, and remove the file at the end."""
    written = -_WRITTEN_S

    def write(_: int | None, step: Step) -> None:
        nonlocal written
        if time.monotonic() - written >= _WRITTEN_S:
            written = time.monotonic()
            with suppress(OSError):  # a full disk ends no trial for want of a progress bar
                file.write_text(f"{step.done}/{step.total} {step.what}", encoding="utf-8")

    try:
        with progress_to(write):
            yield
    finally:
        with suppress(OSError):
            file.unlink(missing_ok=True)


def read_step(file: Path) -> Step | None:
    """Read what another process has written last; None if there is nothing, or it is being written."""
    with suppress(OSError, ValueError):
        counts, what = file.read_text(encoding="utf-8").split(" ", 1)
        done, total = counts.split("/")
        return Step(what, int(done), int(total))
    return None
