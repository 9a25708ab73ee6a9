"""Figures that compare methods: errors and success, conditions, coverage of covariances, costs, ROC curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.special import chdtr

from boresight.reports.figures.style import (
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
from boresight.reports.statistics.measured import Measured, percent
from boresight.scenarios.arrays import FloatArray

Panels = Mapping[tuple[str, str], Mapping[str, Points]]
"""Label of the error and label of the condition to the curves of a panel, by their labels."""

_POINTS = np.linspace(0.0, 1.0, 201)

_LINE_IN = 0.32
_MARKS = (("RMS", "D"), ("75th", "|"), ("95th", "|"), ("99th", "|"))
MOST_CURVES = 5
"""Largest number of curves in a panel that can still be distinguished."""
_ERRORS = (("position_error_m", "position error, m"), ("attitude_error_deg", "attitude error, deg"))


@dataclass(frozen=True, slots=True)
class SubjectSummary:
    """Errors and success rate of one subject of a comparison, a line of the figure.

    Parameters
    ----------
    label, colour
        Label on the ordinate; colour of the marks.
    solved, counted
        Median, RMS and the 75th, 95th and 99th percentiles over the solved trials, and over all trials with failures
        counted.
    success
        Success rate; None for a control.
    difference
        Median difference to the reference subject; None where there is no reference.
    """

    label: str
    colour: str
    solved: Sequence[Measured]
    counted: Sequence[Measured]
    success: Measured | None
    difference: Measured | None


@styled
def draw_summaries(
    summaries: Sequence[SubjectSummary], axis: str, against: str, title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw errors, success rates and differences, a line for each subject.

    Parameters
    ----------
    summaries
        The subjects, from top to bottom.
    axis
        Name of the error, with its unit.
    against
        Name of the reference of the differences; '' where there are none.
    """
    shown = [True, any(one.success for one in summaries), any(one.difference for one in summaries)]
    widths = [width for width, there in zip((2.2, 1.0, 1.4), shown, strict=True) if there]
    height_in = 1.75 + _LINE_IN * len(summaries)
    figure, places = grid_figure(1, 1, width_in=7.5 + 1.2 * shown[2], height_in=height_in)
    places[0, 0].remove()
    panels = list(figure.subplots(1, len(widths), squeeze=False, sharey=True, width_ratios=widths)[0])
    _draw_errors(panels[0], summaries, axis)
    if shown[1]:
        _draw_success(panels[1], summaries)
    if shown[2]:
        _draw_differences(panels[-1], summaries, axis, against)
    panels[0].set_yticks(range(len(summaries)), [one.label for one in summaries])
    panels[0].set_ylim(len(summaries) - 0.4, -0.6)
    return finish(figure, title, credit_lines, legend=panels[0])


def _draw_errors(axes: Axes, summaries: Sequence[SubjectSummary], axis: str) -> None:
    for row, one in enumerate(summaries):
        median, *further = one.solved
        _draw_interval(axes, row, median, one.colour)
        for (name, marker), measured in zip(_MARKS, further, strict=True):
            if measured.value is not None:
                size = 4 if marker == "D" else 7 + 3 * (name == "95th") + 6 * (name == "99th")
                axes.plot(measured.value, row, marker, color=one.colour, markersize=size, markerfacecolor="white")
        counted = one.counted[0].value
        if counted is not None and np.isfinite(counted) and counted != median.value:
            axes.plot(counted, row, "o", color=one.colour, markersize=7, markerfacecolor="none")
    # The marks are explained in grey, as the colour is that of the subject.
    marks = {"o": "median, 95 % interval", "D": "RMS", "|": "75th, 95th, 99th percentile"}
    for marker, label in marks.items():
        axes.plot([], [], marker, color=GREY, label=label, markerfacecolor="white" if marker == "D" else GREY)
    axes.plot([], [], "o", color=GREY, markerfacecolor="none", markersize=7, label="median, failures counted")
    axes.set_xlabel(axis)
    if axes.dataLim.x0 <= 0.0:  # Zero has no place on a logarithmic axis.
        return
    axes.set_xscale("log")
    mark_decades(axes.xaxis)


