"""From landmarks to a surface (the paper's figure 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.style import BLUE, VERMILION, FloatArray, hide_axes, new_figure, styled

_EDGE = "#3c4043"


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceView:
    """A triangulation and its surface as one camera sees them, in pixels.

    Parameters
    ----------
    landmarks_px
        (n, 2) all landmarks.
    edges_px
        (e, 2, 2) ends of all edges of the tetrahedra.
    facets_px
        (f, 3, 2) the facets that face the camera, the farthest first.
    shades
        (f,) brightness of each, 0 to 1.
    normals_px
        (f, 2, 2) centre of each facet, and the tip of its outward normal.
    n_tetrahedra, n_facets
        How many there are in all.
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
    """Draw the Delaunay triangulation, the concave hull and its normals, from one place.

    Parameters
    ----------
    view
        What to draw.
    title
        Printed above the panels.
    """
    points = np.concatenate([view.landmarks_px, view.normals_px.reshape(-1, 2)])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float((high - low).max())
    width, height = high - low + 2.0 * margin
    figure, panels = new_figure(3, width_in=10.5, height_in=0.75 + 3.4 * float(height / width))
    _draw_edges(panels[0], view)
    _draw_facets(panels[1], view)
    _draw_normals(panels[2], view)
    names = (
        f"(a) Delaunay triangulation ({view.n_tetrahedra} tetrahedra)",
        f"(b) concave hull ({view.n_facets} facets)",
        "(c) outward normals",
    )
    for axes, name in zip(panels, names, strict=True):
        axes.set_title(name)
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(high[1] + margin, low[1] - margin), aspect="equal")
        hide_axes(axes)
    figure.suptitle(title, fontsize=10)
    return figure


def _draw_edges(axes: Axes, view: SurfaceView) -> None:
    axes.add_collection(LineCollection(list(view.edges_px), colors=BLUE, linewidths=0.25, alpha=0.35))
    axes.plot(*view.landmarks_px.T, ".", markersize=2.4, color=_EDGE, markeredgewidth=0.0)


def _draw_facets(axes: Axes, view: SurfaceView) -> None:
    axes.add_collection(_surface(view, 0.35 + 0.65 * view.shades))


def _draw_normals(axes: Axes, view: SurfaceView) -> None:
    axes.add_collection(_surface(view, np.full_like(view.shades, 0.93)))
    axes.add_collection(LineCollection(list(view.normals_px), colors=VERMILION, linewidths=0.7))


def _surface(view: SurfaceView, shades: FloatArray) -> PolyCollection:
    colours: NDArray[np.float64] = np.repeat(shades[:, None], 3, axis=1)
    return PolyCollection(list(view.facets_px), facecolors=colours, edgecolors=_EDGE, linewidths=0.3)
