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
from dataclasses import dataclass
from functools import cache
from typing import IO, Any

MOST_CHARACTERS = 4000
"""Limit of the text stored for each stream of a trial; the rest is only counted."""

_MOST_BYTES = 4 * MOST_CHARACTERS
"""A character has at most four bytes in UTF-8."""


class _OriginalOutput:
    """Original destination of a descriptor while the descriptor is redirected."""

    def __init__(self) -> None:
        self._descriptor: int | None = None
        self._lock = threading.Lock()

    def write(self, text: str) -> bool:
        """Write a text and return True; return False if the descriptor is not redirected."""
        with self._lock:
            if self._descriptor is None:
                return False
            rest = text.encode(errors="replace")
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
            return True

    def begin(self, descriptor: int) -> None:
        """Start writing to a copy of the original descriptor."""
        with self._lock:
            self._descriptor = descriptor

    def end(self) -> None:
        """Stop writing, and close the copy."""
        with self._lock:
            if self._descriptor is not None:
                os.close(self._descriptor)
            self._descriptor = None


@dataclass(frozen=True, slots=True)
class _RedirectedDescriptor:
    """Redirection of descriptor 1 or 2.

    Parameters
    ----------
    number
        The descriptor.
    stream
        Python's stream that writes to it.
    original
        Gives access to the original destination meanwhile.
    record
        Called with the captured text, and the number of bytes beyond ``most_bytes``.
    most_bytes
        Limit of the captured text.
    """

    number: int
    stream: IO[str]
    original: _OriginalOutput
    record: Callable[[str, int], None]
    most_bytes: int


@contextmanager
def _redirected_descriptors(every: Sequence[_RedirectedDescriptor]) -> Iterator[None]:
    """Redirect descriptors of this process to files, and record what is written there.

    Done only in the main thread: where a method runs in another thread, as in a Dask worker, the main thread writes
    logs meanwhile, which would count as the method's.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    opened = [(one, *files) for one in every if (files := _opened(one.number)) is not None]
    try:
        for one, _, before in opened:
            one.original.begin(before)
        _flush(every)
        for one, file, _ in opened:
            os.dup2(file, one.number)
        yield
    finally:
        _flush(every)
        for one, file, before in opened:
            os.dup2(before, one.number)
            one.original.end()
            _record_file(file, one)


def _opened(number: int) -> tuple[int, int] | None:
    """Open the file for a descriptor and copy the descriptor; None if it cannot be redirected."""
    try:
        return _file(number, os.getpid()), os.dup(number)
    except OSError:  # no folder for temporary files, or the descriptor is closed
        return None


@cache
def _file(number: int, process: int) -> int:
    """Open an unnamed temporary file for a descriptor, one for each process, so that a fork gets another."""
    del number, process
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _flush(every: Sequence[_RedirectedDescriptor]) -> None:
    """Flush the buffers of Python and of the C library."""
    for stream in {sys.__stdout__, sys.__stderr__, *(one.stream for one in every)}:
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


def _record_file(file: int, redirected: _RedirectedDescriptor) -> None:
    size = os.lseek(file, 0, os.SEEK_END)
    if size == 0:
        return
    kept = os.pread(file, redirected.most_bytes, 0)
    # Copies of a descriptor share the file position, so it is reset for the next trial.
    os.ftruncate(file, 0)
    os.lseek(file, 0, os.SEEK_SET)
    redirected.record(kept.decode("utf-8", "replace"), size - len(kept))


@contextmanager
def _redirected_log_handlers(away: Callable[[object], Any], back: Callable[[object], Any]) -> Iterator[None]:
    """Redirect the streams of log handlers, which keep the stream that they were created with.

    Parameters
    ----------
    away
        Returns the replacement of a handler's stream; None to keep it.
    back
        Returns the original of a replaced stream, and None for others. It also restores handlers created meanwhile by
        the method, which would otherwise continue to write to the finished trial.
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
    """Return the log handlers that hold a stream of their own."""
    known = (reference() for reference in getattr(logging, "_handlerList", ()))
    return [one for one in known if isinstance(one, logging.StreamHandler) and "stream" in vars(one)]


class CapturedOutput:
    """Collector of the output and warnings of one method in one trial."""

    def __init__(self) -> None:
        self._streams = {"stdout": _BoundedText(), "stderr": _BoundedText(), "warnings": _BoundedText()}

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Capture output inside the context; warning filters are kept, but each code location may warn again."""
        out, err = sys.stdout, sys.stderr
        originals = {1: _OriginalOutput(), 2: _OriginalOutput()}
        to_out = _CapturedStream(out, self._streams["stdout"], originals.get(_descriptor(out)))
        to_err = _CapturedStream(err, self._streams["stderr"], originals.get(_descriptor(err)))

        def away(stream: object) -> _CapturedStream | None:
            own = _own(stream) or stream
            return to_out if own in (out, sys.__stdout__) else to_err if own in (err, sys.__stderr__) else None

        with ExitStack() as stack:
            caught = stack.enter_context(warnings.catch_warnings(record=True))
            stack.enter_context(redirect_stdout(to_out))
            stack.enter_context(redirect_stderr(to_err))
            stack.enter_context(_redirected_log_handlers(away, _own))
            redirected = (
                _RedirectedDescriptor(1, out, originals[1], self._streams["stdout"].add, _MOST_BYTES),
                _RedirectedDescriptor(2, err, originals[2], self._streams["stderr"].add, _MOST_BYTES),
            )
            stack.enter_context(_redirected_descriptors(redirected))
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

    def __init__(self, stream: IO[str], kept: _BoundedText, original: _OriginalOutput | None) -> None:
        self._stream = stream
        self._kept = kept
        self._original = original or _OriginalOutput()
        # Thread objects rather than their identifiers, which are reused.
        self._others = {*threading.enumerate()} - {threading.current_thread()}

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError(f"write() argument must be str, not {type(text).__name__}")
        if threading.current_thread() in self._others:
            return len(text) if self._original.write(text) else self._stream.write(text)
        self._kept.add(text)
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        if threading.current_thread() in self._others:
            self._stream.flush()

    def close(self) -> None:
        """Do nothing, as the stream does not belong to the method."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @property
    def replaced(self) -> IO[str]:
        """The replaced stream."""
        return self._stream


def _own(stream: object) -> IO[str] | None:
    """Return the stream that a captured stream replaces; None for other streams."""
    return stream.replaced if isinstance(stream, _CapturedStream) else None


def _descriptor(stream: IO[str]) -> int:
    """Return the descriptor that a stream writes to, or -1."""
    try:
        return stream.fileno()
    except (OSError, ValueError, AttributeError):
        return -1
