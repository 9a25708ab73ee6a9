"""From candidate points to landmarks (the paper's figure 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.style import FloatArray, hide_axes, new_figure, show_image, styled

# A golden-angle walk through the hues, so that neighbours in the list differ.
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True, eq=False)
class ClusterView:
    """Clusters of points as one camera sees them.

    Parameters
    ----------
    seed_px, merged_px
        (n, 2) and (m, 2) the points on the near side that belong to a seed cluster, and to a merged one.
    seed_of, merged_of
        (n,) and (m,) number of the cluster of each.
    image
        (H, W) the body from there.
    """

    seed_px: FloatArray
    seed_of: NDArray[np.intp]
    merged_px: FloatArray
    merged_of: NDArray[np.intp]
    image: NDArray[np.floating]


@styled
def draw_clusters(view: ClusterView, title: str) -> Figure:
    """Draw seed clusters, merged clusters and the body, seen from one place and cropped alike.

    Parameters
    ----------
    view
        What to draw.
    title
        Printed above the panels.
    """
    (left, right), (top, bottom) = _window(view.image)
    height_in = 0.75 + 3.4 * (bottom - top) / (right - left)
    figure, (first, second, third) = new_figure(3, width_in=10.5, height_in=height_in)
    _scatter(first, view.seed_px, view.seed_of)
    _scatter(second, view.merged_px, view.merged_of)
    show_image(third, view.image)
    seeds, merged = (len(np.unique(numbers)) for numbers in (view.seed_of, view.merged_of))
    names = (f"(a) seed clusters ({seeds} in view)", f"(b) merged clusters ({merged} in view)", "(c) the body")
    for axes, name in zip((first, second, third), names, strict=True):
        axes.set_title(name)
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        hide_axes(axes)
    figure.suptitle(title, fontsize=10)
    return figure


def _scatter(axes: Axes, points_px: FloatArray, cluster: NDArray[np.intp]) -> None:
    u, v = points_px.T
    axes.scatter(u, v, s=1.6, c=cluster_colours(cluster), linewidths=0.0, rasterized=True)


def cluster_colours(cluster: NDArray[np.intp]) -> FloatArray:
    """Give each cluster number a colour of its own, (n, 3)."""
    hue = np.mod(cluster * _GOLDEN, 1.0) * 6.0
    value = np.where(np.mod(cluster, 2) == 0, 0.85, 0.6)
    ramps = [np.clip(np.abs(np.mod(hue + shift, 6.0) - 3.0) - 1.0, 0.0, 1.0) for shift in (0.0, 4.0, 2.0)]
    return np.asarray(np.stack(ramps, axis=1) * value[:, None], dtype=np.float64)


def _window(image: NDArray[np.floating]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Bounds (left, right), (top, bottom) of the lit body with a margin."""
    rows, columns = np.nonzero(image > 0.0)
    left, right = float(columns.min()), float(columns.max()) + 1.0
    top, bottom = float(rows.min()), float(rows.max()) + 1.0
    margin = 0.05 * max(right - left, bottom - top)
    return (left - margin, right + margin), (top - margin, bottom + margin)
