"""Figures of sequences: errors of all trials over the frames and after revolutions, and one trial in full."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    LINE_STYLES,
    ORANGE,
    SERIES_COLOURS,
    VERMILION,
    PlotStyle,
    draw_band,
    finish,
    grid_figure,
    image_panel,
    mark_revolutions,
    new_figure,
    plot_styles,
    scale_ordinate,
    styled,
)
from boresight.reports.statistics.measured import MEAN, measure
from boresight.scenarios.arrays import FloatArray

POSITION, LANDMARKS = "position_error_m", "landmark_rmse_m"
_PANELS = {POSITION: "camera position error, m", LANDMARKS: "RMSE of the frame's landmarks, m"}
_BANDS_AT_MOST = 3

AFTER_REVOLUTIONS = {"error_after_1_m": "after 1 revolution", "error_after_2_m": "after 2 revolutions"}
"""Columns of rows to the words for them on the ordinate."""
_WIDTH = 0.6
SIGMAS = 3.0
ANOMALY, TIME = "anomaly, deg", "time, s"
_COMPONENTS = ("radial", "along-track", "cross-track")


@styled
def draw_revolutions(errors: Mapping[str, Mapping[str, pd.DataFrame]], abscissa: str, title: str) -> Figure:
    """Draw the mean error at each level of a series, with its interval and the standard deviation of the trials.

    After figures 4.1 and 4.2 of Delpech et al. (2015). ``errors`` maps the label of each line to the rows of its trials
    by level; rows of the same ``cluster`` are not independent. A panel without any value is left out. ``abscissa``
    names the levels.
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
    """Draw an image (H, W) with rings around features (Delpech et al. 2015, figures 6.1 and 6.2).

    Features (n, 2) have the centre of the first pixel at (0.5, 0.5); without any the image is drawn alone.
    """
    figure, (axes,) = new_figure(1, width_in=5.0, height_in=5.2)
    image_panel(axes, image, title)
    if len(uv_px):
        axes.scatter(uv_px[:, 0], uv_px[:, 1], s=70, facecolors="none", edgecolors=ORANGE, linewidths=1.2)
    return figure


