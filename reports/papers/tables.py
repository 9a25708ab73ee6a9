"""The tables of a paper under their numbers: what they print, beside ours."""

from __future__ import annotations

import re
from collections.abc import Sequence

from reports.figures.drawn_table import draw_table
from reports.papers.page import PaperLine, paper_grid
from reports.schema.grid import NO_VALUE, Grid
from reports.schema.named_figure import NamedFigure

_PLACE = re.compile(r"table (\d+)\b", re.IGNORECASE)
_SHOWN = ("scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "tolerance", "verdict")


def table_number(line: PaperLine) -> str:
    """Return the number of the table of the paper in which a number is printed; '' if it stands elsewhere."""
    found = _PLACE.match(line.place)
    return found[1] if found else ""


def lines_by_table(lines: Sequence[PaperLine]) -> dict[str, list[PaperLine]]:
    """Gather the lines of each table of the paper, in the order of its numbers."""
    numbers = sorted({number for number in map(table_number, lines) if number}, key=int)
    return {number: [line for line in lines if table_number(line) == number] for number in numbers}


def table_figure(number: str, lines: Sequence[PaperLine]) -> NamedFigure:
    """Draw a table of the paper: its numbers, ours with their intervals and counts, and the verdicts."""
    grid = _narrowed(paper_grid(lines).keep(*_SHOWN), f"Table {number} of the paper, and ours")
    campaigns = ", ".join(dict.fromkeys(line.campaign for line in lines))
    return NamedFigure(
        f"table_{number:0>2}",
        draw_table(grid),
        f"Table {number}. What the paper prints in its table, and ours with 95 % intervals and the trials behind each"
        f" number, from {campaigns}.",
        f"The {len(lines)} numbers of table {number} beside ours.",
    )


def _narrowed(grid: Grid, title: str) -> Grid:
    """Leave out columns in which nothing stands."""
    cells = zip(grid.columns, zip(*grid.rows, strict=True), strict=True)
    kept = grid.keep(*(name for name, column in cells if set(column) != {NO_VALUE}))
    return Grid(title, kept.columns, kept.rows, kept.text, kept.note, kept.known)
