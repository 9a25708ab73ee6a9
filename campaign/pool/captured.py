"""Capture of the output and warnings of a method during a trial, which are stored with the trial and not printed.

Output through Python's streams and log handlers is captured for the threads of the method. Output written directly to
descriptors 1 and 2 (by compiled code, by subprocesses, or through streams saved earlier) is captured only where the
method runs in the main thread, which is everywhere except in a Dask worker whose trials have no time limit; there it is
not captured. It is stored after the output through Python, and counts as the method's whichever thread wrote it. Output
of a process that crashes is lost.
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
from functools import cache
from typing import IO, Any

MOST_CHARACTERS = 4000
"""Limit of the text stored for each stream of a trial; the rest is only counted."""

_MOST_BYTES = 4 * MOST_CHARACTERS
"""A character has at most four bytes in UTF-8."""


class CapturedOutput:
    """Collector of the output and warnings of one method in one trial."""

    def __init__(self) -> None:
        self._streams = {"stdout": _BoundedText(), "stderr": _BoundedText(), "warnings": _BoundedText()}

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Capture output inside the context; warning filters are kept, but each code location may warn again."""
        out, err = sys.stdout, sys.stderr
        descriptors = (_Descriptor(1, self._streams["stdout"]), _Descriptor(2, self._streams["stderr"]))
        originals = {one.number: one for one in descriptors}
        to_out = _CapturedStream(out, self._streams["stdout"], originals.get(_number_of(out)))
        to_err = _CapturedStream(err, self._streams["stderr"], originals.get(_number_of(err)))

        def away(stream: object) -> _CapturedStream | None:
            own = _replaced_by(stream) or stream
            return to_out if own in (out, sys.__stdout__) else to_err if own in (err, sys.__stderr__) else None

        with ExitStack() as stack:
            caught = stack.enter_context(warnings.catch_warnings(record=True))
            stack.enter_context(redirect_stdout(to_out))
            stack.enter_context(redirect_stderr(to_err))
            # Handlers that the method creates meanwhile get back the stream that was replaced as well: they would
            # otherwise go on to write to a finished trial.
            stack.callback(_give_streams, _replaced_by)
            _give_streams(away)
            stack.enter_context(_redirected(descriptors, (out, err)))
            try:
                yield
            finally:
                for one in caught or ():
                    where = f"{one.filename}:{one.lineno}"
                    self._streams["warnings"].add(f"{where}: {one.category.__name__}: {one.message}\n")

    def records(self) -> dict[str, list[dict[str, object]]]:
        """Return the table ``said`` without its key columns; empty if there was no output."""
        texts = {name: stream.text() for name, stream in self._streams.items()}
        said: list[dict[str, object]] = [{"stream": name, "text": text} for name, text in texts.items() if text]
        return {"said": said} if said else {}


class _BoundedText:
    """The beginning of a text, and its whole length."""

    def __init__(self) -> None:
        self._kept = ""
        self._length = 0

    def add(self, text: str, more: int = 0) -> None:
        """Append a text, and count ``more`` bytes that were left out as characters."""
        self._length += len(text) + more
        self._kept += text[: MOST_CHARACTERS - len(self._kept)]

    def text(self) -> str:
        # Parquet strings cannot contain lone surrogates.
        kept = self._kept.encode("utf-8", "replace").decode("utf-8")
        left = self._length - len(self._kept)
        return f"{kept}\n[cut here: {left:,} more characters]" if left else kept


