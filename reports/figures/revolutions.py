"""Errors after whole revolutions over a series (figures 4.1 and 4.2 of Delpech et al. 2015)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.log_axis import scale_ordinate
from reports.figures.looks import PlotStyle, plot_styles
from reports.figures.style import new_figure, styled
from reports.statistics.measured import MEAN, measure

AFTER_REVOLUTIONS = {"error_after_1_m": "after 1 revolution", "error_after_2_m": "after 2 revolutions"}
"""Columns of rows, and what they are the errors of."""

_WIDTH = 0.6


@styled
def draw_revolutions(errors: Mapping[str, Mapping[str, pd.DataFrame]], abscissa: str, title: str) -> Figure:
    """Draw the mean error over trials at each level of a series, with its interval and the deviation of the trials.

    Parameters
    ----------
    errors
        Label of each line to level to the rows of its trials, with a column ``cluster`` that tells what of them is
        independent; a panel of which no row has a value is left out.
    abscissa
        What the levels are.
    title
        Printed above the panels.
    """
    every = [table for levels in errors.values() for table in levels.values()]
    shown = [name for name in AFTER_REVOLUTIONS if any(table[name].notna().any() for table in every)]
    figure, panels = new_figure(len(shown), width_in=max(6.0, 4.0 * len(shown)))
    drawn = plot_styles(errors)
    levels = list(dict.fromkeys(level for line in errors.values() for level in line))
    for axes, name in zip(panels, shown, strict=True):
        for i, (label, line) in enumerate(errors.items()):
            shift = _WIDTH * ((i + 0.5) / len(errors) - 0.5)
            _draw_series(
                axes, {levels.index(level) + shift: table[[name, "cluster"]] for level, table in line.items()},
                label, drawn[label],
            )  # fmt: skip
        axes.set_xticks(range(len(levels)), levels)
        axes.set(xlabel=abscissa, ylabel=f"position error {AFTER_REVOLUTIONS[name]}, m")
        scale_ordinate(axes, [float(table[name].median()) for table in every])
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    figure.suptitle(title, fontsize=9.5)
    return figure


def _draw_series(axes: Axes, errors: Mapping[float, pd.DataFrame], label: str, look: PlotStyle) -> None:
    colour = look.colour
    known = {x: table.dropna() for x, table in errors.items() if table.iloc[:, 0].notna().any()}
    means = []
    for x, table in known.items():
        values = table.iloc[:, 0].to_numpy(dtype=np.float64)
        spread = float(values.std(ddof=1)) if len(values) > 1 else 0.0
        found = measure(values, table["cluster"].to_numpy(), (MEAN,))[0]
        means.append(mean := float(values.mean()))
        axes.vlines(x, max(mean - spread, 0.0), mean + spread, color=colour, linewidth=0.8)
        if found.low is not None and found.high is not None:
            axes.vlines(x, found.low, found.high, color=colour, linewidth=3.0)
        axes.plot(x, float(np.median(values)), marker="_", color=colour, markersize=9, linestyle="none")
    axes.plot(
        list(known), means, marker="o", markersize=4, linewidth=1.0, linestyle=look.line, color=colour, label=label
    )
