"""Recall and share of wrong matches of several matchers, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.looks import looks
from reports.figures.style import grid_figure, styled

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ShareCurve:
    """A matcher: labels of its points, and (k, 3) value, lower and upper bound of both shares, per cent."""

    name: str
    labels: tuple[str, ...]
    recall: FloatArray
    wrong: FloatArray


@styled
def draw_shares(curves: Sequence[ShareCurve], label: str) -> Figure:
    """Draw recall on the left and wrong matches on the right; ``label`` names what the points differ in."""
    figure, axes = grid_figure(1, 2, height_in=3.2)
    places = list(dict.fromkeys(name for curve in curves for name in curve.labels))
    for panel, name, title in zip(axes[0], ("recall", "wrong"), ("recall, %", "wrong matches, %"), strict=True):
        drawn = looks(curve.name for curve in curves)
        for k, curve in enumerate(curves):
            at = np.array([places.index(one) for one in curve.labels]) + 0.06 * (k - 0.5 * (len(curves) - 1))
            values = getattr(curve, name)
            spread = np.abs(values[:, 1:].T - values[:, 0])
            panel.errorbar(
                at,
                values[:, 0],
                yerr=spread,
                color=drawn[curve.name].colour,
                linestyle=drawn[curve.name].line,
                marker="o",
                markersize=3,
                capsize=2,
                label=curve.name,
            )
        panel.set_xticks(range(len(places)), [place.replace(" deg", "") for place in places])
        panel.set(xlabel=label, ylabel=title)
        panel.set_ylim(bottom=0.0)
    axes[0, 0].set_ylim(0.0, 102.0)
    axes[0, 1].legend(loc="upper left")
    return figure
