"""Tables of a paper by their numbers, with our values, drawn as figures."""

from __future__ import annotations

import re
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from boresight.reports.figures.style import hide_axes, new_figure, styled
from boresight.reports.papers.page import PaperLine, paper_grid
from boresight.reports.schema.grid import NO_VALUE, Grid
from boresight.reports.schema.named_figure import NamedFigure

_PLACE = re.compile(r"table (\d+)\b", re.IGNORECASE)
_SHOWN = ("scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "tolerance", "verdict")

_LINE_IN, _GAP_IN, _TITLE_IN, _SIZE = 0.19, 0.22, 0.45, 8.0


@styled
def draw_table(grid: Grid) -> Figure:
    """Draw a table as wide as its cells: texts to the left, numbers to the right, three rules."""
    columns = list(zip(grid.columns, *grid.rows, strict=True))
    figure, (axes,) = new_figure(1)
    drawn = [[axes.text(0.0, 0.0, cell, fontsize=_SIZE, va="center") for cell in column] for column in columns]
    for heading, *_ in drawn:
        heading.set_fontweight("bold")
    widths = [max(cell.get_window_extent().width for cell in column) / figure.dpi for column in drawn]
    lines, width = len(grid.rows) + 1, sum(widths) + _GAP_IN * len(widths)
    figure.set_size_inches(width, _TITLE_IN + _LINE_IN * (lines + 0.5))
    axes.set(xlim=(0.0, width), ylim=(lines + 0.25, -0.25))
    hide_axes(axes)
    left = 0.5 * _GAP_IN
    for number, (column, own) in enumerate(zip(drawn, widths, strict=True)):
        _place(column, left, own, number in grid.text)
        left += own + _GAP_IN
    _rule(axes, lines, width)
    figure.suptitle(grid.title, fontsize=9.5)
    return figure


def _place(column: Sequence[Text], left_in: float, width_in: float, is_text: bool) -> None:
    for row, cell in enumerate(column):
        cell.set_position((left_in if is_text else left_in + width_in, row + 0.5))
        cell.set_horizontalalignment("left" if is_text else "right")


def _rule(axes: Axes, lines: int, width_in: float) -> None:
    """Draw the rules above and below the table and below its headings; its lines are one unit high."""
    for at, thick in ((0.0, 1.2), (1.0, 0.7), (float(lines), 1.2)):
        axes.hlines(at, 0.0, width_in, color="black", linewidth=thick)


def table_number(line: PaperLine) -> str:
    """Return the number of the paper's table in which a number is printed; '' if it is not in a table."""
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
    """Remove columns without any value."""
    cells = zip(grid.columns, zip(*grid.rows, strict=True), strict=True)
    kept = grid.keep(*(name for name, column in cells if set(column) != {NO_VALUE}))
    return Grid(title, kept.columns, kept.rows, kept.text, kept.note, kept.known)
