"""Figures of comparisons: errors against conditions, and normalised errors against chi-square."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.stats import binom, chi2

from reports.figures.designs import Points
from reports.figures.log_axis import mark_decades
from reports.figures.style import GREY, LINE_STYLES, FloatArray, add_credits, grid_figure, new_figure, styled

Panels = Mapping[tuple[str, str], Mapping[str, Points]]
"""Lines by the labels of their error and their condition."""

_POINTS = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True, slots=True, eq=False)
class CoverageCurve:
    """One curve.

    Parameters
    ----------
    label, colour
        Of the curve.
    squares, degrees
        (n,) weighed squares and the degrees of freedom of each.
    independent
        How many of them are independent.
    """

    label: str
    colour: str
    squares: FloatArray
    degrees: FloatArray
    independent: int


@styled
def draw_coverage(claims: Sequence[CoverageCurve], title: str, credit_lines: Sequence[str] = ()) -> Figure:
    """Draw the share of trials within each claimed share of the chi-square distribution.

    Parameters
    ----------
    claims
        The curves. The band is that of the fewest independent trials among them.
    title
        Printed above the panel.
    credit_lines
        Credits of real images.
    """
    figure, (axes,) = new_figure(1, width_in=4.6, height_in=4.4 + 0.17 * len(claims))
    fewest = min(one.independent for one in claims)
    low, high = (binom.ppf(tail, fewest, _POINTS) / fewest for tail in (0.025, 0.975))
    axes.fill_between(_POINTS, low, high, color=GREY, alpha=0.2, linewidth=0)
    axes.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linewidth=0.9)
    for i, one in enumerate(claims):
        reached = np.sort(chi2.cdf(one.squares, one.degrees))
        share = np.searchsorted(reached, _POINTS, side="right") / len(reached)
        axes.plot(_POINTS, share, color=one.colour, linestyle=LINE_STYLES[i % len(LINE_STYLES)], label=one.label)
    axes.set(xlabel="share claimed by the covariance", ylabel="share of trials within", xlim=(0, 1), ylim=(0, 1.005))
    axes.set_aspect("equal", adjustable="box")
    figure.legend(loc="outside lower center", ncols=1, fontsize=7.5)
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


@styled
def draw_binned_errors(
    panels: Panels, colours: Mapping[str, str], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw binned curves with their intervals.

    Parameters
    ----------
    panels
        A full grid of them; an error whose label ends in % has a linear ordinate, the others have a logarithmic one.
    colours
        Of the lines by their labels, in the order of the legend.
    title
        Printed above the panels.
    credit_lines
        Credits of real images.
    """
    errors, conditions = (list(dict.fromkeys(key[i] for key in panels)) for i in (0, 1))
    size = {"width_in": max(4.5, 0.4 + 2.35 * len(conditions)), "height_in": 1.1 + 1.75 * len(errors)}
    figure, places = grid_figure(len(errors), len(conditions), **size)
    lines = list(colours)
    for row, error in zip(places, errors, strict=True):
        for axes, condition in zip(row, conditions, strict=True):
            for label, points in panels[error, condition].items():
                _draw_points(axes, points, colours[label], LINE_STYLES[lines.index(label) % len(LINE_STYLES)])
        _share_ordinate(list(row), error)
    for axes, condition in zip(places[-1], conditions, strict=True):
        axes.set_xlabel(condition)
    looks: list[dict[str, Any]] = [
        {"color": colours[label], "linestyle": LINE_STYLES[i % len(LINE_STYLES)]} for i, label in enumerate(lines)
    ]
    handles = [Line2D([], [], marker="o", markersize=3, **look) for look in looks]
    figure.legend(handles, lines, loc="outside lower center", ncols=min(4, len(lines)))
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _draw_points(axes: Axes, points: Points, colour: str, style: str | tuple[int, tuple[int, ...]]) -> None:
    axes.errorbar(
        points.x, points.y, yerr=np.abs(points.low_high.T - points.y), color=colour, linestyle=style, marker="o",
        markersize=3, linewidth=1.2, elinewidth=0.9, capsize=2,
    )  # fmt: skip


def _share_ordinate(row: Sequence[Axes], error: str) -> None:
    """Give the panels of a row one ordinate, told at the first."""
    low = min(axes.dataLim.y0 for axes in row)
    high = max(axes.dataLim.y1 for axes in row)
    for axes in row:
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        if not np.isfinite([low, high]).all():
            pass  # No panel of the row has a point: too few trials for one bin.
        elif error.endswith("%"):
            axes.set_ylim(max(low - 0.06 * (high - low) - 0.5, -2.0), 102.0)
        elif low > 0.0:
            axes.set_yscale("log")
            axes.set_ylim(low / 1.15, high * 1.15)
            mark_decades(axes.yaxis)
        if axes is not row[0]:
            axes.tick_params(labelleft=False)
    row[0].set_ylabel(error)
