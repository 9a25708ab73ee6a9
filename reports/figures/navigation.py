"""The chain of crater navigation: craters an image, images a landmark, and when each landmark was seen."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from reports.figures.style import BLUE, GREY, ORANGE, new_figure, styled


@styled
def draw_counts(images: pd.DataFrame, landmarks: pd.DataFrame, title: str) -> Figure:
    """Draw how many craters images have (figure 8b of Cheng et al. 2003), and how many images landmarks (figure 9).

    Parameters
    ----------
    images
        Columns ``n_detections`` and ``n_numbered``.
    landmarks
        Column ``hits``.
    title
        Printed above.
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
    """Draw from when to when each landmark was seen, those with sightings of another crater marked.

    Parameters
    ----------
    landmarks
        Columns ``first_days``, ``last_days``, ``hits`` and ``n_other``.
    title
        Printed above.
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
    # Bars go from one corner to the other, so that no place within is free of them.
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    figure.suptitle(title)
    return figure