def _draw_interval(axes: Axes, row: int, measured: Measured, colour: str) -> None:
    """Draw a value as a point and its interval as a thick bar."""
    if measured.value is None:
        return
    if measured.low is not None and measured.high is not None:
        axes.hlines(row, measured.low, measured.high, color=colour, linewidth=4.0, alpha=0.45)
    axes.plot(measured.value, row, "o", color=colour, markersize=5)


def _draw_success(axes: Axes, summaries: Sequence[SubjectSummary]) -> None:
    for row, one in enumerate(summaries):
        if one.success is not None:
            _draw_interval(axes, row, percent(one.success), one.colour)
    low, high = axes.get_xlim()
    axes.set_xlim(max(low, 0.0), min(high, 101.0))
    axes.set_xlabel("success, %")


def _draw_differences(axes: Axes, summaries: Sequence[SubjectSummary], axis: str, against: str) -> None:
    axes.axvline(0.0, color=GREY, linewidth=1.0)
    for row, one in enumerate(summaries):
        if one.difference is not None:
            _draw_interval(axes, row, one.difference, one.colour)
    low, high = axes.get_xlim()
    edge = 0.06 * (max(high, 0.0) - min(low, 0.0))
    axes.set_xlim(min(low, -edge), max(high, edge))
    unit = axis.rsplit(", ", 1)[-1] if ", " in axis else ""
    axes.set_xlabel(f"median difference to\n{against}{f', {unit}' if unit else ''}")


@dataclass(frozen=True, slots=True, eq=False)
class CoverageCurve:
    """Normalised squared errors of one subject, for a curve of coverage.

    Parameters
    ----------
    label, style
        Label and style of the curve.
    squares, degrees
        (n,) squared errors normalised by the covariance, and their degrees of freedom.
    independent
        How many of the n values are independent.
    """

    label: str
    style: PlotStyle
    squares: FloatArray
    degrees: FloatArray
    independent: int


@styled
def draw_coverage(curves: Sequence[CoverageCurve], title: str, credit_lines: Sequence[str] = ()) -> Figure:
    """Draw the share of trials within each quantile of the chi-square distribution that the covariance claims.

    Parameters
    ----------
    curves
        The curves. The grey band is the binomial 95 % interval for the fewest independent trials among them.
    """
    # Imported here, as it takes 1 s and few figures need it.
    from scipy.stats import binom

    figure, (axes,) = new_figure(1, width_in=4.6, height_in=4.4 + 0.17 * len(curves))
    fewest = min(curve.independent for curve in curves)
    low, high = (binom.ppf(tail, fewest, _POINTS) / fewest for tail in (0.025, 0.975))
    axes.fill_between(_POINTS, low, high, color=GREY, alpha=0.2, linewidth=0)
    axes.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linewidth=0.9)
    for curve in curves:
        reached = np.sort(chdtr(curve.degrees, curve.squares))
        share = np.searchsorted(reached, _POINTS, side="right") / len(reached)
        axes.plot(_POINTS, share, color=curve.style.colour, linestyle=curve.style.line, label=curve.label)
    axes.set(xlabel="share claimed by the covariance", ylabel="share of trials within", xlim=(0, 1), ylim=(0, 1.005))
    axes.set_aspect("equal", adjustable="box")
    figure.legend(loc="outside lower center", ncols=1, fontsize=7.5)
    return finish(figure, title, credit_lines)


