"""Descriptors and handlers of logs, led away while a method works: what is written there passes Python's streams by."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from typing import IO, Any


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
