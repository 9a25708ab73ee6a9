"""Printing of plain text on the console, and the explanation of files that cannot be written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from boresight.scenarios.atomic import explain_write_error
from boresight.scenarios.errors import BoresightError, printable

_WIDTH = 160


class _Plain(Console):
    """Ignores markup and control characters in printed text."""

    def print(self, *objects: Any, **how: Any) -> None:
        shown = ("\n".join(map(printable, one.split("\n"))) if isinstance(one, str) else one for one in objects)
        super().print(*shown, **how)


def console() -> Console:
    """Return a console on standard output that wraps no text when it is not a terminal; tables are so wide then."""
    plain = _Plain(markup=False, emoji=False)
    if plain.is_terminal:
        return plain
    return _Plain(width=_WIDTH, soft_wrap=True, highlight=False, markup=False, emoji=False)


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """Explain in one line why ``place``, or a file that the error names, could not be written."""
    try:
        yield
    except OSError as error:
        raise BoresightError(explain_write_error(error.filename or place, error)) from error
