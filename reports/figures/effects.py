"""Factors with intervals, by what they belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from reports.figures.style import BLUE, GREY, new_figure, styled

_TICKS = (0.01, 0.03, 0.1, 0.2, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)


@dataclass(frozen=True, slots=True)
class Effect:
    """A factor with the bounds of its interval."""

    label: str
    value: float
    low: float
    high: float


@styled
def draw_effects(panels: Mapping[str, Sequence[Effect]], title: str) -> Figure:
    """Draw a panel of factors for each outcome, on logarithmic axes about 1."""
    most = max(len(effects) for effects in panels.values())
    figure, places = new_figure(len(panels), 3.2 + 2.2 * len(panels), 1.2 + 0.3 * most)
    for axes, (outcome, effects) in zip(places, panels.items(), strict=True):
        for line, effect in enumerate(effects):
            axes.plot([effect.low, effect.high], [line, line], color=BLUE, linewidth=1.4)
            axes.plot([effect.value], [line], color=BLUE, marker="o", markersize=4)
        axes.axvline(1.0, color=GREY, linewidth=0.9, linestyle="--")
        axes.set_xscale("log")
        low, high = (f(x for e in effects for x in (e.low, e.high)) for f in (min, max))
        axes.set_xlim(min(low / 1.05, 0.7), max(high * 1.05, 1.4))  # so that small effects look small
        ticks = [t for t in _TICKS if axes.get_xlim()[0] <= t <= axes.get_xlim()[1]]
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
