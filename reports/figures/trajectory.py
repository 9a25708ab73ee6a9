"""Figures of one trial of a sequence: trajectory, errors with their covariance, tracks and landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    finish,
    grid_figure,
    mark_revolutions,
    new_figure,
    styled,
)
from boresight.scenarios.arrays import FloatArray

SIGMAS = 3.0
ANOMALY, TIME = "anomaly, deg", "time, s"
_COMPONENTS = ("radial", "along-track", "cross-track")


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryErrors:
    """An estimated trajectory and the true one.

    Parameters
    ----------
    along
        (F,) of each estimated frame what errors are drawn over.
    true_m, estimated_m
        (F, 3) inertial positions in the axes of the orbit: towards the first position, along the motion there, and
        across the plane.
    error_m
        (F, 3) radial, along-track and cross-track components of the error.
    sigma_m
        (F, 3) standard deviation of each component by the estimator's covariance; NaN where it has none.
    body_radius_m
        Radius of a sphere around the body.
    abscissa
        Label of ``along``: the anomaly since the first frame, or the time along a trajectory of given states.
    """

    along: FloatArray
    true_m: FloatArray
    estimated_m: FloatArray
    error_m: FloatArray
    sigma_m: FloatArray
    body_radius_m: float
    abscissa: str = ANOMALY


@dataclass(frozen=True, slots=True, eq=False)
class TrackLifetimes:
    """Lifetimes of the tracks of a sequence, and errors of their landmarks.

    Parameters
    ----------
    first, last
        (T,) abscissa of the first and of the last frame that sees the track.
    error_m
        (T,) error of its landmark when it was last seen; NaN where the estimator had no landmark.
    wrong_at
        (k, 2) abscissa and track of each wrong sighting.
    per_frame
        (F, 2) abscissa and number of tracks.
    ended
        Abscissa of the last estimated frame; None where all frames are estimated.
    abscissa
        Its label, see `TrajectoryErrors`.
    """

    first: FloatArray
    last: FloatArray
    error_m: FloatArray
    wrong_at: FloatArray
    per_frame: FloatArray
    ended: float | None = None
    abscissa: str = ANOMALY


@styled
def draw_trajectory(trajectory: TrajectoryErrors, title: str) -> Figure:
    """Draw the trajectory in the plane of the orbit and edge-on, with magnified errors."""
    figure, (plane, edge) = new_figure(2, width_in=9.0, height_in=4.6)
    # Errors are drawn larger by the largest round factor at which none exceeds a sixth of the orbit's radius.
    largest = float(np.linalg.norm(trajectory.error_m, axis=1).max(initial=0.0))
    room = float(np.linalg.norm(trajectory.true_m, axis=1).max(initial=1.0)) / 6.0
    scale = max((s for s in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if s * largest <= room), default=1.0)
    estimate = "estimate" if scale == 1.0 else f"estimate, error x {scale:g}"
    shown = trajectory.true_m + scale * (trajectory.estimated_m - trajectory.true_m)
    across = "across the orbit, m" if trajectory.abscissa == ANOMALY else "across both, m"
    pairs = ((plane, 1, 1e-3, "along the first motion, km"), (edge, 2, 1.0, across))
    for axes, which, unit, label in pairs:
        scaled = np.array([1e-3, unit])
        true, estimated = (points_m[:, [0, which]] * scaled for points_m in (trajectory.true_m, shown))
        axes.plot(*true.T, color=GREEN, linewidth=1.6, label="truth")
        axes.plot(*estimated.T, color=BLUE, linewidth=1.0, linestyle="--", label=estimate)
        axes.plot(*true[:1].T, "o", color=GREEN, markersize=5, label="first frame")
        axes.plot(*estimated[-1:].T, "s", color=BLUE, markersize=5, label="last estimate")
        axes.set(xlabel="towards the first position, km", ylabel=label)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    radius_km = 1e-3 * trajectory.body_radius_m
    plane.fill(radius_km * np.cos(angle), radius_km * np.sin(angle), color=GREY, alpha=0.35, label="body")
    plane.set_aspect("equal")
    return finish(figure, title, legend=plane, columns=5)


@styled
def draw_error_bands(trajectory: TrajectoryErrors, title: str) -> Figure:
    """Draw each component of the error over the frames, with the band of three standard deviations."""
    figure, panels = grid_figure(3, 1, width_in=7.5, height_in=6.0)
    for k, (axes, name) in enumerate(zip(panels[:, 0], _COMPONENTS, strict=True)):
        band = SIGMAS * trajectory.sigma_m[:, k]
        known = np.isfinite(band)
        if known.any():
            axes.fill_between(
                trajectory.along, -band, band, where=list(known), color=ORANGE, alpha=0.25, linewidth=0,
                label=f"{SIGMAS:g} sigma of its covariance",
            )  # fmt: skip
        axes.plot(trajectory.along, trajectory.error_m[:, k], color=BLUE, linewidth=1.1, label="error")
        axes.axhline(0.0, color=GREY, linewidth=0.7)
        outside = np.count_nonzero(np.abs(trajectory.error_m[known, k]) > band[known])
        share = f": {100.0 * outside / known.sum():.0f} % of frames outside" if known.any() else ": no covariance"
        axes.set_title(f"{name}{share}", loc="left")
        axes.set_ylabel("error, m")
        if trajectory.abscissa == ANOMALY:
            mark_revolutions(axes, trajectory.along)
    panels[0, 0].legend(loc="upper left", ncols=2)
    panels[-1, 0].set_xlabel(trajectory.abscissa)
    return finish(figure, title)


@styled
def draw_tracks(tracks: TrackLifetimes, title: str) -> Figure:
    """Draw the lifetime of every track, coloured by the error of its landmark, and the number of tracks per frame.

    Wrong sightings are marked by crosses.
    """
    figure, panels = grid_figure(2, 1, width_in=7.5, height_in=6.4)
    above, below = panels[:, 0]
    numbers = np.arange(len(tracks.first), dtype=np.float64)
    ends = np.stack([np.column_stack([tracks.first, numbers]), np.column_stack([tracks.last, numbers])], axis=1)
    known = np.isfinite(tracks.error_m)
    above.add_collection(LineCollection(list(ends[~known]), colors=GREY, linewidths=0.8, label="without a landmark"))
    lines = LineCollection(list(ends[known]), cmap="viridis", linewidths=1.0)
    lines.set_array(tracks.error_m[known])
    lines.set_clim(0.0, float(np.percentile(tracks.error_m[known], 95)) if known.any() else 1.0)
    above.add_collection(lines)
    figure.colorbar(lines, ax=above, label="landmark error when seen last, m", pad=0.01)
    if len(tracks.wrong_at):
        above.plot(*tracks.wrong_at.T, "x", color=VERMILION, markersize=4, label=f"{len(tracks.wrong_at)} seen wrongly")
    span = (0.0, float(tracks.per_frame[:, 0].max(initial=1.0)))
    above.set(ylabel="track", xlim=span, ylim=(-1.0, len(tracks.first)))
    for axes in (above, below) if tracks.ended is not None else ():
        axes.axvline(tracks.ended, color=VERMILION, linewidth=1.0, linestyle="--", label="the estimate ends")
    if above.get_legend_handles_labels()[0]:
        above.legend(loc="upper left")
    below.step(*tracks.per_frame.T, where="mid", color=BLUE)
    below.set(xlabel=tracks.abscissa, ylabel="tracks in the frame", xlim=span)
    below.set_ylim(bottom=0.0)
    return finish(figure, title)


@styled
def draw_landmark_map(points_m: FloatArray, error_m: FloatArray, new: NDArray[np.bool_], title: str) -> Figure:
    """Draw a map of landmark errors, and height errors over errors along the ground, when landmarks were last seen.

    Parameters
    ----------
    points_m
        (n, 3) true positions, body frame.
    error_m
        (n, 3) estimated less true position, body frame.
    new
        (n,) landmarks that were seen only once, so that their depth is unknown.
    """
    figure, (chart, parts) = new_figure(2, width_in=9.4, height_in=3.6)
    length = np.linalg.norm(error_m, axis=1)
    x, y, z = points_m.T
    longitude, latitude = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    top = float(np.percentile(length[~new], 95)) if (~new).any() else float(length.max(initial=1.0))
    dots = chart.scatter(longitude, latitude, c=length, s=14, cmap="viridis", vmin=0.0, vmax=top)
    chart.plot(longitude[new], latitude[new], "o", markersize=6, markerfacecolor="none", markeredgecolor=VERMILION)
    figure.colorbar(dots, ax=chart, label="error, m", pad=0.01)
    chart.set(xlim=(-180, 180), ylim=(-90, 90), xlabel="longitude, deg", ylabel="latitude, deg")
    chart.set_title(f"{len(points_m)} landmarks when seen last (ringed: seen once)")
    radial = np.einsum("ni,ni->n", error_m, points_m / np.linalg.norm(points_m, axis=1, keepdims=True))
    across = np.sqrt(np.maximum(length**2 - radial**2, 0.0))
    for which, colour, label in ((~new, BLUE, "seen twice or more"), (new, VERMILION, "seen once")):
        if which.any():
            parts.plot(across[which], radial[which], "o", markersize=3, color=colour, label=label)
    parts.axhline(0.0, color=GREY, linewidth=0.7)
    parts.set(xlabel="error along the ground, m", ylabel="error of its height, m")
    parts.legend(loc="best")
    return finish(figure, title)
