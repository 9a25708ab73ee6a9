"""Figures of image surveys, crater navigation and orbit determination (Cheng et al. 2003, figures 8 to 10)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    LINE_STYLES,
    ORANGE,
    VERMILION,
    draw_band,
    finish,
    grid_figure,
    mark_decades,
    mark_on_axis,
    new_figure,
    plot_styles,
    raise_top,
    styled,
)
from boresight.reports.schema.grid import shortest

_MOST_BARS = 60


@styled
def draw_count_histogram(
    counts: NDArray[np.int64], label: str, ordinate: str, published: Mapping[str, float], title: str
) -> Figure:
    """Draw a histogram of counts (n,) with mean and median; values that a paper prints are triangles on the axis."""
    figure, (axes,) = new_figure(1, width_in=5.6, height_in=3.4)
    width = max(1, int(np.ceil((counts.max(initial=0) + 1) / _MOST_BARS)))
    edges = np.arange(0, counts.max(initial=0) + width + 1, width) - 0.5
    axes.hist(counts, edges.tolist(), color=BLUE, alpha=0.75, edgecolor="white", linewidth=0.4)
    median, mean = float(np.median(counts)), float(counts.mean())
    axes.axvline(median, color=GREY, linestyle=":", label=f"median {median:g}")
    axes.axvline(mean, color=GREY, linestyle="--", label=f"mean {shortest(mean)}")
    for value in published.values():
        mark_on_axis(axes, value, "black")
    if published:
        printed = ", ".join(f"{name} {value:g}" for name, value in published.items())
        axes.plot(
            [], [], marker="^", color="black", markerfacecolor="white", linestyle="none", label=f"paper: {printed}"
        )
    axes.set(xlabel=label, ylabel=ordinate)
    axes.set_xlim(left=-0.5)
    raise_top(axes, 2)
    axes.legend(loc="upper right")
    return finish(figure, title)


@styled
def draw_crater_counts(images: pd.DataFrame, landmarks: pd.DataFrame, title: str) -> Figure:
    """Draw histograms of craters per image and of images per landmark (Cheng et al. 2003, figures 8b and 9).

    Images have the columns ``n_detections`` and ``n_numbered``, landmarks ``hits``.
    """
    figure, (left, right) = new_figure(2)
    found, numbered, hits = images["n_detections"], images["n_numbered"], landmarks["hits"]
    edges = np.arange(-0.5, float(found.max()) + 1.5)
    left.hist(found, bins=list(edges), color=BLUE, alpha=0.75, label="detected")
    left.hist(numbered, bins=list(edges), histtype="step", color=ORANGE, linewidth=1.4, label="in the data base")
    left.set(xlabel="craters in an image", ylabel="images")
    left.legend()
    if len(hits):
        right.hist(hits, bins=list(np.arange(1.5, float(hits.max()) + 1.5)), color=BLUE)
    right.set(xlabel="images that show a landmark", ylabel="landmarks")
    for axes in (left, right):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.suptitle(title)
    return figure


@styled
def draw_landmark_spans(landmarks: pd.DataFrame, title: str) -> Figure:
    """Draw the time span of each landmark; landmarks with sightings of another crater have a second colour.

    Columns ``first_days``, ``last_days``, ``hits`` and ``n_other``.
    """
    figure, (axes,) = new_figure(1, width_in=6.5, height_in=4.2)
    ordered = landmarks.sort_values(["first_days", "last_days"]).reset_index(drop=True)
    mixed = ordered["n_other"] > 0
    for rows, colour, label in ((~mixed, BLUE, "of one crater"), (mixed, ORANGE, "with sightings of another")):
        own = ordered[rows]
        text = f"{label} ({len(own)})"
        axes.hlines(own.index, own["first_days"], own["last_days"], color=colour, linewidth=0.8, label=text)
        axes.plot(own["first_days"], own.index, ".", color=colour, markersize=2.0)
    axes.set(xlabel="time after the epoch, days", ylabel="landmark, by its first image")
    axes.tick_params(axis="y", colors=GREY)
    # The bars run diagonally across the panel, so the legend has to stand above it.
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    figure.suptitle(title)
    return figure


@styled
def draw_residuals(residuals: pd.DataFrame, title: str) -> Figure:
    """Draw the column residuals above the row residuals, over time; edited sightings are left out.

    Columns ``time_days``, ``u_px``, ``v_px`` and ``used``.
    """
    figure, axes = grid_figure(2, 1, width_in=7.0, height_in=4.4)
    used = residuals[residuals["used"].astype(bool)]
    for (panel,), name, colour, label in zip(axes, ("u_px", "v_px"), (BLUE, ORANGE), ("column", "row"), strict=True):
        panel.plot(used["time_days"], used[name], ".", color=colour, markersize=1.5)
        panel.set(ylabel=f"{label} residual, px")
        panel.axhline(0.0, color=GREY, linewidth=0.8)
    axes[1, 0].set(xlabel="time after the epoch, days")
    return finish(figure, f"{title}: {len(used):,} of {len(residuals):,} sightings")


@styled
def draw_orbit_errors(errors: pd.DataFrame, title: str) -> Figure:
    """Draw median and band of the position error over the trials against time, for each estimator.

    Columns ``estimator``, ``trial``, ``time_days``, ``position_error_m``, ``position_sigma_m`` and ``predicted``.
    """
    figure, (axes,) = new_figure(1, width_in=6.0)
    drawn = plot_styles(map(str, errors["estimator"].unique()))
    for name, own in errors.groupby("estimator", sort=False):
        style, medians = drawn[str(name)], own.groupby("time_days")[["position_error_m", "position_sigma_m"]].median()
        error, sigma = medians["position_error_m"], medians["position_sigma_m"]
        axes.plot(medians.index, error, color=style.colour, linestyle=style.line, label=str(name))
        draw_band(axes, own["position_error_m"], own["time_days"], style, alpha=0.2)
        axes.plot(medians.index, sigma, color=style.colour, linestyle=":", linewidth=0.9)
    axes.plot([], [], color=GREY, linestyle=":", linewidth=0.9, label="thin, dotted: RMS by the covariance")
    arc = errors[~errors["predicted"].astype(bool)]
    axes.axvline(float(arc["time_days"].max()), color=GREY, linewidth=0.8)
    axes.set(xlabel="time after the epoch, days", ylabel="position error, m", yscale="log")
    mark_decades(axes.yaxis)
    axes.legend(loc="upper left")
    return finish(figure, title)


@styled
def draw_orbit_case_errors(errors: pd.DataFrame, title: str) -> Figure:
    """Draw the position error of one solution: its components, and its length with the RMS by the covariance.

    Columns ``time_days``, ``radial_m``, ``along_m``, ``cross_m``, ``position_error_m``, ``position_sigma_m``,
    ``predicted``.
    """
    figure, axes = grid_figure(2, 1, width_in=7.0, height_in=5.0)
    (above,), (below,) = axes
    components = (("radial_m", "radial", BLUE), ("along_m", "along-track", ORANGE), ("cross_m", "cross-track", GREEN))
    for i, (name, label, colour) in enumerate(components):
        above.plot(errors["time_days"], errors[name], color=colour, linestyle=LINE_STYLES[i], label=label)
    above.axhline(0.0, color=GREY, linewidth=0.7)
    above.set(ylabel="error, m")
    below.plot(errors["time_days"], errors["position_error_m"], color=BLUE, label="position error")
    predicted = "RMS predicted by its covariance"
    below.plot(errors["time_days"], errors["position_sigma_m"], color=GREY, linestyle="--", label=predicted)
    below.set(xlabel="time after the epoch, days", ylabel="m", ylim=(0.0, None))
    arc = errors[~errors["predicted"].astype(bool)]
    for panel in (above, below):
        panel.axvline(float(arc["time_days"].max()), color=GREY, linewidth=0.8)
        panel.legend(loc="upper left", ncols=3)
    return finish(figure, title)


@styled
def draw_sightings_used(residuals: pd.DataFrame, title: str) -> Figure:
    """Draw all residuals of one solution: used or edited by the filter, of the right crater or of a wrong one.

    Columns ``u_px``, ``v_px``, ``used`` and ``wrong``.
    """
    figure, (axes,) = new_figure(1, width_in=5.2, height_in=4.8)
    used, wrong = residuals["used"].astype(bool), residuals["wrong"].astype(bool)
    classes = (
        (used & ~wrong, BLUE, ".", "right, used"),
        (~used & ~wrong, ORANGE, ".", "right, edited"),
        (~used & wrong, GREY, "x", "wrong, edited"),
        (used & wrong, VERMILION, "x", "wrong, used"),
    )
    for which, colour, marker, label in classes:
        own = residuals[which]
        text = f"{label}: {len(own):,}"
        axes.plot(own["u_px"], own["v_px"], marker, color=colour, markersize=4, linestyle="none", label=text)
    axes.set(xlabel="column residual, px", ylabel="row residual, px", xscale="symlog", yscale="symlog")
    return finish(figure, title, legend=axes, columns=2)
