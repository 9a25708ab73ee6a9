"""Errors along the frames of sequences, from each start (Delpech et al. 2015, figures 3.1, 3.2, 5.1 and 5.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.bands import percentile_band
from reports.figures.log_axis import scale_ordinate
from reports.figures.looks import PlotStyle, plot_styles
from reports.figures.style import LINE_STYLES, SERIES_COLOURS, add_credits, new_figure, styled
from reports.figures.turns import mark_revolutions

POSITION, LANDMARKS = "position_error_m", "landmark_rmse_m"
_PANELS = {POSITION: "camera position error, m", LANDMARKS: "RMSE of the frame's landmarks, m"}
_BANDS_AT_MOST = 3


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
    mark_revolutions(axes, epochs["anomaly_deg"])
    axes.set(xlabel="anomaly, deg", ylabel="camera position error, m")
    axes.set_ylim(bottom=0.0)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6), title="start")
    figure.suptitle(title, fontsize=9.5)
    return figure


@styled
def draw_traces(
    epochs: Mapping[str, pd.DataFrame],
    title: str,
    credit_lines: Sequence[str] = (),
    panels: Sequence[str] = (POSITION, LANDMARKS),
) -> Figure:
    """Draw the median error over trials against the anomaly, with the band of most of them and the first trial.

    More estimators than three have no bands: they would hide each other.
    A panel of which no estimator has a value, such as the landmarks of dead reckoning, is left out; with none, none is.

    Parameters
    ----------
    epochs
        Label of each estimator to its frames: columns ``trial``, ``anomaly_deg`` and the errors.
    title
        Printed above the panels.
    credit_lines
        Credits of real images.
    panels
        Which errors to show.
    """
    shown = [name for name in panels if any(table[name].notna().any() for table in epochs.values())] or panels
    figure, places = new_figure(len(shown), width_in=4.4 * len(shown))
    drawn = plot_styles(epochs)
    for axes, name in zip(places, shown, strict=True):
        for estimator, table in epochs.items():
            _draw_trace(axes, table, name, estimator, drawn[estimator], banded=len(epochs) <= _BANDS_AT_MOST)
        mark_revolutions(axes, pd.concat([table["anomaly_deg"] for table in epochs.values()]))
        axes.set(xlabel="anomaly, deg", ylabel=_PANELS[name])
        scale_ordinate(axes, [float(table[name].median()) for table in epochs.values()])
    handles, labels = places[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _draw_trace(axes: Axes, table: pd.DataFrame, name: str, label: str, look: PlotStyle, *, banded: bool) -> None:
    known = table.dropna(subset=[name])
    if known.empty:
        return
    over_trials = known.groupby("anomaly_deg")[name]
    colour = look.colour
    middle = over_trials.median()
    anomaly = middle.index.to_numpy(dtype=float)
    if banded:
        low, high = percentile_band(known[name], known["anomaly_deg"])
        axes.fill_between(anomaly, low, high, color=colour, alpha=0.18, linewidth=0)
        first = known[known["trial"] == known["trial"].min()]
        if len(first) < len(known):
            axes.plot(first["anomaly_deg"], first[name], color=colour, linewidth=0.5, alpha=0.8)
    axes.plot(anomaly, middle.to_numpy(), color=colour, linestyle=look.line, label=label)
