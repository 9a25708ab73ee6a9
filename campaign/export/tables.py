"""Export of stored tables as CSV or Parquet, and of the tables of a report as LaTeX."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from boresight.campaign.store import TABLES, RunFolder
from boresight.reports.figures.named import file_stem
from boresight.reports.kinds import report_grids
from boresight.reports.pages.content import read_content
from boresight.scenarios.atomic import write_atomically, write_text


def write_tables(
    folder: RunFolder, kind: str, trials: Sequence[int] | None, only: dict[str, str], out: Path
) -> list[Path]:
    """Write every table that is not empty to a file, and a file with the meaning of the columns.

    ``kind`` is ``csv`` or ``parquet``; both preserve every bit of the numbers. ``trials`` are those to export, None for
    all. ``only`` has required values by column, for tables that have the column.
    """
    written, meanings = [], []
    for name in TABLES:
        table = folder.table(name)
        for column, value in only.items():
            table = table[table[column] == value] if column in table else table
        table = table if trials is None else table[table["trial"].isin(trials)]
        if table.empty:
            continue
        written.append(out / f"{name}.{kind}")
        _write(table, written[-1], kind)
        meanings += [(name, column.name, column.meaning) for column in TABLES[name] if column.name in table]
    written.append(out / "columns.csv")
    _write(pd.DataFrame(meanings, columns=["table", "column", "meaning"]), written[-1], "csv")
    return written


def _write(table: pd.DataFrame, path: Path, kind: str) -> None:
    if kind == "csv":
        write_text(path, table.to_csv(index=False, lineterminator="\n"))
    else:
        write_atomically(path, lambda temporary: table.to_parquet(temporary, index=False))


def write_latex(folder: RunFolder, out: Path) -> list[Path]:
    """Write every table of the report as a LaTeX table in the style of booktabs."""
    written = []
    for grid in report_grids(read_content(folder.path)):
        written.append(out / f"{file_stem(grid.title.lower().replace(' ', '-'))}.tex")
        write_text(written[-1], grid.latex())
    return written
