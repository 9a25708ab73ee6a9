"""Grids as tables for the terminal, as wide as it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

from boresight.reports.schema.grid import NO_VALUE, WITHOUT_VALUE, Grid, says_of_ended
from boresight.scenarios.errors import printable

_READABLE = 18
"""Characters that a text which wraps may have in a line at least."""


def rich_parts(grid: Grid) -> Iterator[FittedTable | Text]:
    """Yield a grid as a table, followed by what `-` is in it and by its line on what was known on board."""
    yield FittedTable(grid)
    if any(NO_VALUE in row for row in grid.rows):
        yield Text(f"{NO_VALUE}: {WITHOUT_VALUE}\n", style="dim")
    if grid.known:
        yield Text(f"{printable(grid.known)}\n", style="dim")


@dataclass(frozen=True, slots=True)
class FittedTable:
    """A grid as a table: numbers keep to one line, texts may wrap.

    Columns without room follow in further tables, each of which begins with the leading columns of text.
    """

    grid: Grid

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        """Yield the tables that fit the width of the console."""
        grid, least = self.grid, [_least_width(self.grid, i) for i in range(len(self.grid.columns))]
        leading = next((i for i in range(1, len(least)) if i not in grid.text), min(1, len(least)))
        chosen = list(range(leading))
        for i in range(leading, len(least)):
            if len(chosen) > leading and sum(least[k] + 1 for k in (*chosen, i)) > options.max_width + 1:
                yield _table(grid.at(chosen), [least[k] for k in chosen])
                chosen, grid = list(range(leading)), replace(grid, title="")
            chosen.append(i)
        yield _table(grid.at(chosen), [least[k] for k in chosen])


def _wraps(grid: Grid, column: int) -> bool:
    return column in grid.text or any(says_of_ended(row[column]) for row in grid.rows)


def _least_width(grid: Grid, column: int) -> int:
    """Return the width of a column whose texts are wrapped, but no word of them."""
    texts = [printable(row[column]) for row in (grid.columns, *grid.rows)]
    whole = max(map(cell_len, texts))
    if not _wraps(grid, column):
        return whole
    words = [word for text in texts for word in text.split()]
    return min(whole, max([_READABLE, *map(cell_len, words)]))


def _table(grid: Grid, least: list[int]) -> Table:
    title = printable(grid.title) or None
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    table.show_edge, table.padding = False, 0
    for i, (column, width) in enumerate(zip(grid.columns, least, strict=True)):
        table.add_column(
            printable(column), justify="left" if i in grid.text else "right", no_wrap=not _wraps(grid, i),
            overflow="fold", min_width=width,
        )  # fmt: skip
    for row in grid.rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    return table
