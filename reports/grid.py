"""A table of printed cells: the same for the page, for Markdown and for the terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass

from reports.records import Record

NO_VALUE = "-"


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of printed cells.

    Parameters
    ----------
    title, note
        Heading, and what a reader must know to read it.
    columns
        Headings of the columns.
    rows
        Cells, as many as columns.
    text
        Numbers of the columns that hold text; the others hold numbers and align right.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[int] = frozenset({0})
    note: str = ""

    def keep(self, *columns: str) -> Grid:
        """Keep only the named columns."""
        chosen = [self.columns.index(name) for name in columns]
        rows = tuple(tuple(row[i] for i in chosen) for row in self.rows)
        text = frozenset(new for new, old in enumerate(chosen) if old in self.text)
        return Grid(self.title, columns, rows, text, self.note)

    def markdown(self) -> str:
        """Write as a Markdown table under its heading."""
        rule = [":--" if i in self.text else "--:" for i in range(len(self.columns))]
        cells = [self.columns, rule, *([_escape(cell) for cell in row] for row in self.rows)]
        table = "\n".join(f"| {' | '.join(row)} |" for row in cells)
        return "\n\n".join(part for part in (f"### {self.title}", self.note, table) if part) + "\n"


def _escape(cell: str) -> str:
    """Keep a text from ending its Markdown cell."""
    return cell.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ")


def number(value: float | None) -> str:
    """Print three significant digits (whole numbers from 100 on); ``-`` for no value."""
    if value is None:
        return NO_VALUE
    if value == 0 or abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def value_of(record: Record | None, interval: bool = False) -> str:
    """Print a record's value, on request with its interval; times with s or ms."""
    if record is None or record.value is None:
        return NO_VALUE
    if record.statistic == "count":
        return str(int(record.value))
    if record.statistic == "value":
        interval = False
    scale, unit = (1.0, "") if record.unit != "s" else (1.0, " s") if record.value >= 1 else (1e3, " ms")
    value = f"{number(scale * record.value)}{unit}"
    if not interval or record.low is None or record.high is None:
        return value
    return f"{value} [{number(scale * record.low)}, {number(scale * record.high)}]"


def counts(record: Record | None) -> str:
    """Print n_ok/n."""
    return NO_VALUE if record is None else f"{record.n_ok}/{record.n}"
