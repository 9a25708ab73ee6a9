"""Figures of pose errors: histograms by stage and method (Rowell et al. 2015, figures 5 and 6), cumulative shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from boresight.reports.figures.axes import mark_decades
from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PlotStyle,
    add_credits,
    beyond_text,
    grid_figure,
    mark_on_axis,
    new_figure,
    plot_styles,
    raise_top,
    shared_edges,
    step_histogram,
    styled,
)
from boresight.reports.schema.grid import shortest
from boresight.scenarios.arrays import FloatArray

_PANELS = (
    ("attitude_error_deg", "attitude error, deg", "deg", "frequency per degree"),
    ("position_error_m", "position error, m", "m", "frequency per metre"),
)


_CURVE_POINTS = 2000
_LEGEND_INSIDE = 8
_LINE_IN = 0.17
_FAR_APART = 8.0
_TICKS = 5  # labels of four decimals leave no room for more

_METHODS_INSIDE = 4
_LEGEND_TITLE = "median (share beyond the axis)"
_SHARE_TOLD = 1.0
_METHOD_PANELS = (
    ("attitude_error_deg", "attitude error, deg", "frequency per degree"),
    ("position_error_m", "position error, m", "frequency per metre"),
)


@styled
def draw_method_errors(
    groups: Mapping[str, Mapping[str, pd.DataFrame]], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw normalised histograms of the errors of methods, a row of panels for each group of them.

    Parameters
    ----------
    groups
        Title of each row to its methods: label to errors with columns ``attitude_error_deg`` and
        ``position_error_m``. All rows share their axes, and a label has the same colour in all rows.
    title
        Printed above the panels.
    credit_lines
        Credits of real images.
    """
    figure, rows = grid_figure(
        len(groups), 2, height_in=0.5 + sum(_row_height_in(len(methods)) for methods in groups.values())
    )
    drawn = plot_styles(label for methods in groups.values() for label in methods)
    for column, (name, label, frequency) in enumerate(_METHOD_PANELS):
        samples = {
            row: {method: np.asarray(errors[name].dropna(), dtype=np.float64) for method, errors in methods.items()}
            for row, methods in groups.items()
        }
        edges = _common_edges([sample for methods in samples.values() for sample in methods.values()])
        for axes, (row, methods) in zip(rows[:, column], samples.items(), strict=True):
            _draw_methods(axes, methods, drawn, edges)
            axes.set(xlabel=label, ylabel=frequency, title=row)
        top = max(axes.get_ylim()[1] for axes in rows[:, column])
        for axes in rows[:, column]:
            axes.set_ylim(0.0, top)
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _row_height_in(methods: int) -> float:
    """Return the height of a row, including space below the panels for a long legend."""
    return 2.9 if methods <= _METHODS_INSIDE else 2.9 + 0.18 * methods


def _common_edges(samples: Sequence[FloatArray]) -> FloatArray:
    """Choose bins for most methods, so that the errors of one that fails do not flatten the others."""
    ends = [float(np.percentile(sample, 99.0)) for sample in samples if len(sample)]
    return shared_edges([np.array([1.2 * float(np.median(ends))])] if ends else [], bins=60)


def _draw_methods(
    axes: Axes, methods: Mapping[str, FloatArray], drawn: Mapping[str, PlotStyle], edges: FloatArray
) -> None:
    for method, sample in methods.items():
        line = {"color": drawn[method].colour, "linestyle": drawn[method].line, "linewidth": 1.5}
        share = 100.0 * np.count_nonzero(sample > edges[-1]) / max(len(sample), 1)
        median = shortest(float(np.median(sample))) if len(sample) else "none"
        beyond = f" ({share:.0f} %)" if share >= _SHARE_TOLD else ""
        step_histogram(axes, sample, edges, label=f"{method}: {median}{beyond}", **line)
    axes.set_xlim(0.0, edges[-1])
    if len(methods) <= _METHODS_INSIDE:
        raise_top(axes, len(methods))
        legend = axes.legend(loc="upper right", title=_LEGEND_TITLE, title_fontsize=7.5, fontsize=7.5)
        legend.set_in_layout(False)
    else:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), title=_LEGEND_TITLE, title_fontsize=8.0)


@styled
def draw_pose_errors(
    stages: Mapping[str, pd.DataFrame],
    title: str,
    published: Mapping[tuple[str, str], float] | None = None,
    credit_lines: Sequence[str] = (),
) -> Figure:
    """Draw normalised histograms of attitude and position error, with the medians marked.

    Parameters
    ----------
    stages
        Label of each stage, in order, to its errors, with columns ``attitude_error_deg`` and ``position_error_m``.
        A stage with the same attitude errors as the first one is left out of the attitude panel.
    title
        Printed above the panels.
    published
        Medians that a paper prints, by (stage label, column); marked by triangles on the axis.
    credit_lines
        Credits of real images.
    """
    figure, panels = new_figure(2)
    for axes, (column, label, unit, frequency) in zip(panels, _PANELS, strict=True):
        samples = {name: _finite(errors[column]) for name, errors in stages.items()}
        if column == "attitude_error_deg":
            samples = _without_repeats(samples)
        medians = {name: v for (name, wanted), v in (published or {}).items() if wanted == column and name in samples}
        edges = shared_edges([*samples.values(), *(np.array([value]) for value in medians.values())])
        beyond = _draw_stage_histograms(axes, samples, list(stages), edges, unit)
        for name, value in medians.items():
            mark_on_axis(axes, value, _line(list(stages).index(name), len(stages))["color"])
        axes.set(xlabel=label + beyond, ylabel=frequency)
        axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _finite(values: pd.Series) -> FloatArray:
    return np.asarray(values.dropna(), dtype=np.float64)


