"""Captures what a method prints and warns of while it works: stored with its trial, and not shown on the terminal.

What goes through Python's streams and handlers of logs is captured where the method's own threads write it. What goes
to the descriptors 1 and 2 themselves (of compiled code, of processes that the method starts, of streams kept from
before) is captured where the method works in the main thread, which is everywhere but in a worker of Dask whose trials
have no limit of time: there it goes where it went before. It follows what came through Python, and is the method's
whichever thread wrote it. What a process writes while it crashes is lost with it.
"""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import IO, Any

from campaign.pool.redirected import Aside, Led, descriptors_led_away, logs_led_away

MOST_CHARACTERS = 4000
"""Kept of each stream in a trial; the rest is counted."""

_MOST_BYTES = 4 * MOST_CHARACTERS
"""No character of UTF-8 has more than four."""


class Captured:
    """Collects what one method says in one trial."""

    def __init__(self) -> None:
        self._streams = {"stdout": _Bounded(), "stderr": _Bounded(), "warnings": _Bounded()}

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Capture what is written in here; filters of warnings stay as they are, but each place may warn again."""
        out, err = sys.stdout, sys.stderr
        asides = {1: Aside(), 2: Aside()}
        to_out = _Redirected(out, self._streams["stdout"], asides.get(_descriptor(out)))
        to_err = _Redirected(err, self._streams["stderr"], asides.get(_descriptor(err)))

        def away(stream: object) -> _Redirected | None:
            own = _own(stream) or stream
            return to_out if own in (out, sys.__stdout__) else to_err if own in (err, sys.__stderr__) else None

        with ExitStack() as stack:
            caught = stack.enter_context(warnings.catch_warnings(record=True))
            stack.enter_context(redirect_stdout(to_out))
            stack.enter_context(redirect_stderr(to_err))
            stack.enter_context(logs_led_away(away, _own))
            led = (
                Led(1, out, asides[1], self._streams["stdout"].add, _MOST_BYTES),
                Led(2, err, asides[2], self._streams["stderr"].add, _MOST_BYTES),
            )
            stack.enter_context(descriptors_led_away(led))
            try:
                yield
            finally:
                for one in caught or ():
                    where = f"{one.filename}:{one.lineno}"
                    self._streams["warnings"].add(f"{where}: {one.category.__name__}: {one.message}\n")

    def records(self) -> dict[str, list[dict[str, object]]]:
        """Return the table ``said`` without its key; nothing where nothing was said."""
        told = {name: stream.text() for name, stream in self._streams.items()}
        said: list[dict[str, object]] = [{"stream": name, "text": text} for name, text in told.items() if text]
        return {"said": said} if said else {}


class _Bounded:
    """Keeps the beginning of a text, and how long all of it was."""

    def __init__(self) -> None:
        self._kept = ""
        self._length = 0

    def add(self, text: str, more: int = 0) -> None:
        """Add a text, of which ``more`` bytes are not given; they are counted as characters."""
        self._length += len(text) + more
        self._kept += text[: MOST_CHARACTERS - len(self._kept)]

    def text(self) -> str:
        # A file of tables holds no lone surrogates.
        kept = self._kept.encode("utf-8", "replace").decode("utf-8")
        left = self._length - len(self._kept)
        return f"{kept}\n[cut here: {left:,} more characters]" if left else kept


class _Redirected:
    """Stands for a stream: takes what this thread and those that it starts write, and passes on what others do.

    A bar of progress, for one, is drawn by a thread that was there before.
    """

    def __init__(self, stream: IO[str], kept: _Bounded, aside: Aside | None) -> None:
        self._stream = stream
        self._kept = kept
        self._aside = aside or Aside()
        # Threads themselves, whose numbers go to others when they end.
        self._others = {*threading.enumerate()} - {threading.current_thread()}

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError(f"write() argument must be str, not {type(text).__name__}")
        if threading.current_thread() in self._others:
            return len(text) if self._aside.write(text) else self._stream.write(text)
        self._kept.add(text)
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        if threading.current_thread() in self._others:
            self._stream.flush()

    def close(self) -> None:
        """Leave the stream open, which is not the method's."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @property
    def stands_for(self) -> IO[str]:
        """The stream itself."""
        return self._stream


def _own(stream: object) -> IO[str] | None:
    """Return the stream that one of ours stands for, None for others."""
    return stream.stands_for if isinstance(stream, _Redirected) else None


def _descriptor(stream: IO[str]) -> int:
    """Return the descriptor that a stream writes to, -1 for one without."""
    try:
        return stream.fileno()
    except (OSError, ValueError, AttributeError):
        return -1
