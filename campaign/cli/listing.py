"""What ``list`` prints: like a page of a manual in a terminal, a line for each campaign and scenario elsewhere."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.text import Text

from scenarios.errors import printable

_INDENT = 4
_GAP = "  "
_LEAST = 24
"""Characters that the last column, and what an entry is, have at least; a terminal that is narrower wraps them."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What stands in the list.

    Parameters
    ----------
    cells
        Its name, and what is told of it in short; the last may be long.
    what
        A sentence about it.
    """

    cells: tuple[str, ...]
    what: str


def print_entries(out: Console, heads: Sequence[str], entries: Sequence[Entry]) -> None:
    """Print entries under their headings.

    In a terminal an entry has a line of its cells, the last wrapped in its column, and what it is below. Elsewhere it
    has one line, what it is before the last cell: for a program, or a pager that moves to the right.
    """
    table = [tuple(heads), *(tuple(map(printable, one.cells)) for one in entries)]
    widths = [max(map(len, column)) for column in list(zip(*table, strict=True))[:-1]]
    if not out.is_terminal:
        whats = ["what it is", *(printable(one.what) for one in entries)]
        widths = [*widths, max(map(len, whats))]
        for cells, what in zip(table, whats, strict=True):
            _print_line(out, _columns((*cells[:-1], what, cells[-1]), widths))
        return
    _print_line(out, Text(_columns(table[0], widths), style="underline"))
    for cells, one in zip(table[1:], entries, strict=True):
        first, *further = _wrapped(cells, widths, out.width)
        _print_line(out, Text.assemble((cells[0], "bold"), first[len(cells[0]) :]))
        for line in (*further, *_indented(printable(one.what), out.width)):
            _print_line(out, line)


def _print_line(out: Console, line: str | Text) -> None:
    """Print a line as it is: its width is known to fit."""
    out.print(line, soft_wrap=True, highlight=False)


def _wrapped(cells: Sequence[str], widths: Sequence[int], width: int) -> list[str]:
    """Lay cells out, the last wrapped in what the others leave of a line."""
    before = _columns((*cells[:-1], "|"), widths)[:-1]
    width = max(width, len(before) + _LEAST)
    after = " " * len(before)
    lines = textwrap.wrap(cells[-1], width, initial_indent=before, subsequent_indent=after, break_on_hyphens=False)
    return lines or [before.rstrip()]


def _indented(text: str, width: int) -> list[str]:
    margin = " " * _INDENT
    return textwrap.wrap(text, max(width, _LEAST), initial_indent=margin, subsequent_indent=margin)


def _columns(cells: Sequence[str], widths: Sequence[int]) -> str:
    *padded, last = cells
    return _GAP.join([*(f"{cell:<{width}}" for cell, width in zip(padded, widths, strict=True)), last]).rstrip(" ")
