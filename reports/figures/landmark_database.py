"""Figures of a landmark data base: clusters of points, triangulation and mesh (Rowell et al. 2015, figures 1 and 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.reports.figures.style import BLUE, VERMILION, hide_axes, new_figure, show_image, styled, window_around
from boresight.scenarios.arrays import FloatArray

# Steps of the golden ratio through the hues, so that consecutive numbers have different colours.
_GOLDEN = 0.6180339887498949

_EDGE = "#3c4043"


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceView:
    """A triangulation and its surface as one camera sees them, in pixels.

    Parameters
    ----------
    landmarks_px
        (n, 2) positions of all landmarks.
    edges_px
        (e, 2, 2) ends of all edges of the tetrahedra.
    facets_px
        (f, 3, 2) corners of the facets that face the camera, the farthest first.
    shades
        (f,) brightness of each, 0 to 1.
    normals_px
        (f, 2, 2) centre of each facet, and the tip of its outward normal.
    n_tetrahedra, n_facets
        Their total numbers.
    """

    landmarks_px: FloatArray
    edges_px: FloatArray
    facets_px: FloatArray
    shades: FloatArray
    normals_px: FloatArray
    n_tetrahedra: int
    n_facets: int


@styled
def draw_triangulation(view: SurfaceView, title: str) -> Figure:
    """Draw the Delaunay triangulation, the concave hull and its normals, as one camera sees them.

    Parameters
    ----------
    view
        Their projection.
    """
    names = (
        f"(a) Delaunay triangulation ({view.n_tetrahedra} tetrahedra)",
        f"(b) concave hull ({view.n_facets} facets)",
        "(c) outward normals",
    )
    points = np.concatenate([view.landmarks_px, view.normals_px.reshape(-1, 2)])
    figure, panels = _cropped_panels(points, 0.04, names, title)
    panels[0].add_collection(LineCollection(list(view.edges_px), colors=BLUE, linewidths=0.25, alpha=0.35))
    panels[0].plot(*view.landmarks_px.T, ".", markersize=2.4, color=_EDGE, markeredgewidth=0.0)
    panels[1].add_collection(_surface(view, 0.35 + 0.65 * view.shades))
    panels[2].add_collection(_surface(view, np.full_like(view.shades, 0.93)))
    panels[2].add_collection(LineCollection(list(view.normals_px), colors=VERMILION, linewidths=0.7))
    return figure


def _cropped_panels(
    points_px: FloatArray, margin: float, names: Sequence[str], title: str
) -> tuple[Figure, list[Axes]]:
    """Make named panels that show the part of the image around points (n, 2), with a margin as a share of its size."""
    (left, right), (top, bottom) = window_around(points_px, margin)
    height_in = 0.75 + 3.4 * (bottom - top) / (right - left)
    figure, panels = new_figure(len(names), width_in=10.5, height_in=height_in)
    for axes, name in zip(panels, names, strict=True):
        axes.set(title=name, xlim=(left, right), ylim=(bottom, top), aspect="equal")
        hide_axes(axes)
    figure.suptitle(title, fontsize=10)
    return figure, panels


def _surface(view: SurfaceView, shades: FloatArray) -> PolyCollection:
    colours: NDArray[np.float64] = np.repeat(shades[:, None], 3, axis=1)
    return PolyCollection(list(view.facets_px), facecolors=colours, edgecolors=_EDGE, linewidths=0.3)


@dataclass(frozen=True, slots=True, eq=False)
class ClusterView:
    """Clusters of points as one camera sees them.

    Parameters
    ----------
    seed_px, merged_px
        (n, 2) and (m, 2) points on the near side that belong to a seed cluster, and to a merged cluster.
    seed_of, merged_of
        (n,) and (m,) number of the cluster of each point.
    image
        (H, W) image of the body by this camera.
    """

    seed_px: FloatArray
    seed_of: NDArray[np.intp]
    merged_px: FloatArray
    merged_of: NDArray[np.intp]
    image: NDArray[np.floating]


@styled
def draw_clusters(view: ClusterView, title: str) -> Figure:
    """Draw seed clusters, merged clusters and the body as one camera sees them, all cropped to the body.

    Parameters
    ----------
    view
        Their projection.
    """
    rows, columns = np.nonzero(view.image > 0.0)
    corners = np.stack([columns, rows], axis=1).astype(np.float64)
    seeds, merged = (len(np.unique(numbers)) for numbers in (view.seed_of, view.merged_of))
    names = (f"(a) seed clusters ({seeds} in view)", f"(b) merged clusters ({merged} in view)", "(c) the body")
    figure, panels = _cropped_panels(np.concatenate([corners, corners + 1.0]), 0.05, names, title)
    for axes, points, cluster in zip(
        panels, (view.seed_px, view.merged_px), (view.seed_of, view.merged_of), strict=False
    ):
        u, v = points.T
        axes.scatter(u, v, s=1.6, c=cluster_colours(cluster), linewidths=0.0, rasterized=True)
    show_image(panels[2], view.image)
    return figure


def cluster_colours(cluster: NDArray[np.intp]) -> FloatArray:
    """Return a colour (n, 3) for each cluster number; consecutive numbers have different colours."""
    hue = np.mod(cluster * _GOLDEN, 1.0) * 6.0
    value = np.where(np.mod(cluster, 2) == 0, 0.85, 0.6)
    ramps = [np.clip(np.abs(np.mod(hue + shift, 6.0) - 3.0) - 1.0, 0.0, 1.0) for shift in (0.0, 4.0, 2.0)]
    return np.asarray(np.stack(ramps, axis=1) * value[:, None], dtype=np.float64)
