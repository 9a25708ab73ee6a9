"""Axes of figures: labels of logarithmic axes, marks of whole revolutions, bands of percentiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray

from boresight.reports.figures.style import PlotStyle
from boresight.reports.statistics.intervals import has_quantile
from boresight.scenarios.arrays import FloatArray

_FEW_DECADES = 300.0
"""Ratio of the limits below which 2 and 5 of each decade are labelled too."""
_FAR_APART = 20.0
"""Ratio of typical values above which curves on a linear ordinate would lie on the abscissa."""
_DIVERGED = 1e3
"""Multiple of the largest typical value at which an ordinate is cut off."""

_BAND = (0.05, 0.95)

_FULL_TURN_DEG = 360.0


def mark_revolutions(axes: Axes, anomaly_deg: ArrayLike) -> None:
    """Draw a dotted line at every whole revolution up to the largest anomaly; none where no frame was estimated."""
    last_deg = np.max(np.asarray(anomaly_deg, dtype=np.float64), initial=0.0)
    for turn in range(1, int(last_deg / _FULL_TURN_DEG) + 1):
        axes.axvline(turn * _FULL_TURN_DEG, color="black", linewidth=0.6, linestyle=":")


def percentile_band(values: pd.Series, over: pd.Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 5 % and 95 % quantiles of ``values`` at each value of ``over``.

    Where there are too few values for these quantiles, the band goes from the minimum to the maximum.
    """
    groups = values.groupby(over)
    enough = groups.count().map(lambda n: has_quantile(n, _BAND[0])).to_numpy()
    low, high = (groups.quantile(share).to_numpy() for share in _BAND)
    return np.where(enough, low, groups.min()), np.where(enough, high, groups.max())


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points of a curve: (n,) abscissae and values, and (n, 2) bounds of their intervals."""

    x: FloatArray
    y: FloatArray
    low_high: FloatArray


def draw_points(axes: Axes, points: Points, style: PlotStyle, **line: Any) -> None:
    """Draw points with their intervals, joined by a line in the colour and line style of an estimator."""
    line = {"marker": "o", "markersize": 3, "capsize": 2, **line}
    spread = np.abs(points.low_high.T - points.y)
    axes.errorbar(points.x, points.y, yerr=spread, color=style.colour, linestyle=style.line, **line)


def draw_band(axes: Axes, values: pd.Series, over: pd.Series, style: PlotStyle, alpha: float) -> None:
    """Draw the band of 5 to 95 % of values at each value of a coordinate, see `percentile_band`."""
    low, high = percentile_band(values, over)
    axes.fill_between(np.unique(over), low, high, color=style.colour, alpha=alpha, linewidth=0)


def band_label(trials: int) -> str:
    """Name the band of `percentile_band` over this number of trials, for captions."""
    return "the band of 5 to 95 % of them" if has_quantile(trials, _BAND[0]) else "the band of all of them"


def mark_decades(axis: Axis) -> None:
    """Label the decades of a logarithmic axis, and 2 and 5 of each if the labels fit; the limits must be set."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def scale_ordinate(axes: Axes, typical: Sequence[float]) -> None:
    """Make the ordinate linear from 0, or logarithmic where the typical values of the curves are far apart.

    It ends at 1000 times the largest typical value, so that a method that diverges in one frame does not hide the
    other curves. If values lie beyond, it is logarithmic too, and a note in the panel gives the largest value.
    """
    known = [value for value in typical if np.isfinite(value)]
    if not known or min(known) <= 0.0:
        axes.set_ylim(bottom=0.0)
        return
    top, limit = float(axes.dataLim.y1), _DIVERGED * max(known)
    if max(known) > _FAR_APART * min(known) or top > limit:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    if top > limit:
        axes.set_ylim(float(axes.dataLim.minposy) / 1.5, limit)
        axes.annotate(f"up to {top:.1g}", (0.99, 0.98), xycoords="axes fraction", ha="right", va="top", fontsize=7.5)
    if axes.get_yscale() == "log":
        mark_decades(axes.yaxis)
