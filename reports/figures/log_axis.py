"""Logarithmic axes that are marked with plain numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

_FEW_DECADES = 300.0
_FAR_APART = 20.0
_RUNAWAY = 1e3


def mark_decades(axis: Axis) -> None:
    """Mark an axis that is logarithmic and has its limits: decades, and 2 and 5 of each where there is room."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def scale_ordinate(axes: Axes, typical: Sequence[float]) -> None:
    """Choose a logarithmic ordinate where curves would else lie upon the axis: their typical values are far apart.

    What runs away beyond them, such as a method that diverges in one frame, leaves the frame, and a note says how far.
    """
    known = [value for value in typical if np.isfinite(value)]
    if not known or min(known) <= 0.0:
        axes.set_ylim(bottom=0.0)
        return
    top, limit = float(axes.dataLim.y1), _RUNAWAY * max(known)
    if max(known) > _FAR_APART * min(known) or top > limit:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    if top > limit:
        axes.set_ylim(float(axes.dataLim.minposy) / 1.5, limit)
        axes.annotate(f"up to {top:.1g}", (0.99, 0.98), xycoords="axes fraction", ha="right", va="top", fontsize=7.5)
    if axes.get_yscale() == "log":
        mark_decades(axes.yaxis)
