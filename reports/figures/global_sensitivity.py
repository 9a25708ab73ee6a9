"""Figures of sensitivity analyses: indices of the varied keys, and the outcome against each key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from boresight.reports.figures.style import BLUE, GREY, ORANGE, finish, grid_figure, styled
from boresight.reports.statistics.measured import Measured
from boresight.scenarios.arrays import FloatArray

_LONG = 18
_SHOWN = (-1.1, 1.4)
"""Limits of the axis of indices; wider intervals are cut off."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorPanels:
    """Results of one estimator: (n,) outcomes, that of the base, and by the name of an index its value for each key."""

    label: str
    outcomes: FloatArray
    base: float
    shares: Mapping[str, Sequence[Measured]]


@styled
def draw_sensitivity(
    rows: Sequence[EstimatorPanels], keys: Sequence[str], samples: FloatArray, axis: str, title: str
) -> Figure:
    """Draw a row of panels for each estimator: the indices of all keys, and the outcome against each key.

    Parameters
    ----------
    rows
        The estimators.
    keys
        Names of the K keys.
    samples
        (n, K) values of the keys.
    axis
        Name of the outcome, with its unit.
    """
    width_in, height_in = 3.2 + 2.1 * len(keys), 0.9 + 2.3 * len(rows)
    figure, places = grid_figure(len(rows), 1 + len(keys), width_in=width_in, height_in=height_in)
    for row, panels in zip(rows, places, strict=True):
        _indices(panels[0], row, keys)
        panels[0].set_title(row.label, loc="left")
        for axes, key, values in zip(panels[1:], keys, samples.T, strict=True):
            axes.plot(values, row.outcomes, "o", color=BLUE, markersize=2.5, alpha=0.6)
            axes.axhline(row.base, color=GREY, linestyle="--", linewidth=1.0)
            axes.set_xlabel("\n".join(_wrapped(key)), fontsize=8)
            axes.xaxis.set_major_locator(MaxNLocator(4))
        panels[1].set_ylabel(axis, fontsize=8)
        for axes in panels[2:]:
            axes.sharey(panels[1])
            axes.tick_params(labelleft=False)
    return finish(figure, f"{title} (dashed: base)")


def _indices(axes: Axes, row: EstimatorPanels, keys: Sequence[str]) -> None:
    places = np.arange(len(keys))
    height = 0.8 / max(len(row.shares), 1)
    for i, ((name, shares), colour) in enumerate(zip(row.shares.items(), (BLUE, ORANGE), strict=False)):
        values, low, high = np.array([[x or 0.0 for x in (one.value, one.low, one.high)] for one in shares]).T
        axes.barh(places + i * height, values, height, color=colour, alpha=0.75, label=name)
        axes.errorbar(
            values, places + i * height, xerr=[values - low, high - values], fmt="none", ecolor=GREY, capsize=2
        )
    axes.set_yticks(places + 0.4 - 0.5 * height, ["\n".join(_wrapped(key)) for key in keys], fontsize=7)
    axes.set_ylim(len(keys) - 0.1 - 0.5 * height, -0.1 - 0.5 * height)
    left, right = axes.get_xlim()
    axes.set_xlim(max(left, _SHOWN[0]), min(right, _SHOWN[1]))
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    if row.shares:
        legend = axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=7.5)
        legend.set_in_layout(True)
    else:
        axes.text(0.5, 0.5, "does not vary", transform=axes.transAxes, ha="center")


def _wrapped(key: str) -> list[str]:
    """Break a long dotted key into lines at its dots."""
    lines = [""]
    for part in key.replace(".", ".\0").split("\0"):
        if lines[-1] and len(lines[-1]) + len(part) > _LONG:
            lines.append("")
        lines[-1] += part
    return lines
