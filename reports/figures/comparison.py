"""Figures that compare methods (conditions, coverage of covariances, costs, ROC curves) and scenarios of a grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import BboxBase
from scipy.special import chdtr

from boresight.reports.figures.style import (
    BLUE,
    GREY,
    PlotStyle,
    Points,
    draw_points,
    finish,
    grid_figure,
    mark_decades,
    new_figure,
    plot_styles,
    styled,
)
from boresight.reports.statistics.consistency import NormalisedErrors
from boresight.reports.statistics.measured import Measured
from boresight.reports.statistics.roc import OutlierScore, area, roc_curve
from boresight.scenarios.arrays import FloatArray

Panels = Mapping[tuple[str, str], Mapping[str, Points]]
"""Label of the error and label of the condition to the curves of a panel, by their labels."""

_POINTS = np.linspace(0.0, 1.0, 201)
_MOST_CURVES = 5
"""Largest number of curves in a panel that can still be distinguished."""
_ERRORS = (("position_error_m", "position error, m"), ("attitude_error_deg", "attitude error, deg"))
_PANELS_A_ROW = 3

_MARK_PT = 6.0
_LABEL_PLACES = tuple((x, y * side) for y in (3.0, 11.0, 19.0, 27.0, 35.0) for side in (1.0, -1.0) for x in (5.0, -5.0))
"""Where the label of a mark is put, in points from the mark: the first that covers nothing."""
_MOST_LABELS = 100  # of a panel, which is full of them

_TICKS = (0.01, 0.03, 0.1, 0.2, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)
_FEW_TICKS = (0.01, 0.1, 1.0, 10.0, 100.0)
_WIDE = 30.0
_MOST = 100.0


@styled
def draw_coverage(
    curves: Mapping[str, NormalisedErrors],
    styles: Mapping[str, PlotStyle],
    title: str,
    credit_lines: Sequence[str] = (),
) -> Figure:
    """Draw the share of trials within each quantile of the chi-square distribution that the covariance claims.

    The tables of the errors have a ``cluster`` too: the grey band is the binomial 95 % interval for the fewest clusters
    among them.
    """
    # Imported here, as it takes 1 s and few figures need it.
    from scipy.stats import binom

    figure, (axes,) = new_figure(1, width_in=4.6, height_in=4.4 + 0.17 * len(curves))
    fewest = min(errors.table["cluster"].nunique() for errors in curves.values())
    low, high = (binom.ppf(tail, fewest, _POINTS) / fewest for tail in (0.025, 0.975))
    axes.fill_between(_POINTS, low, high, color=GREY, alpha=0.2, linewidth=0)
    axes.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linewidth=0.9)
    for name, errors in curves.items():
        ratios, degrees = (errors.table[column].to_numpy(dtype=np.float64) for column in ("ratio", "degrees"))
        reached = np.sort(chdtr(degrees, ratios * degrees / errors.expected))
        share = np.searchsorted(reached, _POINTS, side="right") / len(reached)
        label, style = f"{name} (n = {len(reached)})", styles[name]
        axes.plot(_POINTS, share, color=style.colour, linestyle=style.line, label=label)
    axes.set(xlabel="share claimed by the covariance", ylabel="share of trials within", xlim=(0, 1), ylim=(0, 1.005))
    axes.set_aspect("equal", adjustable="box")
    figure.legend(loc="outside lower center", ncols=1, fontsize=7.5)
    return finish(figure, title, credit_lines)


@styled
def draw_binned_errors(
    panels: Panels, styles: Mapping[str, PlotStyle], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw errors and success rates in bins of a condition, with their intervals.

    There is a panel for every pair of error and condition. A label that ends in % has a linear ordinate, any other a
    logarithmic one. ``styles`` has the curves in the order of the legend.
    """
    errors, conditions = (list(dict.fromkeys(key[i] for key in panels)) for i in (0, 1))
    size = {"width_in": max(4.5, 0.4 + 2.35 * len(conditions)), "height_in": 1.1 + 1.75 * len(errors)}
    figure, places = grid_figure(len(errors), len(conditions), **size)
    for row, error in zip(places, errors, strict=True):
        for axes, condition in zip(row, conditions, strict=True):
            for label, points in panels[error, condition].items():
                draw_points(axes, points, styles[label], linewidth=1.2, elinewidth=0.9)
        _share_ordinate(list(row), error)
    for axes, condition in zip(places[-1], conditions, strict=True):
        axes.set_xlabel(condition)
    handles = [
        Line2D([], [], marker="o", markersize=3, color=one.colour, linestyle=one.line) for one in styles.values()
    ]
    figure.legend(handles, list(styles), loc="outside lower center", ncols=min(4, len(styles)))
    return finish(figure, title, credit_lines)


