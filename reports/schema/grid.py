"""A table of printed cells: the same for the page, for Markdown and for the terminal."""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from boresight.reports.schema.records import Key, Record, by_key

NO_VALUE = "-"
WITHOUT_VALUE = "no value: nothing was counted, or there are too few trials for it"
_OF = " of the "


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of printed cells: headings, and rows of as many cells.

    ``note`` is what a reader must know to read it. ``text`` are the numbers of the columns that hold text; the others
    hold numbers and align right. ``known`` is the a priori knowledge on board, printed with the table wherever it goes;
    of headlines only.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[int] = frozenset({0})
    note: str = ""
    known: str = ""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.title}: a row has not as many cells as there are columns")

    def keep(self, *columns: str) -> Grid:
        """Keep only the named columns."""
        return self.at([self.columns.index(name) for name in columns])

    def at(self, chosen: Sequence[int]) -> Grid:
        """Keep only the columns of these numbers."""
        columns, *rows = (tuple(row[i] for i in chosen) for row in (self.columns, *self.rows))
        text = frozenset(new for new, old in enumerate(chosen) if old in self.text)
        return Grid(self.title, columns, tuple(rows), text, self.note, self.known)

    def markdown(self) -> str:
        """Write as a Markdown table under its heading."""
        rule = [":--" if i in self.text else "--:" for i in range(len(self.columns))]
        # A text must not end its cell.
        escaped = ([c.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ") for c in row] for row in self.rows)
        cells = [self.columns, rule, *escaped]
        table = "\n".join(f"| {' | '.join(row)} |" for row in cells)
        return "\n\n".join(part for part in (f"### {self.title}", self.note, table, self.known) if part) + "\n"

    def latex(self) -> str:
        """Write as a LaTeX table in the style of the package booktabs, no wider than the line, its note below it."""
        columns = "".join("l" if i in self.text else "r" for i in range(len(self.columns)))
        rows = [_latex_row(row) for row in (self.columns, *self.rows)]
        below = [text for text in (self.note, self.known) if text]
        note = [rf"\par\smallskip\raggedright\footnotesize {_latex(text)}" for text in below]
        return "\n".join(
            [
                r"% needs \usepackage{booktabs,graphicx}",
                r"\begin{table}",
                rf"\caption{{{_latex(self.title)}}}",
                r"\centering",
                r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
                rf"\begin{{tabular}}{{{columns}}}",
                r"\toprule",
                rows[0],
                r"\midrule",
                *rows[1:],
                r"\bottomrule",
                r"\end{tabular}}",
                *note,
                r"\end{table}",
                "",
            ]
        )


_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}", "\n": " ",
    "≥": r"$\geq$", "≤": r"$\leq$", "±": r"$\pm$", "°": r"$^\circ$", "∞": r"$\infty$", "–": "--", "−": "$-$",
}  # fmt: skip


def _latex_row(cells: Sequence[str]) -> str:
    """Write a row; an end of a row takes a star or a bracket that follows for its own."""
    row = " & ".join(_latex(cell) for cell in cells)
    return ("{}" if row.startswith(("[", "*")) else "") + row + r" \\"


def _latex(cell: str) -> str:
    """Keep the characters that LaTeX takes for commands from being so."""
    return "".join(_SPECIAL.get(character, character) for character in cell)


_SMALL_P = 1e-3
_ROUNDING = 1e-12
"""A number that is not larger is 0 to the rounding of what it was computed from."""


def number(value: float | None) -> str:
    """Print three significant digits (whole numbers from 100 on; 0 for rounding errors); ``-`` for no value."""
    if value is None:
        return NO_VALUE
    if abs(value) < _ROUNDING:
        return "0"
    if abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def shortest(value: float, digits: int = 3) -> str:
    """Print significant digits in the shortest form, for labels; 0 for rounding errors."""
    return f"{0.0 if abs(value) < _ROUNDING else value:.{digits}g}"


def chance(p: float | None) -> str:
    """Print the p of a test."""
    return f"< {_SMALL_P:g}" if p is not None and p < _SMALL_P else number(p)


def value_of(record: Record | None, interval: bool = False) -> str:
    """Print a record's value, on request with its interval; times with s or ms."""
    if record is None or record.value is None:
        return NO_VALUE
    if record.statistic == "count":
        return str(int(record.value))
    if record.statistic == "value":
        interval = False
    if record.statistic == "sign test p":
        return chance(record.value)
    scale, unit = (1.0, "") if record.unit != "s" else (1.0, " s") if record.value >= 1 else (1e3, " ms")
    value = f"{number(scale * record.value)}{unit}"
    if not interval or record.low is None or record.high is None:
        return value
    return f"{value} [{number(scale * record.low)}, {number(scale * record.high)}]"