@styled
def draw_starts(epochs: pd.DataFrame, title: str) -> Figure:
    """Draw the position error of every trial along the frames (Delpech et al. 2015, figures 3.1 and 5.1).

    Frames of one estimator: columns ``trial``, ``anomaly_deg`` (``time_s`` where that has none) and
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

    Bands are drawn for at most three estimators, as more would hide each other. ``panels`` are columns of the errors. A
    panel for which no estimator has a value, such as the landmarks of dead reckoning, is left out, unless that holds
    for all panels. Frames have the columns ``trial``, ``anomaly_deg`` (``time_s`` where that has none) and the errors.
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


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryErrors:
    """An estimated trajectory and the true one, over ``along`` (F,), which ``abscissa`` names.

    Positions (F, 3) are inertial in the axes of the orbit: towards the first position, along the motion there, and
    across the plane. ``error_m`` (F, 3) has the radial, along-track and cross-track components, ``sigma_m`` (F, 3)
    their standard deviations by the estimator's covariance; NaN where it has none. ``body_radius_m`` is that of a
    sphere around the body.
    """

    along: FloatArray
    true_m: FloatArray
    estimated_m: FloatArray
    error_m: FloatArray
    sigma_m: FloatArray
    body_radius_m: float
    abscissa: str = ANOMALY


@dataclass(frozen=True, slots=True, eq=False)
class TrackLifetimes:
    """Lifetimes of the tracks of a sequence, and errors of their landmarks, over ``abscissa`` (see `TrajectoryErrors`).

    ``first`` and ``last`` (T,) are of the frames that see the track, ``error_m`` (T,) of its landmark when it was last
    seen; NaN where the estimator had no landmark. ``wrong_at`` (k, 2) has abscissa and track of each wrong sighting,
    ``per_frame`` (F, 2) abscissa and number of tracks. ``ended`` is the abscissa of the last estimated frame; None
    where all are estimated.
    """

    first: FloatArray
    last: FloatArray
    error_m: FloatArray
    wrong_at: FloatArray
    per_frame: FloatArray
    ended: float | None = None
    abscissa: str = ANOMALY


@styled
def draw_trajectory(trajectory: TrajectoryErrors, title: str) -> Figure:
    """Draw the trajectory in the plane of the orbit and edge-on, with magnified errors."""
    figure, (plane, edge) = new_figure(2, width_in=9.0, height_in=4.6)
    # Errors are drawn larger by the largest round factor at which none exceeds a sixth of the orbit's radius.
    largest = float(np.linalg.norm(trajectory.error_m, axis=1).max(initial=0.0))
    room = float(np.linalg.norm(trajectory.true_m, axis=1).max(initial=1.0)) / 6.0
    scale = max((s for s in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if s * largest <= room), default=1.0)
    estimate = "estimate" if scale == 1.0 else f"estimate, error x {scale:g}"
    shown = trajectory.true_m + scale * (trajectory.estimated_m - trajectory.true_m)
    across = "across the orbit, m" if trajectory.abscissa == ANOMALY else "across both, m"
    pairs = ((plane, 1, 1e-3, "along the first motion, km"), (edge, 2, 1.0, across))
    for axes, which, unit, label in pairs:
        scaled = np.array([1e-3, unit])
        true, estimated = (points_m[:, [0, which]] * scaled for points_m in (trajectory.true_m, shown))
        axes.plot(*true.T, color=GREEN, linewidth=1.6, label="truth")
        axes.plot(*estimated.T, color=BLUE, linewidth=1.0, linestyle="--", label=estimate)
        axes.plot(*true[:1].T, "o", color=GREEN, markersize=5, label="first frame")
        axes.plot(*estimated[-1:].T, "s", color=BLUE, markersize=5, label="last estimate")
        axes.set(xlabel="towards the first position, km", ylabel=label)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    radius_km = 1e-3 * trajectory.body_radius_m
    plane.fill(radius_km * np.cos(angle), radius_km * np.sin(angle), color=GREY, alpha=0.35, label="body")
    plane.set_aspect("equal")
    return finish(figure, title, legend=plane, columns=5)


@styled
def draw_error_bands(trajectory: TrajectoryErrors, title: str) -> Figure:
    """Draw each component of the error over the frames, with the band of three standard deviations."""
    figure, panels = grid_figure(3, 1, width_in=7.5, height_in=6.0)
    for k, (axes, name) in enumerate(zip(panels[:, 0], _COMPONENTS, strict=True)):
        band = SIGMAS * trajectory.sigma_m[:, k]
        known = np.isfinite(band)
        if known.any():
            axes.fill_between(
                trajectory.along, -band, band, where=list(known), color=ORANGE, alpha=0.25, linewidth=0,
                label=f"{SIGMAS:g} sigma of its covariance",
            )  # fmt: skip
        axes.plot(trajectory.along, trajectory.error_m[:, k], color=BLUE, linewidth=1.1, label="error")
        axes.axhline(0.0, color=GREY, linewidth=0.7)
        outside = np.count_nonzero(np.abs(trajectory.error_m[known, k]) > band[known])
        share = f": {100.0 * outside / known.sum():.0f} % of frames outside" if known.any() else ": no covariance"
        axes.set_title(f"{name}{share}", loc="left")
        axes.set_ylabel("error, m")
        if trajectory.abscissa == ANOMALY:
            mark_revolutions(axes, trajectory.along)
    panels[0, 0].legend(loc="upper left", ncols=2)
    panels[-1, 0].set_xlabel(trajectory.abscissa)
    return finish(figure, title)


@styled
def draw_tracks(tracks: TrackLifetimes, title: str) -> Figure:
    """Draw the lifetime of every track, coloured by the error of its landmark, and the number of tracks per frame.

    Wrong sightings are marked by crosses.
    """
    figure, panels = grid_figure(2, 1, width_in=7.5, height_in=6.4)
    above, below = panels[:, 0]
    numbers = np.arange(len(tracks.first), dtype=np.float64)
    ends = np.stack([np.column_stack([tracks.first, numbers]), np.column_stack([tracks.last, numbers])], axis=1)
    known = np.isfinite(tracks.error_m)
    above.add_collection(LineCollection(list(ends[~known]), colors=GREY, linewidths=0.8, label="without a landmark"))
    lines = LineCollection(list(ends[known]), cmap="viridis", linewidths=1.0)
    lines.set_array(tracks.error_m[known])
    lines.set_clim(0.0, float(np.percentile(tracks.error_m[known], 95)) if known.any() else 1.0)
    above.add_collection(lines)
    figure.colorbar(lines, ax=above, label="landmark error when seen last, m", pad=0.01)
    if len(tracks.wrong_at):
        above.plot(*tracks.wrong_at.T, "x", color=VERMILION, markersize=4, label=f"{len(tracks.wrong_at)} seen wrongly")
    span = (0.0, float(tracks.per_frame[:, 0].max(initial=1.0)))
    above.set(ylabel="track", xlim=span, ylim=(-1.0, len(tracks.first)))
    for axes in (above, below) if tracks.ended is not None else ():
        axes.axvline(tracks.ended, color=VERMILION, linewidth=1.0, linestyle="--", label="the estimate ends")
    if above.get_legend_handles_labels()[0]:
        above.legend(loc="upper left")
    below.step(*tracks.per_frame.T, where="mid", color=BLUE)
    below.set(xlabel=tracks.abscissa, ylabel="tracks in the frame", xlim=span)
    below.set_ylim(bottom=0.0)
    return finish(figure, title)


@styled
def draw_landmark_map(points_m: FloatArray, error_m: FloatArray, new: NDArray[np.bool_], title: str) -> Figure:
    """Draw a map of landmark errors, and height errors over errors along the ground, when landmarks were last seen.

    ``points_m`` (n, 3) are true positions, ``error_m`` (n, 3) estimated less true ones, body frame. ``new`` (n,) are
    landmarks that were seen only once, so that their depth is unknown.
    """
    figure, (chart, parts) = new_figure(2, width_in=9.4, height_in=3.6)
    length = np.linalg.norm(error_m, axis=1)
    x, y, z = points_m.T
    longitude, latitude = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    top = float(np.percentile(length[~new], 95)) if (~new).any() else float(length.max(initial=1.0))
    dots = chart.scatter(longitude, latitude, c=length, s=14, cmap="viridis", vmin=0.0, vmax=top)
    chart.plot(longitude[new], latitude[new], "o", markersize=6, markerfacecolor="none", markeredgecolor=VERMILION)
    figure.colorbar(dots, ax=chart, label="error, m", pad=0.01)
    chart.set(xlim=(-180, 180), ylim=(-90, 90), xlabel="longitude, deg", ylabel="latitude, deg")
    chart.set_title(f"{len(points_m)} landmarks when seen last (ringed: seen once)")
    radial = np.einsum("ni,ni->n", error_m, points_m / np.linalg.norm(points_m, axis=1, keepdims=True))
    across = np.sqrt(np.maximum(length**2 - radial**2, 0.0))
    for which, colour, label in ((~new, BLUE, "seen twice or more"), (new, VERMILION, "seen once")):
        if which.any():
            parts.plot(across[which], radial[which], "o", markersize=3, color=colour, label=label)
    parts.axhline(0.0, color=GREY, linewidth=0.7)
    parts.set(xlabel="error along the ground, m", ylabel="error of its height, m")
    parts.legend(loc="best")
    return finish(figure, title)
