"""Tables of a paper by their numbers, with our values, drawn as figures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from matplotlib.figure import Figure

from boresight.reports.figures.style import finish, hide_axes, new_figure, styled
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
        for row, cell in enumerate(column):
            cell.set_position((left if number in grid.text else left + own, row + 0.5))
            cell.set_horizontalalignment("left" if number in grid.text else "right")
        left += own + _GAP_IN
    # Rules above and below the table and below its headings; its lines are one unit high.
    for at, thick in ((0.0, 1.2), (1.0, 0.7), (float(lines), 1.2)):
        axes.hlines(at, 0.0, width, color="black", linewidth=thick)
    return finish(figure, grid.title)


def lines_by_table(lines: Sequence[PaperLine]) -> dict[str, list[PaperLine]]:
    """Gather the lines whose numbers are printed in each table of the paper, in the order of the tables."""
    gathered: dict[str, list[PaperLine]] = {}
    for line in lines:
        found = _PLACE.match(line.place)
        if found:
            gathered.setdefault(found[1], []).append(line)
    return {number: gathered[number] for number in sorted(gathered, key=int)}


def table_figure(number: str, lines: Sequence[PaperLine]) -> NamedFigure:
    """Draw a table of the paper: its numbers, ours with their intervals and counts, and the verdicts."""
    grid = paper_grid(lines).keep(*_SHOWN)
    columns = zip(grid.columns, zip(*grid.rows, strict=True), strict=True)
    with_values = grid.keep(*(name for name, column in columns if set(column) != {NO_VALUE}))
    grid = replace(with_values, title=f"Table {number} of the paper, and ours")
    campaigns = ", ".join(dict.fromkeys(line.campaign for line in lines))
    return NamedFigure(
        f"table_{number:0>2}",
        draw_table(grid),
        f"Table {number}. What the paper prints in its table, and ours with 95 % intervals and the trials behind each"
        f" number, from {campaigns}.",
        f"The {len(lines)} numbers of table {number} beside ours.",
    )
