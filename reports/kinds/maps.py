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
from boresight.reports.statistics.measured import MEAN, MEDIAN, Statistic, measure
from boresight.scenarios.spec.camera import CameraSpec

_MOST_PANELS = 4
_MOST_METHODS = 6  # with two figures each


def level_maps(run: RunData, grid: ScenarioGrid) -> Iterator[NamedFigure]:
    """Draw median error and mean NEES of each estimator of poses over the last two axes of a grid.

    Of more than six estimators there are none. There is a panel for each level of the axis before them if these are
    few; other axes are pooled. Of a method that keeps the prior's attitude both are of the direction to the body, its
    error in pixels.
    """
    estimators = [label for label in run.manifest.estimators if label != CONTROL]
    if len(estimators) > _MOST_METHODS:
        return
    rows, numbers = run.rows, trial_numbers(run)
    *others, down, across = grid.axes
    apart = others[-1] if others and len(others[-1].levels) <= _MOST_PANELS else None
    pooled = [axis.label for axis in others if axis is not apart]
    over = f" Pooled over {', '.join(pooled)}." if pooled else ""
    levels = pd.DataFrame.from_dict({one.name: one.levels for one in grid.scenarios}, orient="index")
    placed = rows[["scenario", "estimator"]].join(levels, on="scenario").assign(cluster=clusters_of(run, rows))
    ok = rows["status"] == "ok"
    keeping = keeping_attitude(rows[rows["estimator"] != CONTROL])
    for estimator in estimators:
        if estimator in keeping:
            error, what = numbers[SIGHT] / _pixel_m(run), "error of the line of sight, px"
            nees, of_nees = rows[SIGHT_NEES] / SIGHT_DEGREES, f"NEES of the direction over {SIGHT_DEGREES}"
        else:
            error, what = numbers[POSE_COLUMNS[0]], "position error, m"
            nees, of_nees = rows[NEES] / POSE_DEGREES, f"NEES over {POSE_DEGREES}"
        drawn = (("error", f"median {what}", error, MEDIAN), ("nees", f"mean {of_nees}", nees, MEAN))
        for kind, told, values, statistic in drawn:
            own = placed.assign(value=values.where(ok))[placed["estimator"] == estimator]
            title = f"{estimator}: {told}"
            maps = [
                _heat_map(title_of, part, down, across, statistic)
                for title_of, part in ([("", own)] if apart is None else _parts(own, apart))
            ]
            yield NamedFigure(
                file_stem(f"map_{kind}_{estimator}"),
                draw_heat_maps(maps, down.label, across.label, title),
                f"{title}, over {down.label} and {across.label}, with its 95 % interval, and the trials that have it,"
                f" of all.{over}",
                f"Heat maps of {told} over {down.label} and {across.label}.",
            )


def _pixel_m(run: RunData) -> pd.Series:
    """Return what a pixel is at the range of the body in each row, m."""
    angles = {
        name: CameraSpec.model_validate(scenario["camera"]).camera().pixel_angle_rad
        for name, scenario in run.manifest.scenarios.items()
    }
    return run.rows["range_m"] * run.rows["scenario"].map(angles)


def _parts(own: pd.DataFrame, apart: GridAxis) -> list[tuple[str, pd.DataFrame]]:
    return [(f"{apart.label}: {level}", own[own[apart.name] == level]) for level in apart.levels]


def _heat_map(title: str, own: pd.DataFrame, down: GridAxis, across: GridAxis, statistic: Statistic) -> HeatMap:
    rows, columns = shown_levels(down), shown_levels(across)
    values, texts = np.full((len(rows), len(columns)), np.nan), [["" for _ in columns] for _ in rows]
    cells = dict(list(own.groupby([down.name, across.name], sort=False)))
    for (i, row), (j, column) in ((a, b) for a in enumerate(rows) for b in enumerate(columns)):
        cell = cells.get((row, column), own.iloc[:0])
        known = cell[cell["value"].notna()]
        (found,) = measure(known["value"].to_numpy(np.float64), known["cluster"].to_numpy(), (statistic,))
        values[i, j] = found.bar[0]
        ends = "" if found.low is None or found.high is None else f"\n[{number(found.low)}, {number(found.high)}]"
        texts[i][j] = f"{number(found.value)}{ends}\n{len(known)}/{len(cell)}" if len(cell) else ""
    return HeatMap(title, rows, columns, values, texts)