class _CapturedStream:
    """Replacement of a stream that captures the output of this thread and those it starts, and forwards that of others.

    A progress bar, for example, is drawn by a thread that existed before.
    """

    def __init__(self, stream: IO[str], kept: _BoundedText, original: _Descriptor | None) -> None:
        self.replaced = stream
        self._kept = kept
        self._original = original
        # Thread objects rather than their identifiers, which are reused.
        self._others = {*threading.enumerate()} - {threading.current_thread()}

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError(f"write() argument must be str, not {type(text).__name__}")
        if threading.current_thread() in self._others:
            forwarded = self._original is not None and self._original.write(text)
            return len(text) if forwarded else self.replaced.write(text)
        self._kept.add(text)
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        if threading.current_thread() in self._others:
            self.replaced.flush()

    def close(self) -> None:
        """Do nothing, as the stream does not belong to the method."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.replaced, name)


def _replaced_by(stream: object) -> IO[str] | None:
    """Return the stream that a captured stream replaces; None for other streams."""
    return stream.replaced if isinstance(stream, _CapturedStream) else None


def _number_of(stream: IO[str]) -> int:
    """Return the descriptor that a stream writes to, or -1."""
    try:
        return stream.fileno()
    except (OSError, ValueError, AttributeError):
        return -1


def _give_streams(other: Callable[[object], Any]) -> None:
    """Give each log handler ``other(its stream)``, if that is a stream: handlers keep the one they were made with."""
    for handler in [reference() for reference in getattr(logging, "_handlerList", ())]:
        if isinstance(handler, logging.StreamHandler) and "stream" in vars(handler):
            stream = other(handler.stream)
            if stream is not None:
                handler.setStream(stream)


class _Descriptor:
    """Descriptor 1 or 2 of this process, which leads to a file while a method works."""

    def __init__(self, number: int, kept: _BoundedText) -> None:
        self.number, self._kept = number, kept
        self.file = -1
        self._original: int | None = None
        self._lock = threading.Lock()

    def write(self, text: str) -> bool:
        """Write a text to the original destination; return False if the descriptor leads there."""
        with self._lock:
            if self._original is None:
                return False
            rest = text.encode(errors="replace")
            while rest:
                rest = rest[os.write(self._original, rest) :]
            return True

    def open(self) -> bool:
        """Open the file, and copy the descriptor; return False if it cannot be redirected."""
        try:
            self.file, original = _file(self.number, os.getpid()), os.dup(self.number)
        except OSError:  # no folder for temporary files, or the descriptor is closed
            return False
        with self._lock:
            self._original = original
        return True

    def close(self) -> None:
        """Lead the descriptor back, and keep what came into the file."""
        with self._lock:
            if self._original is not None:
                os.dup2(self._original, self.number)
                os.close(self._original)
            self._original = None
        size = os.lseek(self.file, 0, os.SEEK_END)
        if size:
            kept = os.pread(self.file, _MOST_BYTES, 0)
            # Copies of a descriptor share the file position, so it is reset for the next trial.
            os.ftruncate(self.file, 0)
            os.lseek(self.file, 0, os.SEEK_SET)
            self._kept.add(kept.decode("utf-8", "replace"), size - len(kept))


@contextmanager
def _redirected(descriptors: Sequence[_Descriptor], streams: Sequence[IO[str]]) -> Iterator[None]:
    """Redirect descriptors of this process to files, and keep what is written there.

    Done only in the main thread: where a method runs in another thread, as in a Dask worker, the main thread writes
    logs meanwhile, which would count as the method's.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    opened = [one for one in descriptors if one.open()]
    try:
        _flush(streams)
        for one in opened:
            os.dup2(one.file, one.number)
        yield
    finally:
        _flush(streams)
        for one in opened:
            one.close()


@cache
def _file(number: int, process: int) -> int:
    """Open an unnamed temporary file for a descriptor, one for each process, so that a fork gets another."""
    del number, process
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _flush(streams: Sequence[IO[str]]) -> None:
    """Flush the buffers of Python and of the C library."""
    for stream in {sys.__stdout__, sys.__stderr__, *streams}:
        if stream is not None:
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
    _c_flush()()


@cache
def _c_flush() -> Callable[[], object]:
    """Return a function that flushes the C library's standard output, which is buffered unless it is a terminal."""
    try:
        library = ctypes.CDLL(None)
        held = ctypes.c_void_p.in_dll(library, "stdout")
    except (OSError, ValueError):
        return lambda: None
    flush = library.fflush
    return lambda: flush(held)
