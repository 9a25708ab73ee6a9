"""Craters in an image: edges, their grouping and what was detected (figures 2 and 3 of Cheng et al. 2003)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.style import BLUE, GREEN, ORANGE, VERMILION, grid_figure, hide_axes, new_figure, show_image, styled
from scenarios.geometry import Ellipses

FloatArray = NDArray[np.float64]


def draw_rims(axes: Axes, ellipses: Ellipses, colour: str, width: float = 1.0, dashed: bool = False) -> None:
    """Draw rims over an image."""
    if len(ellipses):
        points, _ = ellipses.points(96)
        closed = np.concatenate([points, points[:, :1]], axis=1)
        axes.add_collection(
            LineCollection(list(closed), colors=colour, linewidths=width, linestyles="--" if dashed else "-")
        )


def _show_titled(axes: Axes, image: NDArray[np.float32], title: str) -> None:
    show_image(axes, image)
    height, width = image.shape
    axes.set(xlim=(0, width), ylim=(height, 0))
    hide_axes(axes)
    axes.set_title(title)


@styled
def draw_stages(
    image: NDArray[np.float32],
    edges: NDArray[np.bool_],
    arcs: Mapping[str, Sequence[FloatArray]],
    detected: Ellipses,
) -> Figure:
    """Draw the four panels of figure 2: the image, all edges, grouped edges and detected craters.

    Parameters
    ----------
    edges
        (H, W) edge pixels of both passes.
    arcs
        Grouped edges, each (n, 2) pixels, under ``shaded`` and ``lit``.
    """
    figure, panels = grid_figure(2, 2, width_in=9.0, height_in=7.2)
    _show_titled(panels[0, 0], image, "a  image")
    _show_titled(panels[0, 1], np.where(edges, 0.0, 1.0).astype(np.float32), "b  edges of both passes")
    _show_titled(panels[1, 0], image, "c  convex rim edges: shaded side blue, lit side orange")
    for side, colour in (("shaded", BLUE), ("lit", ORANGE)):
        panels[1, 0].add_collection(LineCollection(list(arcs[side]), colors=colour, linewidths=1.0))
    _show_titled(panels[1, 1], image, f"d  {len(detected)} detected craters")
    draw_rims(panels[1, 1], detected, GREEN)
    return figure


@styled
def draw_detections(
    image: NDArray[np.float32], detected: Ellipses, predicted: Ellipses, names: Sequence[str], title: str
) -> Figure:
    """Draw detected rims over an image (figure 3), and dashed and named those where craters were expected."""
    figure, (axes,) = new_figure(1, width_in=8.0, height_in=6.4)
    _show_titled(axes, image, title)
    draw_rims(axes, detected, GREEN)
    draw_rims(axes, predicted, VERMILION, dashed=True)
    for name, centre, radius in zip(names, predicted.centre_px, predicted.radius_px, strict=True):
        axes.annotate(name, centre - [0.0, radius + 3.0], color=VERMILION, fontsize=8, ha="center", va="bottom")
    return figure
