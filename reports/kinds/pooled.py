"""Tables of a grid of more cells than a page can show: estimators at each level of each axis, and the extreme cells.

A cell is a scenario with an estimator. A level is pooled over the other axes; its trials, which are the same views and
priors in every scenario, are the independent units. All cells are in ``table.csv``: of very many, their last errors and
success alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import GridAxis, RunData
from boresight.reports.run.outcomes import MEANING, final_stage, succeeded
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.grid import NO_VALUE, Grid, number, of_ended
from boresight.reports.schema.records import CONTROL, Record
from boresight.reports.statistics.measured import MEDIAN, P95, Sample, measure
from boresight.reports.tables import interval

MOST_CELLS = 200
"""Scenarios times estimators of a grid up to which a page has every cell."""
MOST_MEASURED = 5_000
"""Scenarios times estimators of a grid up to which ``table.csv`` has every statistic of every stage."""
MOST_LEVELS = 12
EXTREMES = 10
WHERE = "every cell is in table.csv, in the folder of this report"
ONLY_ERRORS = (
    " Of so many cells it has the success and both errors at the last stage alone; all else is in the rows of the run."
)


def is_wide(run: RunData) -> bool:
    """Return whether a grid of all combinations has too many cells to show each."""
    grid = run.manifest.grid
    return grid is not None and grid.design == "full" and len(run.pairs()) > MOST_CELLS


def is_huge(run: RunData) -> bool:
    """Return whether a grid of poses has too many cells to measure each in full: the table would be of gigabytes."""
    return is_wide(run) and len(run.posed_pairs()) > MOST_MEASURED


def cell_records(run: RunData) -> Iterator[Record]:
    """Measure of each cell its success, and the medians and 95th percentiles of both errors at its last stage."""
    rows, clusters, good = run.rows, clusters_of(run, run.rows), succeeded(run.rows)
    errors = {name: rows[name].where(rows["status"] == "ok").to_numpy(np.float64) for name in POSE_COLUMNS[:2]}
    cells: dict[Any, Any] = rows.groupby(["scenario", "estimator"], sort=False).indices
    for (scenario, estimator), own in cells.items():
        stage = CONTROL if estimator == CONTROL else final_stage(run, scenario, estimator)
        sample = Sample(scenario, estimator, stage, len(own))
        for name, values in errors.items():
            yield from sample.records(name, values[own], clusters[own], (MEDIAN, P95))
        if estimator != CONTROL:
            yield sample.share("success_share", good[own], clusters[own])


def level_grids(title: str, tables: Sequence[tuple[str, pd.DataFrame]], axes: Sequence[GridAxis]) -> Iterator[Grid]:
    """Tabulate the medians of an error at each level of each axis, a line for each estimator.

    ``tables`` are the label and the trials of each line: ``scenario``, ``trial``, ``value`` (NaN without an estimate),
    ``cluster``, ``success`` and the level of axis k in the column k.
    """
    note = f"Medians with 95 % intervals, over all other axes; {WHERE}. {MEANING}"
    for k, axis in enumerate(axes):
        levels = shown_levels(axis)
        columns = ("estimator", "solved", "success", "all", *levels)
        rows = []
        for label, own in tables:
            at = dict(list(own.groupby(k, sort=False)))
            cells = [_median(own), *(_median(at.get(level, own.iloc[:0])) for level in levels)]
            good = NO_VALUE if label == CONTROL else f"{int(own['success'].sum())}/{len(own)}"
            rows.append((label, f"{int(own['value'].notna().sum())}/{len(own)}", good, *cells))
        some = f" {len(levels)} of {len(axis.levels)} levels." if len(levels) < len(axis.levels) else ""
        yield Grid(f"{title}, by {axis.label}", columns, tuple(rows), frozenset({0}), note + some)
        note = ""


def shown_levels(axis: GridAxis) -> tuple[str, ...]:
    """Choose levels of an axis that a table can show, evenly spaced, the first and the last among them."""
    places = np.unique(np.linspace(0, len(axis.levels) - 1, MOST_LEVELS).round().astype(int))
    return tuple(axis.levels[k] for k in places)


def _median(trials: pd.DataFrame) -> str:
    known = trials[trials["value"].notna()]
    (found,) = measure(known["value"].to_numpy(np.float64), known["cluster"].to_numpy(), (MEDIAN,))
    return of_ended(interval(found), len(known), len(trials))


def extreme_grid(title: str, tables: Sequence[tuple[str, pd.DataFrame]], axes: Sequence[GridAxis]) -> Grid:
    """Tabulate the cells with the smallest and with the largest median of all trials, a failure being worse than any.

    Equal cells are in the order of the campaign. ``tables`` are those of `level_grids`.
    """
    whole = pd.concat([own.assign(estimator=label) for label, own in tables if label != CONTROL], ignore_index=True)
    cells = whole.assign(all=whole["value"].fillna(np.inf)).groupby(["scenario", "estimator"], sort=False)
    order = cells["all"].median().sort_values(kind="stable").index
    few = min(EXTREMES, len(order) // 2)
    chosen = [("best", key) for key in order[:few]] + [("worst", key) for key in order[::-1][:few]]
    rows = []
    for end, key in chosen:
        own = cells.get_group(key)
        levels = [str(own[k].iloc[0]) for k in range(len(axes))]
        solved = f"{int(own['value'].notna().sum())}/{len(own)}"
        rows.append(
            (
                end,
                *levels,
                str(key[1]),
                solved,
                _median(own),
                number(own["value"].max()) if own["value"].notna().any() else NO_VALUE,
            )
        )
    heads = ("", *(axis.label for axis in axes), "estimator", "solved", "median [95 %]", "largest")
    note = (
        f"The {few} cells with the smallest and the {few} with the largest median; a failure is worse than any error."
    )
    return Grid(f"{title}, best and worst cells", heads, tuple(rows), frozenset(range(2 + len(axes))), note)


def pooled_trials(run: RunData, errors: pd.DataFrame, rows: pd.DataFrame, levels: pd.DataFrame) -> pd.DataFrame:
    """Return the trials of an estimator for `level_grids`: its ``rows``, with ``errors`` by scenario and trial.

    ``levels`` have the level of axis k of each scenario in the column k.
    """
    named = errors.drop_duplicates(["scenario", "trial"]).set_index(["scenario", "trial"])["value"]
    places = pd.MultiIndex.from_frame(rows[["scenario", "trial"]])
    found = rows[["scenario", "trial"]].assign(
        value=named.reindex(places).to_numpy(np.float64), cluster=clusters_of(run, rows), success=succeeded(rows)
    )
    return found.join(levels, on="scenario")
