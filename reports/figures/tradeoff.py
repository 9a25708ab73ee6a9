"""Figure of the accuracy of methods against their costs: time per image, and size of the data base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from boresight.reports.figures.axes import mark_decades
from boresight.reports.figures.style import GREY, finish, grid_figure, plot_styles, styled
from boresight.reports.statistics.measured import Measured

_ERRORS = (("position_error_m", "position error, m"), ("attitude_error_deg", "attitude error, deg"))


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
            axes.set(xlabel=abscissa, ylabel=label)
            _use_log_axes(axes)
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


def _use_log_axes(axes: Axes) -> None:
    """Make both axes logarithmic, labelled with plain numbers."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.15)
    axes.autoscale_view()
    for axis in (axes.xaxis, axes.yaxis):
        mark_decades(axis)
