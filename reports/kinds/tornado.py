"""What moves a requirement: its quantile by the conditions of the trials, or by the levels of a grid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.style import BLUE, ORANGE, finish, grid_figure, styled
from boresight.reports.kinds.requirements import LEAST_TRIALS, independent_units, is_moved, required_values
from boresight.reports.run.data import GridAxis, RunData, in_order_of
from boresight.reports.schema.column import COMPONENTS, PRIOR_ERROR, names
from boresight.reports.schema.grid import NO_VALUE, Grid, number, row_grid
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.intervals import Interval, quantile_interval
from boresight.reports.statistics.requirements import Requirement
from boresight.scenarios.arrays import FloatArray

TORNADO = "tornado"
"""The stems of the figures begin with it."""
_CONDITIONS = ("range_m", "phase_deg", "latitude_deg", "time_s", *names(PRIOR_ERROR[:2]))
_POSE = ("qx", "qy", "qz", "qw"), ("tx_m", "ty_m", "tz_m")
_OF_PAIRS = ("view_deg", "sun_deg")
_QUANTILES = (0.99, 0.95, 0.9, 0.75, 0.5)
_UNSOLVED = 1e300
_NO_NUMBER = 1e150
"""Between a number and `_UNSOLVED` an end of an interval may be interpolated: it is none then."""
_WITHOUT = "; trials without an estimate count as worse than any. The widest swing comes first."
_OF_CONDITIONS = (
    "The quantile, with 95 % intervals, among the third of all trials with the least and among that with the greatest"
    f" value of a condition{_WITHOUT} The quantile is the largest one, up to the required share, that has an interval"
    " in each third. A condition that is drawn together with others shows their effect too."
)
_OF_LEVELS = (
    "The quantile, with 95 % intervals, in the level of an axis of the grid with the least and in that with the"
    f" greatest quantile{_WITHOUT} A level is of all cells of the grid that have it; where one axis is varied at a"
    " time, of the cell with the others at their first level. The quantile is the largest one, up to the required"
    " share, that has an interval in each level."
)


@dataclass(frozen=True, slots=True)
class Swing:
    """A quantile of a measure in the trials with little and with much of a condition.

    ``least`` and ``most`` print the condition in the two thirds of trials, ``low`` and ``high`` are the quantile there
    with its interval. Of an axis of a grid they are the level with the least and that with the greatest quantile.
    """

    condition: str
    least: str
    most: str
    low: tuple[float, Interval]
    high: tuple[float, Interval]

    @property
    def width(self) -> float:
        """The size of the swing."""
        return abs(self.high[0] - self.low[0])

    @property
    def bounded(self) -> bool:
        """Whether both quantiles have an interval."""
        return self.low[1][0] is not None and self.high[1][0] is not None


@dataclass(frozen=True, slots=True)
class Tornado:
    """What moves a quantile of a measure, by estimator, in a scenario or over the cells of a grid that vary it."""

    requirements: tuple[Requirement, ...]
    scenario: str
    quantile: float
    found: Mapping[str, Sequence[Swing]]

    @property
    def measure(self) -> str:
        """Measure that the requirements are on."""
        return self.requirements[0].measure


def conditions_of(run: RunData, rows: pd.DataFrame) -> dict[str, FloatArray]:
    """Return the conditions of the draw of each row (n,) by name, NaN where one is not known.

    Errors of a prior count by their size. Longitude, roll (0 with the body's z axis up) and off-pointing (of the
    boresight from the body's origin) follow from the true pose.
    """
    found = {name: rows[name].to_numpy(dtype=np.float64) for name in _CONDITIONS}
    for name, parts in COMPONENTS.items():
        errors = rows[[f"prior_{part}" for part in parts]].to_numpy(dtype=np.float64)
        found[f"prior_{name}"] = np.linalg.norm(errors, axis=1)
    posed = rows["true_qw"].notna().to_numpy()
    if posed.any():
        quat_xyzw, t_m = (rows.loc[posed, [f"true_{of}" for of in own]].to_numpy(dtype=np.float64) for own in _POSE)
        R_cam_body = Rotation.from_quat(quat_xyzw).as_matrix()
        x, y, _ = -np.einsum("nji,nj->in", R_cam_body, t_m)
        north_cam = R_cam_body[:, :, 2]
        angles_rad = {
            "longitude_deg": np.arctan2(y, x),
            "roll_deg": np.arctan2(-north_cam[:, 0], -north_cam[:, 1]),
            "off_pointing_deg": np.arctan2(np.hypot(t_m[:, 0], t_m[:, 1]), t_m[:, 2]),
        }
        for name, angle_rad in angles_rad.items():
            found[name] = np.full(len(rows), np.nan)
            found[name][posed] = np.degrees(angle_rad)
    if not (pairs := run.table("crater_matches")).empty:
        found |= {name: in_order_of(rows, pairs, [name])[name].to_numpy() for name in _OF_PAIRS}
    return found


def swings(run: RunData, values: pd.Series[float], quantile: float) -> list[Swing]:
    """Compare a quantile of the measure of some rows between thirds of the trials, the widest swing first.

    Of a grid it is compared between the levels of its axes. Empty where thirds or levels have less than `LEAST_TRIALS`
    trials, or nothing varies. A third includes all trials with the value at its end.
    """
    rows, found = run.rows.loc[values.index], list[Swing]()
    if run.manifest.grid is not None:
        axes = (_of_axis(run, axis, rows, values, quantile) for axis in run.manifest.grid.axes)
        found = [swing for swing in axes if swing is not None]
    for name, drawn in conditions_of(run, rows).items() if run.manifest.grid is None else ():
        ordered = np.sort(drawn[np.isfinite(drawn)])
        third = len(ordered) // 3
        # What prints alike does not vary.
        if third < LEAST_TRIALS or number(ordered[third - 1]) == number(ordered[-third]):
            continue
        ends = [rows[drawn <= ordered[third - 1]], rows[drawn >= ordered[-third]]]
        least, most = ((ordered[0], ordered[third - 1]), (ordered[-third], ordered[-1]))
        low, high = (_bounded(run, end, values, quantile) for end in ends)
        found.append(Swing(measure_of(name).axis, _range(least), _range(most), low, high))
    return sorted(found, key=lambda swing: -swing.width)


def _of_axis(
    run: RunData, axis: GridAxis, rows: pd.DataFrame, values: pd.Series[float], quantile: float
) -> Swing | None:
    """Compare the levels of an axis of a run's grid; None where fewer than two have trials enough."""
    design = run.manifest.grid
    if design is None:
        return None
    first = {one.name: one.levels[0] for one in design.axes if one.name != axis.name}
    cells = [
        one
        for one in design.scenarios
        if design.design != "one-at-a-time" or all(one.levels[name] == level for name, level in first.items())
    ]
    found = []
    for level in axis.levels:
        own = rows[rows["scenario"].isin([cell.name for cell in cells if cell.levels[axis.name] == level])]
        if own["trial"].nunique() >= LEAST_TRIALS:
            found.append((level, _bounded(run, own, values, quantile)))
    ordered = sorted(found, key=lambda one: one[1][0])
    if len(ordered) < 2:
        return None
    (least, low), (most, high) = ordered[0], ordered[-1]
    return Swing(axis.label, least, most, low, high)


def _bounded(run: RunData, rows: pd.DataFrame, values: pd.Series[float], quantile: float) -> tuple[float, Interval]:
    # Between two infinite values nothing can be interpolated.
    finite = np.minimum(values.loc[rows.index].to_numpy(dtype=np.float64), _UNSOLVED)
    _, codes = np.unique(independent_units(run, rows), return_inverse=True)
    value = float(np.quantile(finite, quantile, method="inverted_cdf"))
    return value, quantile_interval(finite, codes, quantile)


def tornados(run: RunData) -> Iterator[Tornado]:
    """Yield what moves each measure with a limit, for each share that is required of it and each scenario.

    Requirements on ``seconds`` are left out.
    Scenarios of a grid that vary the same one are taken together.
    """
    base = {} if run.manifest.grid is None else {one.name: one.base for one in run.manifest.grid.scenarios}
    asked: dict[tuple[str, float, str], dict[str, Requirement]] = {}
    parts: dict[tuple[str, float, str], dict[str, dict[str, pd.Series[float]]]] = {}
    for requirement, scenario, estimator, values in required_values(run):
        if is_moved(requirement):
            key = requirement.measure, requirement.share, base.get(scenario, scenario)
            asked.setdefault(key, {})[requirement.written] = requirement
            parts.setdefault(key, {}).setdefault(estimator, {})[scenario] = values.dropna()
    for (measure, share, scenario), by_estimator in parts.items():
        pooled = {estimator: pd.concat(list(own.values())) for estimator, own in by_estimator.items()}
        for quantile in dict.fromkeys((share, *(q for q in _QUANTILES if q < share), 0.5)):
            found = {estimator: swings(run, values, quantile) for estimator, values in pooled.items()}
            if all(swing.bounded for moved in found.values() for swing in moved):
                break
        found = {estimator: moved for estimator, moved in found.items() if moved}
        if found:
            yield Tornado(tuple(asked[measure, share, scenario].values()), scenario, quantile, found)


def swing_grid(run: RunData) -> Grid | None:
    """Tabulate what moves the requirements of a run; None if it has none, or too few trials."""
    rows = [
        {
            "measure": measure_of(one.measure).axis,
            "scenario": one.scenario,
            "estimator": estimator,
            "quantile": f"{100.0 * one.quantile:g} %",
            "condition": swing.condition,
            "least": swing.least,
            "there": _printed(swing.low),
            "most": swing.most,
            "then": _printed(swing.high),
        }
        for one in tornados(run)
        for estimator, moved in one.found.items()
        for swing in moved
    ]
    text = ("measure", "scenario", "estimator", "quantile", "condition")
    note = _OF_CONDITIONS if run.manifest.grid is None else _OF_LEVELS
    return row_grid("What moves the requirements", rows, text, note) if rows else None


def _range(bounds: tuple[float, float]) -> str:
    return " to ".join(map(number, bounds)) if bounds[0] < bounds[1] else number(bounds[0])


def _printed(quantile: tuple[float, Interval]) -> str:
    value, (low, high) = quantile
    return f"{_number(value)} [{_number(low)}, {_number(high)}]"


def _number(value: float | None) -> str:
    return NO_VALUE if value is None else "unsolved" if value > _NO_NUMBER else number(value)


def tornado_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw a tornado for each measure with a limit and each scenario, with a panel for each estimator."""
    of_grid = run.manifest.grid is not None
    parts, by = ("level", "quantile of each axis") if of_grid else ("third of the trials", "value of each condition")
    for place, one in enumerate(tornados(run)):
        title = f"What moves the {100.0 * one.quantile:g} % quantile of {measure_of(one.measure).label}, {one.scenario}"
        yield NamedFigure(
            file_stem(TORNADO, str(place + 1), one.measure, one.scenario),
            _draw_tornado(one, title, parts.split()[0]),
            f"{title}: in the {parts} with the least and in that with the greatest {by}, with 95 % intervals where"
            f" there are trials enough. Dashed: {'; '.join(asked.written for asked in one.requirements)}."
            " An arrow leads to more than is shown, or to trials that were not solved.",
            "Bars from one quantile to the other for each condition, the widest at the top.",
        )


@styled
def _draw_tornado(tornado: Tornado, title: str, part: str) -> Figure:
    found, limits = tornado.found, sorted({asked.limit or 0.0 for asked in tornado.requirements})
    bars = max(map(len, found.values()))
    figure, axes = grid_figure(len(found), 1, 7.5, 0.6 + (0.5 + 0.35 * bars) * len(found))
    values = [value for moved in found.values() for swing in moved for value, _ in (swing.low, swing.high)]
    most = 1.3 * max(*limits, *(value for value in values if value < _UNSOLVED), 0.0)
    for ax, (estimator, moved) in zip(axes[:, 0], found.items(), strict=True):
        for place, swing in enumerate(reversed(moved)):
            ends = (swing.low, BLUE, f"least {part}", 0.1), (swing.high, ORANGE, f"greatest {part}", -0.1)
            left, right = sorted(min(value, most) for (value, _), *_ in ends)
            ax.barh(place, right - left, left=left, height=0.5, color="0.85")
            for (value, bounds), colour, label, shift in ends:
                low, high = (most if end is None else min(end, most) for end in bounds)
                if any(end is not None for end in bounds):
                    ax.plot([0.0 if bounds[0] is None else low, high], [place + shift] * 2, color=colour, lw=1.2)
                marker = "o" if value < most else ">"
                ax.plot(
                    min(value, most), place + shift, marker, color=colour, ms=5, label=label if place == 0 else None
                )
        for limit in limits:
            ax.axvline(limit, color="0.2", lw=1.0, ls="--")
        told = [f"{one.condition}: {one.least}, {one.most}" if part == "level" else one.condition for one in moved]
        ax.set_yticks(range(len(moved)), told[::-1])
        ax.set(title=estimator, xlim=(0.0, 1.02 * most))
    axes[-1, 0].set_xlabel(measure_of(tornado.measure).axis)
    return finish(figure, title, legend=axes[0, 0])
