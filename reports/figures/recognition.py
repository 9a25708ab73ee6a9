"""Figures of one image: landmark recognition, matches with residuals, the body rendered at several poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SKY,
    VERMILION,
    finish,
    grid_figure,
    hide_axes,
    image_panel,
    new_figure,
    styled,
    window_around,
    windowed,
)
from boresight.reports.schema.grid import shortest
from boresight.scenarios.arrays import FloatArray

MATCH_SIGMAS = 6.0
POSE_COLOURS = {"prior": ORANGE, "estimate": BLUE, "truth": GREEN}
_MARGIN = 0.08
_SPREAD_PERCENT = 99.5


@dataclass(frozen=True, slots=True, eq=False)
class MatchedLandmarks:
    """Matched landmarks of one image.

    ``seen_px`` (n, 2) is where each was found in the image, ``predicted_px`` (n, 2) where the estimate projects its
    mean. ``error_m`` (n,) is the distance of the true surface point seen there from the landmark; NaN where the line of
    sight misses the body.
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
    """Draw matches with magnified residuals over the image, the residuals alone, and residuals over true errors."""
    figure, (over, spread, errors) = new_figure(3, width_in=10.6, height_in=3.7)
    residual_px, length_px = found.residual_px, np.linalg.norm(found.residual_px, axis=1)
    # Residuals are drawn larger by a round factor with which the median is about a thirtieth of the image.
    wanted = max(image.shape) / 30.0 / max(float(np.median(length_px)) if len(length_px) else 0.0, 1e-6)
    scale = min((1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0), key=lambda step: abs(np.log(step / wanted)))
    window = window_around(np.concatenate([found.seen_px, found.predicted_px]), 0.15, 10.0, image)
    image_panel(over, image, f"{len(found.seen_px)} landmarks: seen less predicted, x {scale:g}", window)
    over.plot(*found.predicted_px.T, "o", markersize=4, markerfacecolor="none", markeredgecolor=ORANGE)
    over.quiver(
        *found.predicted_px.T, *(scale * residual_px).T, angles="xy", scale_units="xy", scale=1.0, color=VERMILION,
        width=0.004,
    )  # fmt: skip
    spread.plot(*residual_px.T, "o", markersize=3.5, color=VERMILION, alpha=0.8)
    rms = float(np.sqrt(np.mean(residual_px**2))) if len(residual_px) else float("nan")
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    spread.plot(rms * np.cos(angle), rms * np.sin(angle), color=GREY, linewidth=0.9, label=f"RMS {shortest(rms, 2)} px")
    reach = 1.1 * max(float(np.abs(residual_px).max(initial=0.0)), rms, 1e-9) if len(residual_px) else 1.0
    spread.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="column residual, px", ylabel="row residual, px")
    spread.set_aspect("equal")
    spread.legend(loc="upper right")
    # A small residual with a large true error is a wrong match.
    known = np.isfinite(found.error_m)
    errors.plot(found.error_m[known], length_px[known], "o", markersize=3.5, color=BLUE)
    missed = int(np.count_nonzero(~known))
    errors.set(xlabel="distance of the seen surface point from the landmark, m", ylabel="residual, px")
    errors.set_title(f"{missed} lines of sight miss the body" if missed else "")
    errors.set_xlim(left=0.0)
    errors.set_ylim(bottom=0.0)
    return finish(figure, title, credit_lines)


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """Landmarks and mesh of the data base, projected into an image with one pose.

    ``landmarks_px`` (n, 2) are the means (u, v) of the visible landmarks, ``covariances_px2`` (n, 2, 2) their
    covariances, None to draw no ellipses, ``edges_px`` (m, 2, 2) the ends (u, v) of the visible edges of the mesh.
    """

    landmarks_px: FloatArray
    covariances_px2: FloatArray | None
    edges_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FitPanels:
    """Projections and matches of one recognition, all in pixels of the image.

    The observed image (H, W), and the mesh rendered with the pose of the first iteration; the data base with the prior
    pose and with the final pose; brightness centroids (2,) of the two images; Harris corners (k, 2), and which of them
    were ``matched`` (k,) with a landmark.
    """

    image: NDArray[np.floating]
    mesh_image: NDArray[np.floating]
    before: Overlay
    after: Overlay
    observed_centroid_px: FloatArray
    rendered_centroid_px: FloatArray
    corners_px: FloatArray
    matched: NDArray[np.bool_]