@styled
def draw_binned_errors(
    panels: Panels, styles: Mapping[str, PlotStyle], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw errors and success rates in bins of a condition, with their intervals.

    Parameters
    ----------
    panels
        Curves of every pair of error and condition. A label that ends in % has a linear ordinate, any other a
        logarithmic one.
    styles
        Label of each curve to its style, in the order of the legend.
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
class TradeOffPoint:
    """Accuracy and costs of one method.

    Parameters
    ----------
    errors
        Median errors with their intervals, by ``position_error_m`` and ``attitude_error_deg``.
    seconds
        Time per image; None if unknown.
    size_bytes
        Size of its data base; None if it has none.
    """

    errors: Mapping[str, Measured]
    seconds: float | None
    size_bytes: int | None


@styled
def draw_trade_off(
    points: Mapping[str, TradeOffPoint], prior: Mapping[str, float], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw position and attitude errors (rows) against time and size (columns), all axes logarithmic.

    Parameters
    ----------
    points
        Methods by label.
    prior
        Median errors of the prior, by the names of `TradeOffPoint.errors`.
    """
    figure, places = grid_figure(2, 2, height_in=5.6)
    for row, (name, label) in zip(places, _ERRORS, strict=True):
        times = {key: 1e3 * point.seconds for key, point in points.items() if point.seconds is not None}
        sizes = {key: 1e-3 * point.size_bytes for key, point in points.items() if point.size_bytes is not None}
        for axes, costs, abscissa in zip(row, (times, sizes), ("time an image, ms", "data base, kB"), strict=True):
            _draw_methods(axes, {key: point.errors[name] for key, point in points.items()}, costs)
            axes.axhline(prior[name], color=GREY, linestyle="--", linewidth=1.0, label="prior")
            axes.set(xlabel=abscissa, ylabel=label, xscale="log", yscale="log")
            axes.margins(0.15)
            axes.autoscale_view()
            for axis in (axes.xaxis, axes.yaxis):
                mark_decades(axis)
        row[1].sharey(row[0])
    return finish(figure, title, credit_lines, legend=places[0, 0])


def _draw_methods(axes: Axes, errors: Mapping[str, Measured], costs: Mapping[str, float]) -> None:
    drawn = plot_styles(errors)
    for label, error in errors.items():
        if label not in costs or error.value is None:
            continue
        known = error.low is not None and error.high is not None
        reach = [[error.value - (error.low or 0.0)], [(error.high or 0.0) - error.value]] if known else None
        axes.errorbar(
            [costs[label]], [error.value], yerr=reach, color=drawn[label].colour, marker=drawn[label].marker,
            markersize=6, linestyle="none", capsize=3, label=label,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class RocCurve:
    """ROC curve of one score: its name, (m,) ascending false and true positive rates, and the area below it (AUC)."""

    name: str
    false_positives: FloatArray
    true_positives: FloatArray
    area: float


@styled
def draw_roc(panels: Mapping[str, Sequence[RocCurve]], title: str, credit_lines: Sequence[str] = ()) -> Figure:
    """Draw a panel of curves for each definition of a bad solution.

    Parameters
    ----------
    panels
        Definition of a bad solution to at most `MOST_CURVES` curves.
    """
    figure, axes = new_figure(len(panels), width_in=3.9 * max(1, len(panels)), height_in=4.2)
    drawn = plot_styles(curve.name for curves in panels.values() for curve in curves)
    for place, (definition, curves) in zip(axes, panels.items(), strict=True):
        place.plot([0, 1], [0, 1], color=GREY, linewidth=0.9, linestyle=":")
        for curve in curves:  # a score has the same style in all panels
            label, style = f"{curve.name}: AUC {curve.area:.2f}", drawn[curve.name]
            x, y = curve.false_positives, curve.true_positives
            place.plot(x, y, color=style.colour, linestyle=style.line, linewidth=1.4, label=label)
        place.set(xlabel="good solutions flagged", ylabel="bad solutions flagged", xlim=(0, 1), ylim=(0, 1.01))
        place.set_box_aspect(1)
        place.legend(loc="lower right")
        place.set_title(f"bad: {definition}")
    return finish(figure, title, credit_lines)
