"""Figures of craters, of surveys and chains that use them, and of the orbits found (after Cheng et al. 2003)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
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
    Points,
    draw_band,
    draw_points,
    finish,
    grid_figure,
    hide_axes,
    image_panel,
    mark_decades,
    mark_on_axis,
    new_figure,
    plot_styles,
    raise_top,
    show_image,
    styled,
)
from boresight.reports.schema.grid import shortest
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Ellipses

_MISSED = "#ffffff"
_MISSED_ON_WHITE = "#000000"

Marked = tuple[Ellipses, NDArray[np.bool_]]
"""Rims, and which of them are detectable or matched."""
Bar = tuple[float, float, float]
"""A value, and the lower and the upper end of its interval."""
_TRUE, _FOUND, _FALSE, _OTHER = "#ffd21f", "#35c4ff", "#ff4d4d", "#8f8f3c"


def draw_rims(axes: Axes, ellipses: Ellipses, colour: str, width: float = 1.0, dashed: bool = False) -> None:
    """Draw crater rims over an image."""
    if len(ellipses):
        points, _ = ellipses.points(96)
        closed = np.concatenate([points, points[:, :1]], axis=1)
        axes.add_collection(
            LineCollection(list(closed), colors=colour, linewidths=width, linestyles="--" if dashed else "-")
        )


@styled
def draw_stages(
    image: NDArray[np.float32], edges: NDArray[np.bool_], arcs: Mapping[str, Sequence[FloatArray]], detected: Ellipses
) -> Figure:
    """Draw the image, all edges, grouped edges and detected craters (Cheng et al. 2003, figure 2).

    ``edges`` (H, W) are the edge pixels of both passes; ``arcs`` has the grouped edges, each (n, 2) pixels, under
    ``shaded`` and ``lit``.
    """
    figure, panels = grid_figure(2, 2, width_in=9.0, height_in=7.2)
    image_panel(panels[0, 0], image, "a  image")
    image_panel(panels[0, 1], np.where(edges, 0.0, 1.0).astype(np.float32), "b  edges of both passes")
    image_panel(panels[1, 0], image, "c  convex rim edges: shaded side blue, lit side orange")
    for side, colour in (("shaded", BLUE), ("lit", ORANGE)):
        panels[1, 0].add_collection(LineCollection(list(arcs[side]), colors=colour, linewidths=1.0))
    image_panel(panels[1, 1], image, f"d  {len(detected)} detected craters")
    draw_rims(panels[1, 1], detected, GREEN)
    return figure


@styled
def draw_detections(
    image: NDArray[np.float32], detected: Ellipses, predicted: Ellipses, names: Sequence[str], title: str
) -> Figure:
    """Draw detected rims over an image, and predicted rims dashed and named (Cheng et al. 2003, figure 3)."""
    figure, (axes,) = new_figure(1, width_in=8.0, height_in=6.4)
    image_panel(axes, image, title)
    draw_rims(axes, detected, GREEN)
    draw_rims(axes, predicted, VERMILION, dashed=True)
    for name, centre, radius in zip(names, predicted.centre_px, predicted.radius_px, strict=True):
        axes.annotate(name, centre - [0.0, radius + 3.0], color=VERMILION, fontsize=8, ha="center", va="bottom")
    return figure


@styled
def draw_found_and_true(image: NDArray[np.float32], truth: Marked, found: Marked, title: str) -> Figure:
    """Draw an image (H, W), its true craters and its detections (after Cheng et al. 2003, figures 2 and 3).

    True rims are bright where they are detectable, detections red where none is matched.
    """
    figure, axes = new_figure(3, width_in=11.0, height_in=3.3)
    for place, name in zip(axes, ("image", "truth", "detections"), strict=True):
        image_panel(place, image, name)
    (true_rims, detectable), (found_rims, matched) = truth, found
    draw_rims(axes[1], true_rims[~detectable], _OTHER, width=0.8)
    draw_rims(axes[1], true_rims[detectable], _TRUE, width=0.8)
    draw_rims(axes[2], found_rims[matched], _FOUND, width=0.8)
    draw_rims(axes[2], found_rims[~matched], _FALSE, width=0.8)
    return finish(figure, title)


@styled
def draw_confidence_curves(curves: Mapping[str, pd.DataFrame], title: str) -> Figure:
    """Draw the ROC curve of each detector: share of craters found over share of false alarms.

    Curves have a row for each detection as the threshold on the confidence falls: ``false_share`` of false alarms,
    ``detectable`` and ``clean``: shares of such craters that are found, and ``kept``: whether it reaches the detector's
    own threshold.
    """
    figure, (place,) = new_figure(1, width_in=5.2, height_in=4.2)
    for (label, curve), drawn in zip(curves.items(), plot_styles(curves).values(), strict=True):
        colour, false = drawn.colour, 100.0 * curve["false_share"]
        chosen = int(curve["kept"].sum()) - 1  # those above the threshold are the first of the curve
        for name, style in (("detectable", "-"), ("clean", LINE_STYLES[1])):
            found = 100.0 * curve[name]
            place.plot(false, found, color=colour, linewidth=1.3, linestyle=style, label=f"{label}: {name}")
            if chosen >= 0:
                place.plot(false.iloc[chosen], found.iloc[chosen], marker="o", markersize=5, color=colour)
    place.plot(
        [5.0], [90.0], marker="*", markersize=11, color="black", linestyle="none", label="paper: over 90, under 5"
    )
    place.set(xlabel="false alarms among those and detectable craters, %", ylabel="craters found, %", ylim=(0, 101))
    place.set_xlim(left=0.0)
    place.legend(loc="lower right")
    return finish(figure, title)


@styled
def draw_rates(panels: Mapping[str, Mapping[str, Sequence[tuple[str, Bar]]]], title: str) -> Figure:
    """Draw rates (%) with intervals in named bins: a panel for each quantity binned, a curve for each detector."""
    figure, axes = new_figure(len(panels), width_in=3.7 * len(panels), height_in=3.4)
    for place, (what, detectors) in zip(axes, panels.items(), strict=True):
        drawn = plot_styles(detectors)
        for k, (label, bins) in enumerate(detectors.items()):
            at = np.arange(float(len(bins))) + 0.12 * (k - 0.5 * (len(detectors) - 1))
            rates = np.array([bar for _, bar in bins], dtype=np.float64).reshape(-1, 3)
            points = Points(at, rates[:, 0], rates[:, 1:])
            draw_points(place, points, drawn[label], markersize=3.5, capsize=0, label=label)
            place.set_xticks(np.arange(len(bins)), [name for name, _ in bins], rotation=30, ha="right")
        place.set(xlabel=what, ylim=(0, 101))
    axes[0].set_ylabel("detectable craters found, %")
    return finish(figure, title, legend=axes[0], columns=len(detectors))


@styled
def draw_shares(curves: Mapping[str, Sequence[tuple[str, Bar, Bar]]], label: str) -> Figure:
    """Draw recall on the left and wrong matches on the right, %, over places on an abscissa called ``label``."""
    figure, axes = grid_figure(1, 2, height_in=3.2)
    places, drawn = list(dict.fromkeys(one[0] for curve in curves.values() for one in curve)), plot_styles(curves)
    for which, (panel, title) in enumerate(zip(axes[0], ("recall, %", "wrong matches, %"), strict=True), start=1):
        for k, (name, curve) in enumerate(curves.items()):
            at = np.array([places.index(one[0]) for one in curve]) + 0.06 * (k - 0.5 * (len(curves) - 1))
            bars = np.array([one[which] for one in curve], dtype=np.float64).reshape(-1, 3)
            draw_points(panel, Points(at, bars[:, 0], bars[:, 1:]), drawn[name], label=name)
        panel.set_xticks(range(len(places)), [place.replace(" deg", "") for place in places])
        panel.set(xlabel=label, ylabel=title)
        panel.set_ylim(bottom=0.0)
    axes[0, 0].set_ylim(0.0, 102.0)
    axes[0, 1].legend(loc="upper left")
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class MatchedRims:
    """Detected rims of the first and of the second image, and the matches between them.

    ``pairs`` (k, 2) are matched rims by their indices, ``right`` (k,) is True where both are of the same crater.
    ``missed`` (m, 2) are indices of the rims of craters that both images show and that are not matched correctly.
    """

    rims: tuple[Ellipses, Ellipses]
    pairs: IndexArray
    right: NDArray[np.bool_]
    missed: IndexArray


@styled
def draw_matched_pair(
    images: tuple[NDArray[np.float32], NDArray[np.float32]], found: MatchedRims, title: str
) -> Figure:
    """Draw both images; correctly matched craters have the same colour and number in both.

    Of an empty image the rims alone are drawn.
    """
    figure, panels = new_figure(2, width_in=11.0, height_in=5.0)
    colours = colormaps["turbo"](np.linspace(0.05, 0.95, max(int(found.right.sum()), 1)))
    for side, (axes, image) in enumerate(zip(panels, images, strict=True)):
        rims, name = found.rims[side], ("first", "second")[side]
        plain = image.size == 0
        if not plain:
            show_image(axes, image)
            axes.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0))
        draw_rims(axes, rims, GREY, width=0.5)
        missed = rims[found.missed[:, side]]
        draw_rims(axes, missed, _MISSED_ON_WHITE if plain else _MISSED, width=1.0, dashed=True)
        draw_rims(axes, rims[found.pairs[~found.right, side]], VERMILION, width=1.3, dashed=True)
        for number, (row, colour) in enumerate(zip(found.pairs[found.right, side], colours, strict=False)):
            draw_rims(axes, rims[np.array([row])], colour, width=1.3)
            axes.annotate(
                str(number + 1), tuple(rims.centre_px[row]), color=colour, fontsize=6.5, ha="center", va="center"
            )
        if plain:
            axes.set_aspect("equal")
            axes.autoscale_view()
            axes.invert_yaxis()
        hide_axes(axes)
        axes.set_title(f"{name} look: {len(rims)} detections")
    right, wrong = int(found.right.sum()), int((~found.right).sum())
    return finish(figure, f"{title}: {right} right, {wrong} wrong, {len(found.missed)} missed")


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
