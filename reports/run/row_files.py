"""The rows behind the numbers of a report, as CSV files that its tables link to."""

from __future__ import annotations

from pathlib import Path

from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.named_figure import file_stem

_MOST_ROWS = 50_000
_FOLDER = "rows"


def write_row_files(run: RunData, folder: Path) -> list[str]:
    """Write the rows of each scenario and estimator, without empty columns, and return the names of the files.

    Nothing is written for a run of very many trials: its Parquet tables are much smaller than text.
    """
    if len(run.rows) > _MOST_ROWS:
        return []
    names = []
    (folder / _FOLDER).mkdir()
    for (scenario, estimator), rows in run.rows.groupby(["scenario", "estimator"], sort=False):
        names.append(row_file(str(scenario), str(estimator)))
        rows.dropna(axis="columns", how="all").to_csv(folder / names[-1], index=False, lineterminator="\n")
    return names


def row_file(scenario: str, estimator: str) -> str:
    """Name the file of a scenario and an estimator, from the folder of the report."""
    return f"{_FOLDER}/{file_stem(scenario, estimator)}.csv"


def row_links(run: RunData, grid: Grid) -> list[str]:
    """Return, for each line of a table that names its estimator, the file of its rows; '' where there is none."""
    pairs = set(run.pairs()) if len(run.rows) <= _MOST_ROWS else set()
    alone = next(iter({scenario for scenario, _ in pairs})) if len({scenario for scenario, _ in pairs}) == 1 else ""
    links = []
    for row in grid.rows:
        named = dict(zip(grid.columns, row, strict=True))
        pair = (named.get("scenario", alone), named.get("estimator", ""))
        links.append(row_file(*pair) if pair in pairs else "")
    return links if any(links) else []
