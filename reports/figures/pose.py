"""Figures of pose errors, cumulative shares, landmarks and brightness centroids (after Rowell et al. 2015)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import gammaln, xlogy

from boresight.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    LINE_STYLES,
    ORANGE,
    SERIES_COLOURS,
    VERMILION,
    PlotStyle,
    beyond_text,
    finish,
    grid_figure,
    hide_axes,
    histogram_panel,
    mark_decades,
    mark_on_axis,
    new_figure,
    plot_styles,
    raise_top,
    shared_edges,
    show_image,
    step_histogram,
    styled,
    window_around,
)
from boresight.reports.schema.grid import shortest
from boresight.scenarios.arrays import FloatArray

_PANELS = (
    ("attitude_error_deg", "attitude error, deg", "deg", "frequency per degree"),
    ("position_error_m", "position error, m", "m", "frequency per metre"),
)


_CURVE_POINTS = 2000
_LEGEND_INSIDE = 8
_LINE_IN = 0.17
_FAR_APART = 8.0
_TICKS = 5  # labels of four decimals leave no room for more

_METHODS_INSIDE = 4
_LEGEND_TITLE = "median (share beyond the axis)"
_SHARE_TOLD = 1.0


@styled
def draw_method_errors(
    groups: Mapping[str, Mapping[str, pd.DataFrame]], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw normalised histograms of the errors of methods, a row of panels for each group of them.

    Groups map the title of a row to its methods, and these to columns ``attitude_error_deg`` and ``position_error_m``.
    All rows share their axes, and a label has the same colour in all rows.
    """
    # A long legend stands below its panel.
    height_in = 0.5 + sum(2.9 + 0.18 * (n if n > _METHODS_INSIDE else 0) for n in map(len, groups.values()))
    figure, rows = grid_figure(len(groups), 2, height_in=height_in)
    drawn = plot_styles(label for methods in groups.values() for label in methods)
    for column, (name, label, _, frequency) in enumerate(_PANELS):
        samples = {
            row: {method: _finite(errors[name]) for method, errors in methods.items()}
            for row, methods in groups.items()
        }
        # Bins for most methods: the errors of one that fails must not flatten the others.
        every = [sample for methods in samples.values() for sample in methods.values() if len(sample)]
        middle = 1.2 * float(np.median([np.percentile(sample, 99.0) for sample in every])) if every else None
        edges = shared_edges([] if middle is None else [np.array([middle])], bins=60)
        for axes, (row, methods) in zip(rows[:, column], samples.items(), strict=True):
            _draw_methods(axes, methods, drawn, edges)
            axes.set(xlabel=label, ylabel=frequency, title=row)
        top = max(axes.get_ylim()[1] for axes in rows[:, column])
        for axes in rows[:, column]:
            axes.set_ylim(0.0, top)
    return finish(figure, title, credit_lines)


def _draw_methods(
    axes: Axes, methods: Mapping[str, FloatArray], drawn: Mapping[str, PlotStyle], edges: FloatArray
) -> None:
    for method, sample in methods.items():
        line = {"color": drawn[method].colour, "linestyle": drawn[method].line, "linewidth": 1.5}
        share = 100.0 * np.count_nonzero(sample > edges[-1]) / max(len(sample), 1)
        median = shortest(float(np.median(sample))) if len(sample) else "none"
        beyond = f" ({share:.0f} %)" if share >= _SHARE_TOLD else ""
        step_histogram(axes, sample, edges, label=f"{method}: {median}{beyond}", **line)
    axes.set_xlim(0.0, edges[-1])
    if len(methods) <= _METHODS_INSIDE:
        raise_top(axes, len(methods))
        legend = axes.legend(loc="upper right", title=_LEGEND_TITLE, title_fontsize=7.5, fontsize=7.5)
        legend.set_in_layout(False)
    else:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), title=_LEGEND_TITLE, title_fontsize=8.0)


@styled
def draw_pose_errors(
    stages: Mapping[str, pd.DataFrame],
    title: str,
    published: Mapping[tuple[str, str], float] | None = None,
    credit_lines: Sequence[str] = (),
) -> Figure:
    """Draw normalised histograms of attitude and position error, with the medians marked.

    ``stages`` maps the label of each stage, in order, to columns ``attitude_error_deg`` and ``position_error_m``; a
    stage with the same attitude errors as the first one is left out of the attitude panel. ``published`` are medians
    that a paper prints, by (stage label, column): triangles on the axis.
    """
    figure, panels = new_figure(2)
    for axes, (column, label, unit, frequency) in zip(panels, _PANELS, strict=True):
        samples = {name: _finite(errors[column]) for name, errors in stages.items()}
        first = next(iter(samples.values()))
        if column == "attitude_error_deg":
            samples = {
                name: sample
                for i, (name, sample) in enumerate(samples.items())
                if i == 0 or len(sample) != len(first) or not np.allclose(sample, first)
            }
        medians = {name: v for (name, wanted), v in (published or {}).items() if wanted == column and name in samples}
        edges = shared_edges([*samples.values(), *(np.array([value]) for value in medians.values())])
        lines = {name: _line(list(stages).index(name), len(stages)) for name in samples}
        labelled = {_stage_label(name, sample, unit): sample for name, sample in samples.items()}
        beyond = histogram_panel(axes, labelled, list(lines.values()), edges, 0.8)
        for name, value in medians.items():
            mark_on_axis(axes, value, lines[name]["color"])
        axes.set(xlabel=label + beyond_text(beyond, float(edges[-1]), unit), ylabel=frequency)
        axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
    return finish(figure, title, credit_lines)


