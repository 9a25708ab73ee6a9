"""How far long work is: told where it is done, which may be in a worker process, and heard where it is shown."""

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
    """So many are done of all, for example of the images of a trial."""

    what: str
    done: int
    total: int


Hear = Callable[[int | None, Step], None]
"""Called with the index of a worker, or None for this process, and how far it is; at the end all are done."""

_HEAR: ContextVar[Hear | None] = ContextVar("hear", default=None)


@contextmanager
def heard_by(hear: Hear) -> Iterator[None]:
    """Call a function with what is told inside the context, here and in workers that are waited for here."""
    token = _HEAR.set(hear)
    try:
        yield
    finally:
        _HEAR.reset(token)


def hearer() -> Hear | None:
    """Return the function that is called with what is told here; None if nobody listens."""
    return _HEAR.get()


def tell(what: str, done: int, total: int) -> None:
    """Tell how far this process is with something that takes long; without a listener nothing happens."""
    hear = _HEAR.get()
    if hear is not None:
        hear(None, Step(what, done, total))


@contextmanager
def written_to(file: Path) -> Iterator[None]:
    """Write what is told inside the context into a file, now and then; it is gone at the end."""
    written = -_WRITTEN_S

    def write(_: int | None, step: Step) -> None:
        nonlocal written
        if time.monotonic() - written >= _WRITTEN_S:
            written = time.monotonic()
            file.write_text(f"{step.done}/{step.total} {step.what}", encoding="utf-8")

    try:
        with heard_by(write):
            yield
    finally:
        file.unlink(missing_ok=True)


def read_step(file: Path) -> Step | None:
    """Read what another process has written last; None if there is nothing, or it is being written."""
    with suppress(OSError, ValueError):
        counts, what = file.read_text(encoding="utf-8").split(" ", 1)
        done, total = counts.split("/")
        return Step(what, int(done), int(total))
    return None
