"""Figures of sequences: errors over the frames and after whole revolutions, features found in an image."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.reports.figures.style import (
    LINE_STYLES,
    ORANGE,
    SERIES_COLOURS,
    PlotStyle,
    draw_band,
    finish,
    image_panel,
    mark_revolutions,
    new_figure,
    plot_styles,
    scale_ordinate,
    styled,
)
from boresight.reports.figures.trajectory import ANOMALY, TIME
from boresight.reports.statistics.measured import MEAN, measure

POSITION, LANDMARKS = "position_error_m", "landmark_rmse_m"
_PANELS = {POSITION: "camera position error, m", LANDMARKS: "RMSE of the frame's landmarks, m"}
_BANDS_AT_MOST = 3

AFTER_REVOLUTIONS = {"error_after_1_m": "after 1 revolution", "error_after_2_m": "after 2 revolutions"}
"""Columns of rows to the words for them on the ordinate."""

_WIDTH = 0.6


@styled
def draw_revolutions(errors: Mapping[str, Mapping[str, pd.DataFrame]], abscissa: str, title: str) -> Figure:
    """Draw the mean error at each level of a series, with its interval and the standard deviation of the trials.

    After figures 4.1 and 4.2 of Delpech et al. (2015).

    Parameters
    ----------
    errors
        Label of each line to level to the rows of its trials. Rows of the same ``cluster`` are not independent. A
        panel without any value is left out.
    abscissa
        Name of the levels.
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
    return finish(figure, title, legend=panels[0])


def _draw_series(axes: Axes, errors: Mapping[float, pd.DataFrame], label: str, style: PlotStyle) -> None:
    colour = style.colour
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
        list(known), means, marker="o", markersize=4, linewidth=1.0, linestyle=style.line, color=colour, label=label
    )


@styled
def draw_sightings(image: NDArray[np.float32], uv_px: NDArray[np.float64], title: str) -> Figure:
    """Draw an image with rings around features (Delpech et al. 2015, figures 6.1 and 6.2).

    Parameters
    ----------
    image
        (H, W) any linear measure of radiance.
    uv_px
        (n, 2) features to mark, centre of the first pixel at (0.5, 0.5); empty for the image alone.
    """
    figure, (axes,) = new_figure(1, width_in=5.0, height_in=5.2)
    image_panel(axes, image, title)
    if len(uv_px):
        axes.scatter(uv_px[:, 0], uv_px[:, 1], s=70, facecolors="none", edgecolors=ORANGE, linewidths=1.2)
    return figure


@styled
def draw_starts(epochs: pd.DataFrame, title: str) -> Figure:
    """Draw the position error of every trial along the frames (Delpech et al. 2015, figures 3.1 and 5.1).

    Parameters
    ----------
    epochs
        Frames of one estimator: columns ``trial``, ``anomaly_deg``, ``time_s`` where that has none, and
        ``position_error_m``.
    """
    along, label = _abscissa([epochs])
    figure, (axes,) = new_figure(1, width_in=5.4)
    for i, (trial, own) in enumerate(epochs.groupby("trial")):
        colour, line = SERIES_COLOURS[i % len(SERIES_COLOURS)], LINE_STYLES[i // len(SERIES_COLOURS) % len(LINE_STYLES)]
        axes.plot(own[along], own["position_error_m"], color=colour, linestyle=line, linewidth=1.0, label=trial)
    mark_revolutions(axes, epochs["anomaly_deg"])
    axes.set(xlabel=label, ylabel="camera position error, m")
    axes.set_ylim(bottom=0.0)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6), title="start")
    return finish(figure, title)


def _abscissa(epochs: Collection[pd.DataFrame]) -> tuple[str, str]:
    """Return the column that frames are drawn over, and its label: the anomaly, or the time where there is none."""
    if any(len(table) for table in epochs) and all(table["anomaly_deg"].isna().all() for table in epochs):
        return "time_s", TIME
    return "anomaly_deg", ANOMALY


@styled
def draw_traces(
    epochs: Mapping[str, pd.DataFrame],
    title: str,
    credit_lines: Sequence[str] = (),
    panels: Sequence[str] = (POSITION, LANDMARKS),
) -> Figure:
    """Draw the median error over trials along the frames, with the band of 5 to 95 % and the first trial.

    Bands are drawn for at most three estimators, as more would hide each other. A panel for which no estimator has a
    value, such as the landmarks of dead reckoning, is left out, unless that holds for all panels.

    Parameters
    ----------
    epochs
        Label of each estimator to its frames: columns ``trial``, ``anomaly_deg``, ``time_s`` where that has none, and
        the errors.
    panels
        Columns of the errors to show.
    """
    shown = [name for name in panels if any(table[name].notna().any() for table in epochs.values())] or panels
    figure, places = new_figure(len(shown), width_in=4.4 * len(shown))
    drawn, (along, label) = plot_styles(epochs), _abscissa(epochs.values())
    for axes, name in zip(places, shown, strict=True):
        for estimator, table in epochs.items():
            _draw_trace(axes, table, (along, name), estimator, drawn[estimator], banded=len(epochs) <= _BANDS_AT_MOST)
        mark_revolutions(axes, pd.concat([table["anomaly_deg"] for table in epochs.values()]))
        axes.set(xlabel=label, ylabel=_PANELS[name])
        scale_ordinate(axes, [float(table[name].median()) for table in epochs.values()])
    return finish(figure, title, credit_lines, legend=places[0])


def _draw_trace(
    axes: Axes, table: pd.DataFrame, columns: tuple[str, str], label: str, style: PlotStyle, *, banded: bool
) -> None:
    along, name = columns
    known = table.dropna(subset=[name])
    if known.empty:
        return
    if banded:
        draw_band(axes, known[name], known[along], style, alpha=0.18)
        first = known[known["trial"] == known["trial"].min()]
        if len(first) < len(known):
            axes.plot(first[along], first[name], color=style.colour, linewidth=0.5, alpha=0.8)
    middle = known.groupby(along)[name].median()
    axes.plot(middle.index, middle, color=style.colour, linestyle=style.line, label=label)
