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

from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PlotStyle,
    beyond_text,
    finish,
    grid_figure,
    histogram_panel,
    mark_decades,
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


@styled
def draw_method_errors(
    groups: Mapping[str, Mapping[str, pd.DataFrame]], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw normalised histograms of the errors of methods, a row of panels for each group of them.

    Groups map the title of a row to its methods, and these to columns ``attitude_error_deg`` and ``position_error_m``.
    All rows share their axes, and a label has the same colour in all rows.
    """
    # A long legend stands below its panel.
    height_in = 0.5 + sum(2.9 + 0.18 * (n if n > _METHODS_INSIDE else 0) for n in map(len, groups.values()))
    figure, rows = grid_figure(len(groups), 2, height_in=height_in)
    drawn = plot_styles(label for methods in groups.values() for label in methods)
    for column, (name, label, _, frequency) in enumerate(_PANELS):
        samples = {
            row: {method: _finite(errors[name]) for method, errors in methods.items()}
            for row, methods in groups.items()
        }
        # Bins for most methods: the errors of one that fails must not flatten the others.
        every = [sample for methods in samples.values() for sample in methods.values() if len(sample)]
        middle = 1.2 * float(np.median([np.percentile(sample, 99.0) for sample in every])) if every else None
        edges = shared_edges([] if middle is None else [np.array([middle])], bins=60)
        for axes, (row, methods) in zip(rows[:, column], samples.items(), strict=True):
            _draw_methods(axes, methods, drawn, edges)
            axes.set(xlabel=label, ylabel=frequency, title=row)
        top = max(axes.get_ylim()[1] for axes in rows[:, column])
        for axes in rows[:, column]:
            axes.set_ylim(0.0, top)
    return finish(figure, title, credit_lines)


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

    ``stages`` maps the label of each stage, in order, to columns ``attitude_error_deg`` and ``position_error_m``; a
    stage with the same attitude errors as the first one is left out of the attitude panel. ``published`` are medians
    that a paper prints, by (stage label, column): triangles on the axis.
    """
    figure, panels = new_figure(2)
    for axes, (column, label, unit, frequency) in zip(panels, _PANELS, strict=True):
        samples = {name: _finite(errors[column]) for name, errors in stages.items()}
        first = next(iter(samples.values()))
        if column == "attitude_error_deg":
            samples = {
                name: sample
                for i, (name, sample) in enumerate(samples.items())
                if i == 0 or len(sample) != len(first) or not np.allclose(sample, first)
            }
        medians = {name: v for (name, wanted), v in (published or {}).items() if wanted == column and name in samples}
        edges = shared_edges([*samples.values(), *(np.array([value]) for value in medians.values())])
        lines = {name: _line(list(stages).index(name), len(stages)) for name in samples}
        labelled = {_stage_label(name, sample, unit): sample for name, sample in samples.items()}
        beyond = histogram_panel(axes, labelled, list(lines.values()), edges, 0.8)
        for name, value in medians.items():
            mark_on_axis(axes, value, lines[name]["color"])
        axes.set(xlabel=label + beyond_text(beyond, float(edges[-1]), unit), ylabel=frequency)
        axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
    return finish(figure, title, credit_lines)


def _finite(values: pd.Series) -> FloatArray:
    return np.asarray(values.dropna(), dtype=np.float64)


def _line(index: int, count: int) -> dict[str, Any]:
    """Return the line style of a stage: grey for the first, blue for the last, orange and green between them."""
    if index == 0:
        return {"color": GREY, "linestyle": "--", "linewidth": 1.3}
    if index == count - 1:
        return {"color": BLUE, "linestyle": "-", "linewidth": 1.7}
    return {"color": (ORANGE, GREEN)[(index - 1) % 2], "linestyle": "-.", "linewidth": 1.4}


def _stage_label(name: str, sample: FloatArray, unit: str) -> str:
    if not len(sample):
        return f"{name} (n = 0)"
    median = float(np.median(sample))
    digits = f"{median:.3g}" if median < 1000.0 else f"{median:.0f}"  # without an exponent
    return f"{name}: median {digits} {unit} (n = {len(sample)})"


@styled
def draw_cumulative_errors(
    estimators: Mapping[str, tuple[pd.DataFrame, int]],
    title: str,
    credit_lines: Sequence[str] = (),
    panels: Mapping[str, str] = MappingProxyType({column: label for column, label, _, _ in _PANELS}),
    styles: Mapping[str, PlotStyle] | None = None,
) -> Figure:
    """Draw the share of all trials whose error is below the abscissa; failures lower the curve.

    Each estimator has its errors where it is ok, and its number of trials. ``panels`` maps columns of the errors to the
    labels of their axes; without ``styles`` curves have those of the estimators of their names.
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
            # Thinned to about 2000 points, to keep PDFs small.
            n, inside = estimators[name][1], sample[sample <= limit]
            stride = max(1, len(inside) // _CURVE_POINTS)
            shown = inside[stride - 1 :: stride]
            share = np.concatenate([np.arange(len(shown)) * stride, [len(inside)] * 2]) / n
            axes.step(
                np.concatenate([[0.0], shown, [limit]]), share, where="post", color=drawn[name].colour,
                linestyle=drawn[name].line, linewidth=1.6, label=f"{name} ({len(sample)} of {n} ok)",
            )  # fmt: skip
        axes.set(xlabel=label, ylabel="share of all trials", xlim=(0, limit), ylim=(0, 1.02))
        axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
        low = min((float(np.quantile(sample, 0.02)) for sample in samples.values() if len(sample)), default=0.0)
        if _far_apart(list(samples.values())) and low > 0.0:
            axes.set(xscale="log", xlim=(low, limit))
            mark_decades(axes.xaxis)
    if below:
        figure.legend(*places[-1].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    else:
        places[-1].legend(loc="lower right")
    return finish(figure, title, credit_lines)


def _far_apart(samples: Sequence[FloatArray]) -> bool:
    """Whether the medians are so far apart that a linear abscissa would squeeze the best curve against the ordinate."""
    medians = [float(np.median(sample)) for sample in samples if len(sample)]
    return bool(medians) and 0.0 < _FAR_APART * min(medians) < max(medians)