@styled
def draw_fit_panels(fit: FitPanels, title: str, credit_lines: Sequence[str] = (), *, aligned: bool = False) -> Figure:
    """Draw the initial fit, the rendered mesh and the converged fit (Rowell et al. 2015, figure 8), all cropped.

    With ``aligned``, ``after`` is the data base with the pose whose centroids are aligned, without corners (figure 3).
    """
    points = np.concatenate([fit.before.edges_px.reshape(-1, 2), fit.after.edges_px.reshape(-1, 2), fit.corners_px])
    shape = fit.image.shape
    window = window_around(points, 0.06, 0.0, fit.image) if len(points) else ((0.0, shape[1]), (0.0, shape[0]))
    (left, right), (top, bottom) = window
    height_in = 1.25 + 3.35 * min((bottom - top) / (right - left), 2.0)
    figure, panels = new_figure(3, width_in=10.5, height_in=height_in)
    last = "fit after the alignment of the centroids" if aligned else "converged fit"
    names = ("(a) initial fit", "(b) mesh rendered for the first iteration", f"(c) {last}")
    for axes, image, name in zip(panels, (fit.image, fit.mesh_image, fit.image), names, strict=True):
        image_panel(axes, image, name, window)
    first, _, third = panels
    for axes, overlay in ((first, fit.before), (third, fit.after)):
        axes.add_collection(LineCollection(list(overlay.edges_px), colors=ORANGE, linewidths=0.45, alpha=0.75))
    if fit.before.covariances_px2 is not None:
        first.add_collection(_ellipses(first, fit.before.landmarks_px, fit.before.covariances_px2))
    for (u, v), colour in ((fit.observed_centroid_px, "black"), (fit.rendered_centroid_px, VERMILION)):
        first.plot(u, v, "o", markersize=6, color=colour, markeredgecolor="white", markeredgewidth=0.9, zorder=5)
    marks = [
        _dot("o", "black", "black", "observed centroid"),
        _dot("o", VERMILION, VERMILION, "rendered centroid"),
        Line2D([], [], color=SKY, label=f"{MATCH_SIGMAS:g}-sigma search"),
        Line2D([], [], color=ORANGE, label="mesh"),
    ]
    if not aligned:
        free, matched = fit.corners_px[~fit.matched], fit.corners_px[fit.matched]
        third.plot(*free.T, "D", markersize=3.4, markerfacecolor="none", markeredgecolor=VERMILION, markeredgewidth=0.8)
        third.plot(*matched.T, "D", markersize=4.2, color=VERMILION, markeredgecolor="white", markeredgewidth=0.5)
        marks += [
            _dot("D", "none", VERMILION, f"corner, not matched ({len(free)})"),
            _dot("D", VERMILION, VERMILION, f"corner matched with a landmark ({len(matched)})"),
        ]
    figure.legend(
        handles=marks, loc="outside lower center", ncols=len(marks), columnspacing=1.2, handlelength=1.4,
        title="; ".join(credit_lines) or None, title_fontsize=7,
    )  # fmt: skip
    figure.suptitle(title, fontsize=10)
    return figure


def _ellipses(axes: Axes, centres_px: FloatArray, covariances_px2: FloatArray) -> EllipseCollection:
    """Build the ellipses within which a corner can match a landmark (Mahalanobis d^2 < 36)."""
    variances, vectors = np.linalg.eigh(covariances_px2)
    diameters = 2.0 * MATCH_SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    return EllipseCollection(
        diameters[:, 1], diameters[:, 0], angles, units="xy", offsets=centres_px, transOffset=axes.transData,
        facecolors="none", edgecolors=SKY, linewidths=0.8,
    )  # fmt: skip


def _dot(marker: str, face: str, edge: str, label: str) -> Line2D:
    return Line2D([], [], marker=marker, color="none", markerfacecolor=face, markeredgecolor=edge, label=label)


@dataclass(frozen=True, slots=True, eq=False)
class PoseRendering:
    """Rendering of the body at one pose, against the image.

    ``name`` is ``prior``, ``estimate`` or ``truth`` and sets the colour; ``heading`` is above the panel. ``body`` (H,
    W) are the pixels whose lines of sight meet the body, ``residual`` (H, W) is the image less the rendering, scaled to
    the image.
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

    All residuals share one colour scale, that of the part that is shown. Those within the rounding of the image's
    float32 are 0.
    """
    window = _body_window(image, renderings)
    (left, right), (top, bottom) = window
    height, width = image.shape
    aspect = min(max((bottom - top) / (right - left), 0.4), 1.6)
    width_in = 3.3 * len(renderings) + 0.7
    figure, panels = grid_figure(2, len(renderings), width_in=width_in, height_in=2 * 3.2 * aspect + 1.0)
    rounding = float(np.finfo(np.float32).eps * np.abs(image).max(initial=0.0))
    residuals = [np.where(np.abs(one.residual) > rounding, one.residual, 0.0) for one in renderings]
    shown_px = [np.abs(windowed(one, window)) for one in residuals]
    limit = max((float(np.percentile(one, _SPREAD_PERCENT)) for one in shown_px), default=0.0) or 1.0
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