def _finite(values: pd.Series) -> FloatArray:
    return np.asarray(values.dropna(), dtype=np.float64)


def _line(index: int, count: int) -> dict[str, Any]:
    """Return the line style of a stage: grey for the first, blue for the last, orange and green between them."""
    if index == 0:
        return {"color": GREY, "linestyle": "--", "linewidth": 1.3}
    if index == count - 1:
        return {"color": BLUE, "linestyle": "-", "linewidth": 1.7}
    return {"color": (ORANGE, GREEN)[(index - 1) % 2], "linestyle": "-.", "linewidth": 1.4}


def _stage_label(name: str, sample: FloatArray, unit: str) -> str:
    if not len(sample):
        return f"{name} (n = 0)"
    median = float(np.median(sample))
    digits = f"{median:.3g}" if median < 1000.0 else f"{median:.0f}"  # without an exponent
    return f"{name}: median {digits} {unit} (n = {len(sample)})"


@styled
def draw_cumulative_errors(
    estimators: Mapping[str, tuple[pd.DataFrame, int]],
    title: str,
    credit_lines: Sequence[str] = (),
    panels: Mapping[str, str] = MappingProxyType({column: label for column, label, _, _ in _PANELS}),
    styles: Mapping[str, PlotStyle] | None = None,
) -> Figure:
    """Draw the share of all trials whose error is below the abscissa; failures lower the curve.

    Each estimator has its errors where it is ok, and its number of trials. ``panels`` maps columns of the errors to the
    labels of their axes; without ``styles`` curves have those of the estimators of their names.
    """
    far_apart = any(_far_apart([_finite(errors[column]) for errors, _ in estimators.values()]) for column in panels)
    below = len(estimators) > _LEGEND_INSIDE or len(panels) == 1 or far_apart
    lines = -(-len(estimators) // 2) if below else 0
    drawn = styles or plot_styles(estimators)
    figure, places = new_figure(len(panels), 3.75 * max(len(panels), 1.5), 3.4 + _LINE_IN * lines)
    for axes, (column, label) in zip(places, panels.items(), strict=True):
        samples = {name: np.sort(_finite(errors[column])) for name, (errors, _) in estimators.items()}
        limit = float(shared_edges(list(samples.values()))[-1])
        for name, sample in samples.items():
            # Thinned to about 2000 points, to keep PDFs small.
            n, inside = estimators[name][1], sample[sample <= limit]
            stride = max(1, len(inside) // _CURVE_POINTS)
            shown = inside[stride - 1 :: stride]
            share = np.concatenate([np.arange(len(shown)) * stride, [len(inside)] * 2]) / n
            axes.step(
                np.concatenate([[0.0], shown, [limit]]), share, where="post", color=drawn[name].colour,
                linestyle=drawn[name].line, linewidth=1.6, label=f"{name} ({len(sample)} of {n} ok)",
            )  # fmt: skip
        axes.set(xlabel=label, ylabel="share of all trials", xlim=(0, limit), ylim=(0, 1.02))
        axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
        low = min((float(np.quantile(sample, 0.02)) for sample in samples.values() if len(sample)), default=0.0)
        if _far_apart(list(samples.values())) and low > 0.0:
            axes.set(xscale="log", xlim=(low, limit))
            mark_decades(axes.xaxis)
    if below:
        figure.legend(*places[-1].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    else:
        places[-1].legend(loc="lower right")
    return finish(figure, title, credit_lines)


def _far_apart(samples: Sequence[FloatArray]) -> bool:
    """Whether the medians are so far apart that a linear abscissa would squeeze the best curve against the ordinate."""
    medians = [float(np.median(sample)) for sample in samples if len(sample)]
    return bool(medians) and 0.0 < _FAR_APART * min(medians) < max(medians)


DEGREES_OF_FREEDOM = 3
# The range of the theoretical distribution. Wrong matches reach values a hundred times larger and would hide it.
_CHI_SQUARE_EDGES = np.linspace(0.0, 30.0, 61)


@styled
def draw_landmark_errors(
    error_m: FloatArray, chi_square: FloatArray, title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw histograms of landmark errors (n,) and their chi-square (m,), with the density for 3 degrees of freedom."""
    figure, (left, right) = new_figure(2)
    error_edges = shared_edges([error_m], bins=50, percent=95.0)
    for axes, sample, edges, unit, label, frequency in (
        (left, error_m, error_edges, "m", "landmark error, m", "frequency per metre"),
        (right, chi_square, _CHI_SQUARE_EDGES, "", "chi-square of the landmark error", "frequency"),
    ):
        name = f"observed: median {shortest(float(np.median(sample)))} {unit}".rstrip() + f" (n = {len(sample)})"
        beyond = histogram_panel(axes, {name: sample}, [{"color": BLUE, "linewidth": 1.5}], edges, 0.85)
        axes.set(xlabel=label + beyond_text(beyond, float(edges[-1]), unit), ylabel=frequency)
    x, half = np.linspace(0.0, _CHI_SQUARE_EDGES[-1], 400), DEGREES_OF_FREEDOM / 2.0
    density = np.exp(xlogy(half - 1.0, x) - x / 2.0 - gammaln(half) - half * np.log(2.0))
    raise_top(right, 1)
    theory = f"chi-square, {DEGREES_OF_FREEDOM} degrees of freedom"
    right.plot(x, density, color=VERMILION, linestyle="--", linewidth=1.4, label=theory)
    right.legend(loc="upper right")
    return finish(figure, title, credit_lines)


@styled
def draw_landmark_counts(
    counts: FloatArray, title: str, published_median: float | None = None, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw the histogram of the numbers of recognised landmarks of images (n,), with the median that a paper prints."""
    figure, (axes,) = new_figure(1, width_in=5.0, height_in=3.2)
    width = max(1, round((counts.max() - counts.min()) / 40))
    edges = np.arange(counts.min() - 0.5, counts.max() + width + 0.5, width)
    median = float(np.median(counts))
    axes.hist(counts, bins=edges.tolist(), color=BLUE, alpha=0.25, edgecolor=BLUE, linewidth=0.8, histtype="stepfilled")
    axes.axvline(median, color=BLUE, linewidth=1.4, label=f"median {shortest(median)} (n = {len(counts)})")
    if published_median is not None:
        label = f"median of the paper {published_median:.3g}"
        axes.axvline(published_median, color=GREY, linestyle="--", linewidth=1.4, label=label)
    axes.set(xlabel="recognised landmarks an image", ylabel="images")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    raise_top(axes, 2)
    axes.legend(loc="upper right")
    return finish(figure, title, credit_lines)


@styled
def draw_count_comparison(
    counts: Mapping[str, FloatArray], published: Mapping[str, float], title: str, credit_lines: Sequence[str] = ()
) -> Figure:
    """Draw the number of recognised landmarks per image for several sets of images (Rowell et al. 2015, figure 10).

    Both mappings are by the label of the set; medians that the paper prints are triangles on the axis.
    """
    figure, (axes,) = new_figure(1, width_in=6.0, height_in=3.6)
    top = max(float(sample.max()) for sample in counts.values())
    width = max(1, round(top / 60))
    edges = np.arange(-0.5, top + width + 0.5, width)
    samples, lines = dict[str, FloatArray](), list[dict[str, Any]]()
    for i, (name, sample) in enumerate(counts.items()):
        colour, style = SERIES_COLOURS[i % len(SERIES_COLOURS)], LINE_STYLES[i % len(LINE_STYLES)]
        samples[f"{name}: median {shortest(float(np.median(sample)))} (n = {len(sample)})"] = sample
        lines.append({"color": colour, "linestyle": style, "linewidth": 1.5})
        if name in published:
            mark_on_axis(axes, published[name], colour)
    histogram_panel(axes, samples, lines, edges, 0.75)
    axes.set(xlabel="recognised landmarks an image", ylabel="share of the images per landmark")
    return finish(figure, title, credit_lines)


@styled
def draw_centroid_offsets(offsets: Mapping[str, FloatArray], title: str) -> Figure:
    """Draw panels of offsets (n, 2), px, by title, with the 1-sigma ellipse of their covariance, on the same axes."""
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


# Steps of the golden ratio through the hues, so that consecutive numbers have different colours.
_GOLDEN = 0.6180339887498949

_EDGE = "#3c4043"


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceView:
    """A triangulation and its surface as one camera sees them, in pixels.

    ``landmarks_px`` (n, 2) are all landmarks, ``edges_px`` (e, 2, 2) the ends of all edges of the tetrahedra,
    ``facets_px`` (f, 3, 2) the corners of the facets that face the camera, the farthest first, with their ``shades``
    (f,) from 0 to 1. ``normals_px`` (f, 2, 2) has the centre of each facet and the tip of its outward normal.
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
    """Draw the Delaunay triangulation, the concave hull and its normals, as one camera sees them."""
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
    """Clusters of points, and the body's image (H, W), as one camera sees them.

    Points (n, 2) on the near side that belong to a seed cluster, and (m, 2) to a merged one, with the numbers of the
    clusters.
    """

    seed_px: FloatArray
    seed_of: NDArray[np.intp]
    merged_px: FloatArray
    merged_of: NDArray[np.intp]
    image: NDArray[np.floating]


@styled
def draw_clusters(view: ClusterView, title: str) -> Figure:
    """Draw seed clusters, merged clusters and the body as one camera sees them, all cropped to the body."""
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
