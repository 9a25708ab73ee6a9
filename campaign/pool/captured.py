"""Captures what a method prints and warns of while it works: stored with its trial, and not shown on the terminal.

What goes through Python's streams and handlers of logs is captured where the method's own threads write it. What goes
to the descriptors 1 and 2 themselves (of compiled code, of processes that the method starts, of streams kept from
before) is captured where the method works in the main thread, which is everywhere but in a worker of Dask whose trials
have no limit of time: there it goes where it went before. It follows what came through Python, and is the method's
whichever thread wrote it. What a process writes while it crashes is lost with it.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from typing import IO, Any

MOST_CHARACTERS = 4000
"""Kept of each stream in a trial; the rest is counted."""

_MOST_BYTES = 4 * MOST_CHARACTERS
"""No character of UTF-8 has more than four."""


class Aside:
    """Writes to where a descriptor led before it was led away; what it is given at other times it leaves."""

    def __init__(self) -> None:
        self._descriptor: int | None = None
        self._lock = threading.Lock()

    def write(self, text: str) -> bool:
        """Write a text, and tell whether it is written."""
        with self._lock:
            if self._descriptor is None:
                return False
            rest = text.encode(errors="replace")
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
            return True

    def begin(self, descriptor: int) -> None:
        """Write to this one from now on."""
        with self._lock:
            self._descriptor = descriptor

    def end(self) -> None:
        """Write nothing any more, and close the descriptor."""
        with self._lock:
            if self._descriptor is not None:
                os.close(self._descriptor)
            self._descriptor = None


@dataclass(frozen=True, slots=True)
class Led:
    """A descriptor (1 or 2) that is to be led away.

    Parameters
    ----------
    number
        The descriptor.
    stream
        Python's stream that writes to it.
    aside
        Is given where it led before.
    tell
        Is told the text that came, and how many bytes more than ``most_bytes`` were left out.
    most_bytes
        So much is told at most.
    """

    number: int
    stream: IO[str]
    aside: Aside
    tell: Callable[[str, int], None]
    most_bytes: int


@contextmanager
def descriptors_led_away(every: Sequence[Led]) -> Iterator[None]:
    """Lead descriptors of this process to files, and tell what came there.

    Only in the main thread. Where a method works in another, as in a worker of Dask, the main thread writes logs of its
    own all the while, which would be taken for the method's.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    opened = [(one, *files) for one in every if (files := _opened(one.number)) is not None]
    try:
        for one, _, before in opened:
            one.aside.begin(before)
        _flush(every)
        for one, file, _ in opened:
            os.dup2(file, one.number)
        yield
    finally:
        _flush(every)
        for one, file, before in opened:
            os.dup2(before, one.number)
            one.aside.end()
            _tell(file, one)


def _opened(number: int) -> tuple[int, int] | None:
    """Return the file to lead a descriptor to, and a copy of the descriptor; None where it stays as it is."""
    try:
        return _file(number, os.getpid()), os.dup(number)
    except OSError:  # no folder for temporary files, or the descriptor is closed
        return None


@cache
def _file(number: int, process: int) -> int:
    """Open the file of a descriptor, which has no name and goes with its process; a fork of it has another."""
    del number, process
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _flush(every: Sequence[Led]) -> None:
    """Write what Python and the C library still hold."""
    for stream in {sys.__stdout__, sys.__stderr__, *(one.stream for one in every)}:
        if stream is not None:
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
    _c_flush()()


@cache
def _c_flush() -> Callable[[], object]:
    """Return what flushes the standard output of the C library, which is held back where it is no terminal."""
    try:
        library = ctypes.CDLL(None)
        held = ctypes.c_void_p.in_dll(library, "stdout")
    except (OSError, ValueError):
        return lambda: None
    flush = library.fflush
    return lambda: flush(held)


def _tell(file: int, led: Led) -> None:
    size = os.lseek(file, 0, os.SEEK_END)
    if size == 0:
        return
    kept = os.pread(file, led.most_bytes, 0)
    # Copies of the descriptor share the place at which the next is written.
    os.ftruncate(file, 0)
    os.lseek(file, 0, os.SEEK_SET)
    led.tell(kept.decode("utf-8", "replace"), size - len(kept))


@contextmanager
def logs_led_away(away: Callable[[object], Any], back: Callable[[object], Any]) -> Iterator[None]:
    """Lead handlers of logs from streams to others: they were made when a module was imported, and keep their stream.

    Parameters
    ----------
    away
        Returns the stream that a handler of another is to write to; None for one that is to stay.
    back
        Returns the stream that such a one stands for, and None for others. A handler that is made while a method works
        gets its stream back too, or it would go on writing for a trial that is over.
    """
    _give_streams(away)
    try:
        yield
    finally:
        _give_streams(back)


def _give_streams(other: Callable[[object], Any]) -> None:
    for handler in _handlers():
        stream = other(handler.stream)
        if stream is not None:
            handler.setStream(stream)


def _handlers() -> list[logging.StreamHandler[Any]]:
    """List the handlers that keep a stream of their own."""
    known = (reference() for reference in getattr(logging, "_handlerList", ()))
    return [one for one in known if isinstance(one, logging.StreamHandler) and "stream" in vars(one)]


class CapturedOutput:
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
