"""Exceptions of boresight, and the printable form of messages and paths."""

from __future__ import annotations

import traceback
from pathlib import Path

_LONGEST = 2000


class BoresightError(Exception):
    """Base of all exceptions: an error that the user can correct. The message states what, where and what to do.

    The command line prints the message as one line and exits with code 2. Text of a damaged file may be part of it:
    control characters are escaped, and the middle of a very long line is left out.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__("\n".join(_shown(line) for line in str(message).split("\n")))


class MachineError(BoresightError):
    """A fault of the machine, not of the input (disk full, process killed): the same command continues afterwards."""


class UndrawableError(BoresightError):
    """Chance drew a trial that cannot be simulated: all methods have failed in it."""


class InsideBodyError(BoresightError):
    """A camera is inside the body: an error of a scenario, or the failure of a method that was led there."""


def display(path: Path) -> str:
    """Return a path relative to the working directory if it lies below it, in full otherwise."""
    try:
        return path.resolve().relative_to(Path.cwd()).as_posix()
    except (OSError, ValueError):
        return str(path)


def printable(text: str) -> str:
    """Escape line breaks and control characters."""
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def one_line(error: object) -> str:
    """Return the message of another library's error as one line."""
    return " ".join(str(error).split())


def text_of(error: BaseException) -> str:
    """Return an error as one printable line: the message of a `BoresightError`, type and message of any other."""
    said = error if isinstance(error, BoresightError) else traceback.format_exception_only(error)[0]
    return printable(one_line(said))


def _shown(line: str) -> str:
    line = printable(line)
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
