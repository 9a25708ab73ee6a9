"""Maps of a grid with more cells than a page can show: errors and NEES of each estimator over its last two axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from boresight.reports.compare.trials import trial_numbers
from boresight.reports.figures.comparison import HeatMap, draw_heat_maps
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.kinds.pooled import shown_levels
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import GridAxis, RunData, ScenarioGrid
from boresight.reports.run.outcomes import keeping_attitude
from boresight.reports.schema.column import POSE_COLUMNS, SIGHT
from boresight.reports.schema.grid import number
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.consistency import NEES, POSE_DEGREES, SIGHT_DEGREES, SIGHT_NEES
from boresight.reports.statistics.measured import MEAN, MEDIAN, Measured, Statistic, measure

ERROR_MAP = "map_error"
"""Stem with which the files of maps of errors begin."""
_MOST_METHODS = 6  # with two figures each
_MOST_ACROSS = 20  # cells of all panels of a figure


def level_maps(run: RunData, grid: ScenarioGrid) -> Iterator[NamedFigure]:
    """Draw median error and mean NEES of each estimator of poses over the last two axes of a grid.

    Of more than six estimators there are none. There is a panel for each level of the axis before them if a page is
    wide enough; other axes are pooled. Of a method that keeps the prior's attitude both are of the direction to the
    body, its error in pixels.
    """
    posed = {estimator for _, estimator in run.posed_pairs()} - {CONTROL}
    estimators = sorted(posed, key=run.place_of)
    if len(estimators) > _MOST_METHODS:
        return
    rows, numbers, none = run.rows, trial_numbers(run), pd.Series(np.nan, index=run.rows.index)
    # Axes by their places: a name may be that of a column.
    down, across = len(grid.axes) - 2, len(grid.axes) - 1
    levels = {one.name: [one.levels[axis.name] for axis in grid.axes] for one in grid.scenarios}
    placed = rows[["scenario", "estimator"]].assign(cluster=clusters_of(run, rows))
    placed = placed.join(pd.DataFrame.from_dict(levels, orient="index"), on="scenario")
    panels = 1 if down == 0 else len(grid.axes[down - 1].levels)
    apart = down - 1 if down > 0 and panels * len(shown_levels(grid.axes[across])) <= _MOST_ACROSS else None
    pooled = [axis.label for place, axis in enumerate(grid.axes[:down]) if place != apart]
    notes = f" Pooled over {', '.join(pooled)}." if pooled else ""
    for axis in grid.axes[down:]:
        if len(shown := shown_levels(axis)) < len(axis.levels):
            notes += f" {len(shown)} of {len(axis.levels)} levels of {axis.label}."
    keeping, pixel_m = keeping_attitude(rows[rows["estimator"] != CONTROL]), _pixel_m(run)
    for estimator in estimators:
        if estimator in keeping and pixel_m is not None:
            error, what = numbers.get(SIGHT, none) / pixel_m, "error of the line of sight, px"
            nees, of_nees = rows[SIGHT_NEES] / SIGHT_DEGREES, f"NEES of the direction over {SIGHT_DEGREES}"
        else:
            error, what = numbers.get(POSE_COLUMNS[0], none), "position error, m"
            nees, of_nees = rows[NEES] / POSE_DEGREES, f"NEES over {POSE_DEGREES}"
        drawn = ((ERROR_MAP, f"median {what}", error, MEDIAN), ("map_nees", f"mean {of_nees}", nees, MEAN))
        for stem, told, values, statistic in drawn:
            own = placed.assign(value=values.where(rows["status"] == "ok"))[placed["estimator"] == estimator]
            if own["value"].isna().all():
                continue
            title, axes = f"{estimator}: {told}", (grid.axes[down], grid.axes[across])
            parts = [("", own)]
            if apart is not None:
                label = grid.axes[apart].label
                parts = [(f"{label}: {level}", own[own[apart] == level]) for level in grid.axes[apart].levels]
            maps = [_heat_map(name, part, axes, (down, across), statistic) for name, part in parts]
            over = f"over {axes[0].label} and {axes[1].label}"
            yield NamedFigure(
                file_stem(f"{stem}_{estimator}"),
                draw_heat_maps(maps, axes[0].label, axes[1].label, title),
                f"{title}, {over}, with its 95 % interval, and the trials that have it, of all.{notes}",
                f"Heat maps of {told} {over}.",
            )


def cell_text(found: Measured, trials: str) -> str:
    """Write a statistic, its interval if it has one, and the trials behind it, for a cell of a heat map."""
    ends = "" if found.low is None or found.high is None else f"\n[{number(found.low)}, {number(found.high)}]"
    return f"{number(found.value)}{ends}\n{trials}"


def _pixel_m(run: RunData) -> pd.Series | None:
    """Return what a pixel is at the range of the body in each row, m; None where scenarios cannot be read."""
    if run.specs is None:
        return None
    angles = {name: spec.camera.camera().pixel_angle_rad for name, spec in run.specs.items()}
    return run.rows["range_m"] * run.rows["scenario"].map(angles)


def _heat_map(
    title: str, own: pd.DataFrame, axes: tuple[GridAxis, GridAxis], places: tuple[int, int], statistic: Statistic
) -> HeatMap:
    rows, columns = map(shown_levels, axes)
    values, texts = np.full((len(rows), len(columns)), np.nan), [["" for _ in columns] for _ in rows]
    cells = dict(list(own.groupby(list(places), sort=False)))
    for (i, row), (j, column) in ((a, b) for a in enumerate(rows) for b in enumerate(columns)):
        cell = cells.get((row, column), own.iloc[:0])
        known = cell[cell["value"].notna()]
        (found,) = measure(known["value"].to_numpy(np.float64), known["cluster"].to_numpy(), (statistic,))
        values[i, j] = found.bar[0]
        texts[i][j] = cell_text(found, f"{len(known)}/{len(cell)}") if len(cell) else ""
    return HeatMap(title, rows, columns, values, texts)