def _without_repeats(samples: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Drop the stages whose errors are the same as those of the first."""
    first = next(iter(samples.values()))
    return {
        name: sample
        for i, (name, sample) in enumerate(samples.items())
        if i == 0 or len(sample) != len(first) or not np.allclose(sample, first)
    }


def _line(index: int, count: int) -> dict[str, Any]:
    """Return the line style of a stage: grey for the first, blue for the last, orange and green between them."""
    if index == 0:
        return {"color": GREY, "linestyle": "--", "linewidth": 1.3}
    if index == count - 1:
        return {"color": BLUE, "linestyle": "-", "linewidth": 1.7}
    return {"color": (ORANGE, GREEN)[(index - 1) % 2], "linestyle": "-.", "linewidth": 1.4}


def _draw_stage_histograms(
    axes: Axes, samples: Mapping[str, FloatArray], order: Sequence[str], edges: FloatArray, unit: str
) -> str:
    """Draw the histograms; return the note on values beyond the axis, to be added to its label."""
    beyond = 0
    for name, sample in samples.items():
        line = _line(order.index(name), len(order))
        label = f"{name} (n = {len(sample)})"
        if len(sample):
            median = float(np.median(sample))
            label = f"{name}: median {_short(median)} {unit} (n = {len(sample)})"
            axes.axvline(median, ymax=0.8, color=line["color"], linewidth=0.9, linestyle=":")
        beyond += step_histogram(axes, sample, edges, label=label, **line)
    axes.set_xlim(0, edges[-1])
    raise_top(axes, len(samples))
    axes.legend(loc="upper right")
    return beyond_text(beyond, float(edges[-1]), unit)


def _short(value: float) -> str:
    """Print three digits, without an exponent."""
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


def _thinned(ascending: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return values (m,) of a curve and its shares (m + 1,) of n, thinned to about 2000 points to keep PDFs small."""
    stride = max(1, len(ascending) // _CURVE_POINTS)
    kept = ascending[stride - 1 :: stride]
    return kept, np.append(np.arange(len(kept)) * stride, len(ascending)) / n


@styled
def draw_cumulative_errors(
    estimators: Mapping[str, tuple[pd.DataFrame, int]],
    title: str,
    credit_lines: Sequence[str] = (),
    panels: Mapping[str, str] = MappingProxyType({column: label for column, label, _, _ in _PANELS}),
    styles: Mapping[str, PlotStyle] | None = None,
) -> Figure:
    """Draw the share of all trials whose error is below the abscissa; failures lower the curve.

    Parameters
    ----------
    estimators
        Label of each estimator to its errors where it is ok, and its number of trials.
    title
        Printed above the panels.
    credit_lines
        Credits of real images.
    panels
        Columns of the errors to the labels of their axes.
    styles
        Styles of the curves by their labels; by default those of the estimators of these names.
    """
    far_apart = any(_far_apart([_finite(errors[column]) for errors, _ in estimators.values()]) for column in panels)
    below = len(estimators) > _LEGEND_INSIDE or len(panels) == 1 or far_apart
    lines = -(-len(estimators) // 2) if below else 0
    drawn = styles or plot_styles(estimators)
    figure, places = new_figure(len(panels), 3.75 * max(len(panels), 1.5), 3.4 + _LINE_IN * lines)
    for axes, (column, label) in zip(places, panels.items(), strict=True):
        samples = {name: np.sort(_finite(errors[column])) for name, (errors, _) in estimators.items()}
        limit = float(shared_edges(list(samples.values()))[-1])
        for name, sample in samples.items():
            n = estimators[name][1]
            shown, share = _thinned(sample[sample <= limit], n)
            axes.step(
                np.concatenate([[0.0], shown, [limit]]),
                np.append(share, share[-1]),
                where="post",
                color=drawn[name].colour,
                linestyle=drawn[name].line,
                linewidth=1.6,
                label=f"{name} ({len(sample)} of {n} ok)",
            )
        axes.set(xlabel=label, ylabel="share of all trials", xlim=(0, limit), ylim=(0, 1.02))
        axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
        _spread(axes, list(samples.values()), limit)
    if below:
        figure.legend(*places[-1].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    else:
        places[-1].legend(loc="lower right")
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _far_apart(samples: Sequence[FloatArray]) -> bool:
    """Whether the medians are so far apart that a linear abscissa would squeeze the best curve against the ordinate."""
    medians = [float(np.median(sample)) for sample in samples if len(sample)]
    return bool(medians) and 0.0 < _FAR_APART * min(medians) < max(medians)


def _spread(axes: Axes, samples: Sequence[FloatArray], limit: float) -> None:
    """Make the abscissa logarithmic for curves that are far apart."""
    low = min((float(np.quantile(sample, 0.02)) for sample in samples if len(sample)), default=0.0)
    if _far_apart(samples) and low > 0.0:
        axes.set(xscale="log", xlim=(low, limit))
        mark_decades(axes.xaxis)
