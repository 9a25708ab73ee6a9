"""Factors with intervals, by what they belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from reports.figures.style import BLUE, GREY, new_figure, styled

_TICKS = (0.01, 0.03, 0.1, 0.2, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)
_FEW_TICKS = (0.01, 0.1, 1.0, 10.0, 100.0)
_WIDE = 30.0
_MOST = 100.0


@dataclass(frozen=True, slots=True)
class Effect:
    """A factor with the bounds of its interval, NaN where there is none, and what stands beside it."""

    label: str
    value: float
    low: float
    high: float
    note: str = ""


@styled
def draw_effects(panels: Mapping[str, Sequence[Effect]], title: str) -> Figure:
    """Draw a panel of factors for each outcome, on one logarithmic scale about 1; an arrow is a factor beyond it."""
    bounds = _bounds([effect for effects in panels.values() for effect in effects])
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
        ticks = [
            t
            for t in (_FEW_TICKS if bounds[1] > _WIDE * bounds[0] else _TICKS)
            if axes.get_xlim()[0] <= t <= axes.get_xlim()[1]
        ]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_ylim(most - 0.5, -0.5)
        axes.set_yticks(range(len(effects)), [effect.label for effect in effects])
        axes.set_title(outcome, fontsize=8)
        axes.set_xlabel("factor")
    for axes in places[1:]:
        axes.set_yticklabels([])
    figure.suptitle(title, fontsize=9.5)
    return figure


def _bounds(effects: Sequence[Effect]) -> tuple[float, float]:
    """Choose limits that hold all factors but wild ones, wide enough for small effects to look small."""
    known = [x for effect in effects for x in (effect.value, effect.low, effect.high) if np.isfinite(x)]
    return min([0.7, *(x / 1.05 for x in known)]), min(max([1.4, *(x * 1.05 for x in known)]), _MOST)
