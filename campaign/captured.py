"""Captures what a method prints and warns of while it works: stored with its trial, and not shown on the terminal.

Only what goes through Python is captured. What compiled code writes to the file descriptors itself goes where it went
before.
"""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import IO, Any

MOST_CHARACTERS = 4000
"""Kept of each stream in a trial; the rest is counted."""


class Captured:
    """Collects what one method says in one trial."""

    def __init__(self) -> None:
        self._streams = {"stdout": _Bounded(), "stderr": _Bounded(), "warnings": _Bounded()}

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Capture what is written in here; filters of warnings stay as they are, but each place may warn again."""
        with ExitStack() as stack:
            caught = stack.enter_context(warnings.catch_warnings(record=True))
            stack.enter_context(redirect_stdout(_Redirected(sys.stdout, self._streams["stdout"])))
            stack.enter_context(redirect_stderr(_Redirected(sys.stderr, self._streams["stderr"])))
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

    def add(self, text: str) -> None:
        self._length += len(text)
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

    def __init__(self, stream: IO[str], kept: _Bounded) -> None:
        self._stream = stream
        self._kept = kept
        # Threads themselves, whose numbers go to others when they end.
        self._others = {*threading.enumerate()} - {threading.current_thread()}

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError(f"write() argument must be str, not {type(text).__name__}")
        if threading.current_thread() in self._others:
            return self._stream.write(text)
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
