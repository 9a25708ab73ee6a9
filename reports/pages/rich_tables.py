"""Grids as tables for the terminal, 80 columns wide."""

from __future__ import annotations

from collections.abc import Iterator

from rich import box
from rich.table import Table
from rich.text import Text

from boresight.reports.schema.grid import Grid, says_of_ended
from boresight.scenarios.errors import printable


def rich_parts(grid: Grid) -> Iterator[Table | Text]:
    """Yield a grid as a table, followed by its line on what was known on board, if it has one."""
    yield rich_table(grid)
    if grid.known:
        yield Text(f"{printable(grid.known)}\n", style="dim")


def rich_table(grid: Grid) -> Table:
    """Lay a grid out: numbers keep to one line, texts may wrap."""
    table = Table(title=printable(grid.title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    table.show_edge, table.padding = False, 0
    for i, column in enumerate(grid.columns):
        is_text = i in grid.text
        wraps = is_text or any(says_of_ended(row[i]) for row in grid.rows)
        table.add_column(printable(column), justify="left" if is_text else "right", no_wrap=not wraps, overflow="fold")
    for row in grid.rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    return table
