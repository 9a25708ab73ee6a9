"""Position error along the frames, a line for each start (figures 7.1 and 7.2 of Delpech et al. 2015)."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from reports.figures.style import LINE_STYLES, SERIES_COLOURS, new_figure, styled
from reports.figures.turns import mark_turns


@styled
def draw_starts(epochs: pd.DataFrame, title: str) -> Figure:
    """Draw the position error of every trial against the anomaly gone through.

    Parameters
    ----------
    epochs
        Frames of one estimator: columns ``trial``, ``anomaly_deg`` and ``position_error_m``.
    title
        Printed above.
    """
    figure, (axes,) = new_figure(1, width_in=5.4)
    for i, (trial, own) in enumerate(epochs.groupby("trial")):
        colour, line = SERIES_COLOURS[i % len(SERIES_COLOURS)], LINE_STYLES[i // len(SERIES_COLOURS) % len(LINE_STYLES)]
        axes.plot(own["anomaly_deg"], own["position_error_m"], color=colour, linestyle=line, linewidth=1.0, label=trial)
    mark_turns(axes, epochs["anomaly_deg"])
    axes.set(xlabel="anomaly, deg", ylabel="camera position error, m")
    axes.set_ylim(bottom=0.0)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6), title="start")
    figure.suptitle(title, fontsize=9.5)
    return figure
