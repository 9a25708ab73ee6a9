"""A table as a drawing, ruled as books rule them: for those who put it into a document beside the figures."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from reports.figures.style import hide_axes, new_figure, styled
from reports.schema.grid import Grid

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