def _share_ordinate(row: Sequence[Axes], error: str) -> None:
    """Give the panels of a row the same limits; only the first is labelled."""
    low = min(axes.dataLim.y0 for axes in row)
    high = max(axes.dataLim.y1 for axes in row)
    for axes in row:
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        if not np.isfinite([low, high]).all():
            pass  # No panel of the row has a point: there are too few trials for one bin.
        elif error.endswith("%"):
            axes.set_ylim(max(low - 0.06 * (high - low) - 0.5, -2.0), 102.0)
        elif low > 0.0:
            axes.set_yscale("log")
            axes.set_ylim(low / 1.15, high * 1.15)
            mark_decades(axes.yaxis)
        if axes is not row[0]:
            axes.tick_params(labelleft=False)
    row[0].set_ylabel(error)


@dataclass(frozen=True, slots=True)
class Traded:
    """A mark of a trade-off: median errors by measure and costs by label; ``off`` the front it is drawn open."""

    estimator: str
    errors: Mapping[str, Measured]
    costs: Mapping[str, float]
    off: bool = False
    note: str = ""


@styled
def draw_trade_off(
    points: Sequence[Traded],
    labels: Mapping[str, str],
    prior: Mapping[str, float],
    title: str,
    credit_lines: Sequence[str] = (),
) -> Figure:
    """Draw errors (rows) against costs (columns), all axes but those of shares logarithmic.

    ``labels`` are of the errors' axes, by measure, ``prior`` that error of the prior. A cost that no point has is left
    out.
    """
    costs = list(dict.fromkeys(cost for point in points for cost in point.costs)) or [""]
    figure, places = grid_figure(len(labels), len(costs), max(6.5, 3.75 * len(costs)), 1.2 + 2.3 * len(labels))
    drawn = plot_styles(point.estimator for point in points)
    for row, (name, label) in zip(places, labels.items(), strict=True):
        for axes, cost in zip(row, costs, strict=True):
            for point in points:
                _draw_traded(axes, point, name, cost, drawn[point.estimator])
            if name in prior:
                axes.axhline(prior[name], color=GREY, linestyle="--", linewidth=1.0, label="prior")
            axes.set(xlabel=cost, ylabel=label, xscale="log", yscale="linear" if label.endswith("%") else "log")
            axes.margins(0.15)
            axes.autoscale_view()
            for axis in (axes.xaxis, axes.yaxis)[: 1 if label.endswith("%") else 2]:
                mark_decades(axis)
        for axes in row[1:]:
            axes.sharey(row[0])
    finish(figure, title, credit_lines)
    handles = dict(zip(*reversed(places[0, 0].get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=min(3, max(1, len(handles))))
    if any(point.note for point in points):
        figure.draw_without_rendering()  # which settles where the marks are
        for row in places:
            for axes in row:
                _part_labels(axes, figure.dpi)
    return figure


def _part_labels(axes: Axes, dpi: float) -> None:
    """Move the labels of marks to where they cover neither marks nor labels, or as little of them as possible.

    Where there are too many, they stay.
    """
    notes = [child for child in axes.get_children() if isinstance(child, Annotation)]
    if len(notes) > _MOST_LABELS:
        return
    half = _MARK_PT / 2.0 * dpi / 72.0
    drawn = [axes.transData.transform(bars[0].get_xydata()) for bars in axes.containers]
    taken = [np.concatenate([mark - half, mark + half]) for marks in drawn for mark in marks]
    # Those on the right first: the labels to the left of them keep clear of their marks.
    for note in sorted(notes, key=lambda one: -one.xy[0]):
        found: dict[tuple[float, float], float] = {}
        for place in _LABEL_PLACES:
            _put(note, place)
            box = note.get_window_extent()
            outside = box.width * box.height - _covered(box, [np.ravel(axes.bbox.extents)])
            found[place] = outside + _covered(box, taken)
            if found[place] <= 0.0:
                break
        _put(note, min(found, key=lambda place: found[place]))
        taken.append(np.ravel(note.get_window_extent().extents))


def _put(note: Annotation, place: tuple[float, float]) -> None:
    note.set(position=place, ha="left" if place[0] > 0.0 else "right", va="bottom" if place[1] > 0.0 else "top")


def _covered(box: BboxBase, others: Sequence[FloatArray]) -> float:
    """Return the area that a box shares with others, (4,) left, lower, right and upper ends, px^2, summed."""
    each = np.array(others)
    shared = np.minimum(box.extents[2:], each[:, 2:]) - np.maximum(box.extents[:2], each[:, :2])
    return float(np.maximum(shared, 0.0).prod(axis=1).sum())


def _draw_traded(axes: Axes, point: Traded, name: str, cost: str, style: PlotStyle) -> None:
    error = point.errors[name]
    if cost not in point.costs or error.value is None:
        return
    known = error.low is not None and error.high is not None
    reach = [[error.value - (error.low or 0.0)], [(error.high or 0.0) - error.value]] if known else None
    axes.errorbar(
        [point.costs[cost]], [error.value], yerr=reach, color=style.colour, marker=style.marker, markersize=_MARK_PT,
        markerfacecolor="none" if point.off else style.colour, linestyle="none", capsize=3, label=point.estimator,
    )  # fmt: skip
    if point.note:
        at = (point.costs[cost], error.value)
        axes.annotate(
            point.note, at, _LABEL_PLACES[0], textcoords="offset points", fontsize=6.0, color=style.colour
        ).set_in_layout(False)


@styled
def draw_roc(panels: Mapping[str, Sequence[OutlierScore]], title: str, credit_lines: Sequence[str] = ()) -> Figure:
    """Draw a panel of curves for each definition of a bad solution: the scores whose area is farthest from chance."""
    figure, axes = new_figure(len(panels), width_in=3.9 * max(1, len(panels)), height_in=4.2)
    curves = {
        definition: sorted(
            ((f"{one.name}{' (low)' * one.low_is_bad}", area(one.rising, one.bad), one) for one in scores),
            key=lambda curve: -curve[1],
        )[:_MOST_CURVES]
        for definition, scores in panels.items()
    }
    # A score has the same style in all panels.
    drawn = plot_styles(name for own in curves.values() for name, _, _ in own)
    for place, (definition, own) in zip(axes, curves.items(), strict=True):
        place.plot([0, 1], [0, 1], color=GREY, linewidth=0.9, linestyle=":")
        for name, below, one in own:
            (x, y, _), style = roc_curve(one.rising, one.bad), drawn[name]
            label = f"{name}: AUC {below:.2f}"
            place.plot(x, y, color=style.colour, linestyle=style.line, linewidth=1.4, label=label)
        place.set(xlabel="good solutions flagged", ylabel="bad solutions flagged", xlim=(0, 1), ylim=(0, 1.01))
        place.set_box_aspect(1)
        place.legend(loc="lower right")
        place.set_title(f"bad: {definition}")
    return finish(figure, title, credit_lines)


@dataclass(frozen=True, slots=True, eq=False)
class HeatMap:
    """A heat map: (R, C) values, NaN where there is none, and the text of each cell."""

    title: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    values: FloatArray
    texts: Sequence[Sequence[str]]


@styled
def draw_heat_maps(matrices: Sequence[HeatMap], rows_label: str, columns_label: str, title: str) -> Figure:
    """Draw heat maps side by side, each with its own colour scale from 0."""
    down, across = matrices[0].values.shape
    figure, panels = new_figure(len(matrices), 1.3 + len(matrices) * (0.5 + 0.85 * across), 1.5 + 0.62 * down)
    for axes, matrix in zip(panels, matrices, strict=True):
        finite = matrix.values[np.isfinite(matrix.values)]
        high = float(finite.max()) if len(finite) else 1.0
        # The scale begins at 0, so that values that differ little have similar colours.
        axes.imshow(matrix.values, cmap="Blues", vmin=0.0, vmax=1.1 * high or 1.0, aspect="auto")
        for (i, j), value in np.ndenumerate(matrix.values):
            colour = "white" if np.isfinite(value) and value > 0.6 * high else "black"
            axes.text(j, i, matrix.texts[i][j], ha="center", va="center", fontsize=6.5, color=colour)
        axes.set_xticks(range(across), matrix.columns, rotation=20, ha="right")
        axes.set_yticks(range(down), matrix.rows)
        axes.grid(visible=False)
        axes.set(title=matrix.title, xlabel=columns_label)
    for axes in panels[1:]:
        axes.set_yticklabels([])
    panels[0].set_ylabel(rows_label)
    return finish(figure, title)


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of a level as a factor, with the bounds of its interval (NaN without one) and a note to print."""

    label: str
    value: float
    low: float
    high: float
    note: str = ""


@styled
def draw_effects(panels: Mapping[str, Sequence[Effect]], title: str) -> Figure:
    """Draw a panel of effects for each outcome, on one logarithmic scale about 1; arrows are factors beyond it."""
    # The limits contain all factors up to 100, and are so wide that small effects look small.
    factors = [x for effects in panels.values() for one in effects for x in (one.value, one.low, one.high)]
    known = [x for x in factors if np.isfinite(x)]
    bounds = min([0.7, *(x / 1.05 for x in known)]), min(max([1.4, *(x * 1.05 for x in known)]), _MOST)
    most = max(len(effects) for effects in panels.values())
    figure, places = new_figure(len(panels), 3.2 + 2.2 * len(panels), 1.2 + 0.3 * most)
    for axes, (outcome, effects) in zip(places, panels.items(), strict=True):
        for line, effect in enumerate(effects):
            axes.plot([effect.low, effect.high], [line, line], color=BLUE, linewidth=1.4)
            marker = ">" if effect.value > _MOST else "o"
            axes.plot([min(effect.value, _MOST)], [line], color=BLUE, marker=marker, markersize=4, clip_on=False)
            axes.text(1.02, line, effect.note, transform=axes.get_yaxis_transform(), fontsize=6, va="center")
        axes.axvline(1.0, color=GREY, linewidth=0.9, linestyle="--")
        axes.set_xscale("log")
        axes.set_xlim(*bounds)
        choice = _FEW_TICKS if bounds[1] > _WIDE * bounds[0] else _TICKS
        ticks = [tick for tick in choice if axes.get_xlim()[0] <= tick <= axes.get_xlim()[1]]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_ylim(most - 0.5, -0.5)
        axes.set_yticks(range(len(effects)), [effect.label for effect in effects])
        axes.set_title(outcome, fontsize=8)
        axes.set_xlabel("factor")
    for axes in places[1:]:
        axes.set_yticklabels([])
    return finish(figure, title)


@styled
def draw_curves(panels: Sequence[tuple[str, Mapping[str, Points]]], ordinate: str, title: str) -> Figure:
    """Draw panels in rows of three with one logarithmic ordinate: the same curves over different abscissae."""
    across = min(_PANELS_A_ROW, len(panels))
    down = -(-len(panels) // across)
    figure = Figure(figsize=(2.6 * across + 0.4, 2.2 * down + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    places = list(figure.subplots(down, across, squeeze=False, sharey=True).ravel())
    drawn = plot_styles(panels[0][1])
    for axes, (abscissa, lines) in zip(places, panels, strict=False):
        for label, points in lines.items():
            order = np.argsort(points.x)
            ascending = Points(points.x[order], points.y[order], points.low_high[order])
            draw_points(axes, ascending, drawn[label], linewidth=1.3, elinewidth=0.9, label=label)
        axes.set(xlabel=abscissa, yscale="log")
        _scale_abscissa(axes, np.unique(np.concatenate([points.x for points in lines.values()])))
    mark_decades(places[0].yaxis)
    for axes in places[len(panels) :]:
        axes.set_axis_off()
    figure.supylabel(ordinate, fontsize=9)
    return finish(figure, title, legend=places[0], columns=len(drawn))


def _scale_abscissa(axes: Axes, ticks: FloatArray) -> None:
    """Label the abscissa at the values; logarithmic where they span a factor of 8, with a linear part if 0 is one."""
    positive = ticks[ticks > 0]
    if np.all(ticks >= 0) and len(positive) and positive.max() >= 8 * positive.min():
        if ticks[0] > 0:
            axes.set_xscale("log")
        else:
            axes.set_xscale("symlog", linthresh=float(positive.min()), linscale=0.5)
    if axes.get_xscale() == "linear":
        margin = 0.06 * float(np.ptp(ticks))
        axes.set_xlim(ticks[0] - margin, ticks[-1] + margin)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
