"""Figures of grids of scenarios: curves, effects and heat maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from boresight.reports.figures.style import (
    BLUE,
    GREY,
    Points,
    draw_points,
    finish,
    mark_decades,
    new_figure,
    plot_styles,
    styled,
)
from boresight.scenarios.arrays import FloatArray

_PANELS_A_ROW = 3

_TICKS = (0.01, 0.03, 0.1, 0.2, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)
_FEW_TICKS = (0.01, 0.1, 1.0, 10.0, 100.0)
_WIDE = 30.0
_MOST = 100.0


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
