"""Outlines of the body at several poses over an image, and residuals of the image against its renderings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.reports.figures.style import BLUE, GREEN, ORANGE, finish, grid_figure, hide_axes, image_panel, styled
from boresight.reports.schema.grid import shortest
from boresight.scenarios.arrays import FloatArray

POSE_COLOURS = {"prior": ORANGE, "estimate": BLUE, "truth": GREEN}
_MARGIN = 0.08
_SPREAD_PERCENT = 99.5


@dataclass(frozen=True, slots=True, eq=False)
class PoseRendering:
    """Rendering of the body at one pose, against the image.

    Parameters
    ----------
    name
        ``prior``, ``estimate`` or ``truth``; sets the colour.
    heading
        Printed above the panel.
    body
        (H, W) pixels whose lines of sight meet the body.
    residual
        (H, W) image less the rendering, the latter scaled to the image.
    """

    name: str
    heading: str
    body: NDArray[np.bool_]
    residual: FloatArray


@styled
def draw_pose_renderings(
    image: NDArray[np.floating], renderings: Sequence[PoseRendering], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw the outline of the body at each pose over the image, and below it the image less the rendering.

    All residuals share one colour scale. Those within the rounding of the image's float32 are 0.
    """
    window = _body_window(image, renderings)
    (left, right), (top, bottom) = window
    height, width = image.shape
    aspect = min(max((bottom - top) / (right - left), 0.4), 1.6)
    width_in = 3.3 * len(renderings) + 0.7
    figure, panels = grid_figure(2, len(renderings), width_in=width_in, height_in=2 * 3.2 * aspect + 1.0)
    rounding = float(np.finfo(np.float32).eps * np.abs(image).max(initial=0.0))
    residuals = [np.where(np.abs(one.residual) > rounding, one.residual, 0.0) for one in renderings]
    limit = max((float(np.percentile(np.abs(one), _SPREAD_PERCENT)) for one in residuals), default=0.0) or 1.0
    for k, (one, residual) in enumerate(zip(renderings, residuals, strict=True)):
        over, below = panels[0, k], panels[1, k]
        image_panel(over, image, window=window)
        outline(over, one.body, POSE_COLOURS[one.name])
        shown = below.imshow(
            residual, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=(0.0, width, height, 0.0), interpolation="nearest"
        )
        over.set_title(one.heading, color=POSE_COLOURS[one.name])
        rms = float(np.sqrt(np.mean(residual[one.body] ** 2))) if one.body.any() else float("nan")
        below.set_title(f"image less rendering: RMS {shortest(rms)} on the body")
        below.set(xlim=(left, right), ylim=(bottom, top))
        hide_axes(below)
    figure.colorbar(shown, ax=list(panels[1]), shrink=0.8, pad=0.01)
    return finish(figure, title, credit_lines)


def outline(axes: Axes, body: NDArray[np.bool_], colour: str) -> None:
    """Draw the outline of a body mask (H, W) over an image whose first pixel has its centre at (0.5, 0.5)."""
    if body.any() and not body.all():
        height, width = body.shape
        columns, rows = np.arange(width) + 0.5, np.arange(height) + 0.5
        axes.contour(columns, rows, body.astype(np.float64), levels=[0.5], colors=[colour], linewidths=1.0)


def _body_window(
    image: NDArray[np.floating], renderings: Sequence[PoseRendering]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return (left, right), (top, bottom) in pixels: the body at all poses with a margin, within the image."""
    height, width = image.shape
    rows, columns = np.nonzero(np.any([one.body for one in renderings], axis=0))
    if len(rows) == 0:
        return (0.0, float(width)), (0.0, float(height))
    margin = _MARGIN * float(max(np.ptp(rows), np.ptp(columns))) + 2.0
    return (
        (max(columns.min() - margin, 0.0), min(columns.max() + 1.0 + margin, float(width))),
        (max(rows.min() - margin, 0.0), min(rows.max() + 1.0 + margin, float(height))),
    )
