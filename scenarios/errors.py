"""The one exception root of boresight."""

from __future__ import annotations

import traceback

_LONGEST = 2000


class BoresightError(Exception):
    """A fault that a user can mend: the message says what is wrong, where, and what to do.

    The command line prints the message as one line and exits with code 2. Words of a damaged file may be part of it:
    what would steer a terminal is escaped, and what is too long to be read is cut out of the middle.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__("\n".join(_shown(line) for line in str(message).split("\n")))


class MachineError(BoresightError):
    """The machine is at fault, and no input: the same command goes on when that is mended."""


def printable(text: str) -> str:
    """Escape what would break a line or steer a terminal."""
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def one_line(error: object) -> str:
    """Write what another library says as one line."""
    return " ".join(str(error).split())


def text_of(error: BaseException) -> str:
    """Return in one line what an error says: of ours the text, of others their type as well."""
    return one_line(error if isinstance(error, BoresightError) else traceback.format_exception_only(error)[0])


def _shown(line: str) -> str:
    line = printable(line)
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
