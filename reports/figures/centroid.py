"""Scatter plots of the offsets of the brightness centroid (Rowell et al. 2015, figure 4)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from boresight.reports.figures.style import BLUE, VERMILION, finish, grid_figure, styled
from boresight.reports.schema.grid import shortest
from boresight.scenarios.arrays import FloatArray


@styled
def draw_centroid_offsets(offsets: Mapping[str, FloatArray], title: str) -> Figure:
    """Draw the offsets of each group with the 1-sigma ellipse of their sample covariance, on the same axes.

    Parameters
    ----------
    offsets
        Title of each panel and its (n, 2) offsets (du, dv), px.
    """
    columns = min(len(offsets), 4)
    rows = -(-len(offsets) // columns)
    figure, panels = grid_figure(rows, columns, width_in=2.6 * columns + 0.3, height_in=2.9 * rows + 0.4)
    # In whole pixels, with all offsets within.
    reach = [float(np.abs(sample).max()) for sample in offsets.values() if len(sample)]
    limit = max(1.0, float(np.ceil(max(reach, default=1.0))))
    for axes, (name, sample) in zip(panels.ravel(), offsets.items(), strict=False):
        axes.axhline(0.0, color="#9aa0a6", linewidth=0.7)
        axes.axvline(0.0, color="#9aa0a6", linewidth=0.7)
        axes.plot(*sample.T, ".", markersize=2.6, color=BLUE, alpha=0.55, markeredgewidth=0.0, rasterized=True)
        if len(sample) > 1:
            axes.add_patch(one_sigma_ellipse(sample))
        sigma = np.sqrt(np.trace(np.atleast_2d(np.cov(sample.T))) / 2.0) if len(sample) > 1 else 0.0
        axes.set_title(f"{name}\nn = {len(sample)}, $\\sigma$ = {shortest(sigma, 2)} px", fontsize=8.5)
        axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="$\\Delta u$, px")
    for axes in panels.ravel()[len(offsets) :]:
        axes.set_visible(False)
    for row in panels:
        row[0].set_ylabel("$\\Delta v$, px")
    return finish(figure, title)


def one_sigma_ellipse(sample: FloatArray) -> Ellipse:
    """Return the one-sigma ellipse of the mean and covariance of a sample (n, 2)."""
    variances, vectors = np.linalg.eigh(np.cov(sample.T))
    small, large = 2.0 * np.sqrt(np.maximum(variances, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    centre = sample.mean(axis=0)
    # Above the points: a dense cloud would hide it.
    return Ellipse(tuple(centre), large, small, angle=angle, fill=False, edgecolor=VERMILION, linewidth=1.5, zorder=3.0)
