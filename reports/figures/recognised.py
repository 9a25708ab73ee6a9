"""Landmarks that an estimator recognised in an image, and how far each lies from where its estimate puts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    FloatArray,
    add_credits,
    hide_axes,
    new_figure,
    show_image,
    styled,
)


@dataclass(frozen=True, slots=True, eq=False)
class MatchedLandmarks:
    """Matched landmarks of one image.

    Parameters
    ----------
    seen_px
        (n, 2) where each was found in the image.
    predicted_px
        (n, 2) where the estimate projects its mean.
    error_m
        (n,) distance of the true surface point seen there from the landmark; NaN where the line of sight misses the
        body.
    """

    seen_px: FloatArray
    predicted_px: FloatArray
    error_m: FloatArray

    @property
    def residual_px(self) -> FloatArray:
        """(n, 2) seen less predicted."""
        return self.seen_px - self.predicted_px


@styled
def draw_matched_landmarks(
    image: NDArray[np.floating], found: MatchedLandmarks, title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw matches with magnified residuals over the image, residuals alone, and residuals over true errors."""
    figure, (over, spread, errors) = new_figure(3, width_in=10.6, height_in=3.7)
    show_image(over, image)
    scale = _magnification(image, found.residual_px)
    _draw_arrows(over, image, found, scale)
    _draw_spread(spread, found.residual_px)
    _draw_true_errors(errors, found)
    figure.suptitle(title, fontsize=9.5)
    add_credits(figure, credit_lines)
    return figure


def _magnification(image: NDArray[np.floating], residual_px: FloatArray) -> float:
    """Choose a round factor at which the median residual is a thirtieth of the image."""
    median = float(np.median(np.linalg.norm(residual_px, axis=1))) if len(residual_px) else 0.0
    wanted = max(image.shape) / 30.0 / max(median, 1e-6)
    return min((step for step in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)), key=lambda step: abs(np.log(step / wanted)))


def _draw_arrows(axes: Axes, image: NDArray[np.floating], found: MatchedLandmarks, scale: float) -> None:
    axes.plot(*found.predicted_px.T, "o", markersize=4, markerfacecolor="none", markeredgecolor=ORANGE)
    axes.quiver(
        *found.predicted_px.T, *(scale * found.residual_px).T, angles="xy", scale_units="xy", scale=1.0,
        color=VERMILION, width=0.004,
    )  # fmt: skip
    axes.set(**_landmark_window(image, found))
    axes.set_title(f"{len(found.seen_px)} landmarks: seen less predicted, x {scale:g}")
    hide_axes(axes)


def _landmark_window(image: NDArray[np.floating], found: MatchedLandmarks) -> dict[str, tuple[float, float]]:
    """Limits of the axes: the landmarks with a margin, within the image."""
    height, width = image.shape
    points = np.concatenate([found.seen_px, found.predicted_px])
    margin = 0.15 * float(np.ptp(points, axis=0).max()) + 10.0
    left, top = np.maximum(points.min(axis=0) - margin, 0.0)
    right, bottom = np.minimum(points.max(axis=0) + margin, (width, height))
    return {"xlim": (float(left), float(right)), "ylim": (float(bottom), float(top))}


def _draw_spread(axes: Axes, residual_px: FloatArray) -> None:
    axes.plot(*residual_px.T, "o", markersize=3.5, color=VERMILION, alpha=0.8)
    rms = float(np.sqrt(np.mean(residual_px**2))) if len(residual_px) else float("nan")
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    axes.plot(rms * np.cos(angle), rms * np.sin(angle), color=GREY, linewidth=0.9, label=f"RMS {rms:.2g} px")
    reach = 1.1 * max(float(np.abs(residual_px).max(initial=0.0)), rms, 1e-9) if len(residual_px) else 1.0
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="column residual, px", ylabel="row residual, px")
    axes.set_aspect("equal")
    axes.legend(loc="upper right")


def _draw_true_errors(axes: Axes, found: MatchedLandmarks) -> None:
    """Residual over the landmark's true error: a match that lies far off in space and not in the image is wrong."""
    known = np.isfinite(found.error_m)
    length_px = np.linalg.norm(found.residual_px, axis=1)
    axes.plot(found.error_m[known], length_px[known], "o", markersize=3.5, color=BLUE)
    missed = int(np.count_nonzero(~known))
    axes.set(xlabel="distance of what is seen from the landmark, m", ylabel="residual, px")
    axes.set_title(f"{missed} look past the body" if missed else "")
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
