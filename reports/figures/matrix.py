"""Heat maps of a number over two axes of named levels, with the numbers in their cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.style import FloatArray, new_figure, styled


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
    """Draw heat maps side by side, each on a colour scale of its own from 0 on."""
    down, across = matrices[0].values.shape
    figure, panels = new_figure(len(matrices), 1.3 + len(matrices) * (0.5 + 0.85 * across), 1.5 + 0.62 * down)
    for axes, matrix in zip(panels, matrices, strict=True):
        _draw_heat_map(axes, matrix)
        axes.set_xlabel(columns_label)
    for axes in panels[1:]:
        axes.set_yticklabels([])
    panels[0].set_ylabel(rows_label)
    figure.suptitle(title, fontsize=9.5)
    return figure


def _draw_heat_map(axes: Axes, matrix: HeatMap) -> None:
    finite = matrix.values[np.isfinite(matrix.values)]
    high = float(finite.max()) if len(finite) else 1.0
    # From 0 on, so that what differs little looks alike.
    axes.imshow(matrix.values, cmap="Blues", vmin=0.0, vmax=1.1 * high or 1.0, aspect="auto")
    for (i, j), value in np.ndenumerate(matrix.values):
        dark = np.isfinite(value) and value > 0.6 * high
        colour = "white" if dark else "black"
        axes.text(j, i, matrix.texts[i][j], ha="center", va="center", fontsize=6.5, color=colour)
    axes.set_xticks(range(len(matrix.columns)), matrix.columns, rotation=20, ha="right")
    axes.set_yticks(range(len(matrix.rows)), matrix.rows)
    axes.grid(visible=False)
    axes.set_title(matrix.title)