def of_ended(cell: str, n_ok: int, n: int) -> str:
    """Add to a cell over trials of which some have no value that it is of those that ended with one."""
    return cell if n_ok == n or cell == NO_VALUE else f"{cell}{_OF}{n_ok} that ended"


def value_of_ended(record: Record | None, interval: bool = False) -> str:
    """Print a record's value as `value_of`, and of how many trials where others have none."""
    cell = value_of(record, interval)
    return cell if record is None else of_ended(cell, record.n_ok, record.n)


def says_of_ended(cell: str) -> bool:
    """Tell a cell of `of_ended`, which is so long that it may wrap."""
    return _OF in cell


def counts(record: Record | None) -> str:
    """Print n_ok/n."""
    return NO_VALUE if record is None else f"{record.n_ok}/{record.n}"


Printed = Callable[[Key, Mapping[Key, Record]], str]
"""A cell of the line with a key, from the records of a run."""


@dataclass(frozen=True, slots=True)
class GridColumn:
    """A column of a table of records: its heading, its cells by the key of each line, and whether they are texts."""

    head: str
    cell: Printed
    text: bool = False


def text_column(head: str, of: Callable[[Key], str]) -> GridColumn:
    """Make a column of texts that the key of a line gives."""
    return GridColumn(head, lambda key, _: of(key), text=True)


def record_column(
    head: str,
    measure: str = "",
    statistic: str = "",
    *,
    reference: str = "",
    interval: bool = False,
    ended: bool = False,
    printed: Callable[[Record | None], str] | None = None,
) -> GridColumn:
    """Make a column of the records with a measure, statistic and reference; '' for those of the line's own key.

    Cells have the 95 % ``interval``, or say of how many trials they are where others have not ``ended`` with a value.
    ``printed`` prints a record otherwise.
    """
    usual = value_of_ended if ended else value_of

    def cell(key: Key, known: Mapping[Key, Record]) -> str:
        given = {"measure": measure, "statistic": statistic, "reference": reference}
        found = known.get(key._replace(**{name: value for name, value in given.items() if value}))
        return usual(found, interval=interval) if printed is None else printed(found)

    return GridColumn(head, cell)


def row_grid(
    title: str, rows: Sequence[Mapping[str, str]], text: Iterable[str], note: str = "", known: str = ""
) -> Grid:
    """Tabulate one row or more, each the headings of the columns and its cells.

    ``text`` are the headings of the columns of texts.
    """
    heads, texts = tuple(rows[0]), set(text)
    numbers = frozenset(i for i, head in enumerate(heads) if head in texts)
    return Grid(title, heads, tuple(tuple(row.values()) for row in rows), numbers, note, known)


SCENARIO = text_column("scenario", lambda key: key.scenario)
ESTIMATOR = text_column("estimator", lambda key: key.estimator)
UNIT = GridColumn("unit", lambda key, known: known[key].unit, text=True)


def record_grid(
    title: str,
    columns: Sequence[GridColumn],
    records: Iterable[Record],
    lines: Iterable[Record | Key],
    note: str = "",
    on_board: str = "",
) -> Grid | None:
    """Tabulate records, a line for each of some keys or records; None without lines.

    ``on_board`` is the line on the a priori knowledge.
    """
    index, rows = by_key(records), []
    for line in lines:
        key, own = (line, {}) if isinstance(line, Key) else (line.key, {line.key: line})
        known = ChainMap(own, index)
        rows.append(tuple(column.cell(key, known) for column in columns))
    text = frozenset(i for i, column in enumerate(columns) if column.text)
    heads = tuple(column.head for column in columns)
    return Grid(title, heads, tuple(rows), text, note, on_board) if rows else None


def scenario_grids(
    title: str, columns: Sequence[GridColumn], records: Iterable[Record], lines: Iterable[Record | Key], note: str = ""
) -> Iterator[Grid]:
    """Yield a table of `record_grid` for each scenario of the lines, its name behind the title."""
    of_scenario: dict[str, list[Record | Key]] = {}
    for line in lines:
        of_scenario.setdefault(line.scenario, []).append(line)
    for scenario, own in of_scenario.items():
        grid = record_grid(f"{title}, {scenario}", columns, records, own, note)
        if grid is not None:
            yield grid
