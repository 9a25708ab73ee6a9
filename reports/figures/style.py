"""Style of all figures: colours and lines of estimators, panels, histograms, and files without dates."""

from __future__ import annotations

import functools
import io
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar

import matplotlib.style
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.typing import LineStyleType
from numpy.typing import ArrayLike, NDArray

from boresight.reports.statistics.intervals import has_quantile
from boresight.scenarios.arrays import FloatArray

Parameters = ParamSpec("Parameters")
T = TypeVar("T", bound=np.generic)

# Okabe and Ito's palette, for colour-blind readers, and two colours more. These are at least as far from the others, in
# CIELAB and for protanopia and deuteranopia too, as the others are from each other. Line styles differ for grey print.
GREY, ORANGE, BLUE, GREEN, VERMILION, PURPLE, SKY, BROWN, VIOLET = (
    "#5f6368", "#e69f00", "#0072b2", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#7f3b08", "#5522cc",
)  # fmt: skip
LINE_STYLES: tuple[LineStyleType, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
_DPI = 160
_COMPRESSION = 3  # of PNG: 0.6 times the time of the default, and files 5 % larger
_FOOTER, _FOOTER_SIZE, _FOOTER_LINE_IN = "footer", 6.5, 0.14
Window = tuple[tuple[float, float], tuple[float, float]]
_FEW_DECADES = 300.0
"""Ratio of the limits below which 2 and 5 of each decade are labelled too."""
_FAR_APART = 20.0
"""Ratio of typical values above which curves on a linear ordinate would lie on the abscissa."""
_DIVERGED = 1e3
"""Multiple of the largest typical value at which an ordinate is cut off."""
_BAND = (0.05, 0.95)
_FULL_TURN_DEG = 360.0
SERIES_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, VERMILION, SKY, BROWN, VIOLET)
_PARAMETERS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that files are the same on every machine
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#d8dce0",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.edgecolor": "#5f6368",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "pdf.fonttype": 42,
    "savefig.facecolor": "white",
}

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">", "p", "h")

_METHODS = {
    GREY: "prior dead-reckoning",
    BLUE: "landmark-harris ba-slam crater-classic context batch-filter",
    SKY: "whole-image minimal-sets batch limb",
    ORANGE: "landmark-ransac ekf-slam gtsam-fixed-lag crater-learned hybrid",
    PURPLE: "photometric consistent-ekf-slam correlation",
    GREEN: "lmaps fixed-lag vote crater-heat-map silhouette",
    VERMILION: "landmark-altimeter landmark-sift iterated-ekf-slam gtsam-isam2 invariants",
    BROWN: "landmark-orb dynamic-smoother centroid-phase crater-onnx",
    VIOLET: "crater-pose centroid loop-smoother",
}
"""The methods that have a colour unless another method of the figure has it. Controls are grey."""
_COLOURS = MappingProxyType({name: colour for colour, names in _METHODS.items() for name in names.split()})


@dataclass(frozen=True, slots=True)
class PlotStyle:
    """Colour, line style and marker of an estimator, as Matplotlib takes them."""

    colour: str
    line: LineStyleType
    marker: str


_OF_REPORT: ContextVar[Mapping[str, PlotStyle]] = ContextVar("styles of a report", default=MappingProxyType({}))


@contextmanager
def report_styles(labels: Iterable[str]) -> Iterator[None]:
    """Give the estimators of a report the same style in all figures drawn meanwhile, whichever of them each shows."""
    token = _OF_REPORT.set(plot_styles(labels))
    try:
        yield
    finally:
        _OF_REPORT.reset(token)


def plot_styles(labels: Iterable[str]) -> dict[str, PlotStyle]:
    """Choose the styles of the estimators of a figure, by label.

    Colours differ, as long as there are enough; labels of the same colour differ in line style. Consecutive labels
    differ in line style too, for print in grey, and up to twelve labels in marker. A label has its style of the report
    or else the colour of the method whose name it is or begins with (``ba-slam-5`` is a ``ba-slam``), unless an earlier
    label of the figure has that colour.
    """
    every, of_report = list(dict.fromkeys(labels)), _OF_REPORT.get()
    colours: dict[str, str] = {}
    for label in every:
        known = [name for name in _COLOURS if label == name or label.startswith(f"{name}-")]
        own = _COLOURS[max(known, key=len)] if known else None
        wanted = of_report[label].colour if label in of_report else own
        if wanted is not None and wanted not in colours.values():
            colours[label] = wanted
    found: dict[str, PlotStyle] = {}
    for place, label in enumerate(every):
        if label not in colours:
            used = Counter(colours.values())
            colours[label] = min(SERIES_COLOURS, key=lambda colour: used[colour])
        style = of_report.get(label)
        line, marker = LINE_STYLES[place % len(LINE_STYLES)], MARKERS[place % len(MARKERS)]
        if style is not None:
            line, marker = style.line, style.marker
        taken = {one.line for one in found.values() if one.colour == colours[label]}
        found[label] = PlotStyle(
            colours[label], next((one for one in (line, *LINE_STYLES) if one not in taken), line), marker
        )
    return found


def styled(draw: Callable[Parameters, Figure]) -> Callable[Parameters, Figure]:
    """Decorate a drawing function to use the style of this module instead of the user's matplotlib settings."""

    @functools.wraps(draw)
    def inner(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Figure:
        with matplotlib.style.context(["default", _PARAMETERS]):
            return draw(*args, **kwargs)

    return inner


def new_figure(columns: int, width_in: float = 7.5, height_in: float = 3.4) -> tuple[Figure, list[Axes]]:
    """Make a figure with ``columns`` panels in one row, without pyplot's global state."""
    figure, axes = grid_figure(1, columns, width_in, height_in)
    return figure, list(axes[0])


def grid_figure(
    rows: int, columns: int, width_in: float = 7.5, height_in: float = 6.0
) -> tuple[Figure, NDArray[np.object_]]:
    """Make a figure with (rows, columns) panels."""
    # With the resolution of the files, so that what the layout measures of texts is used again when they are drawn.
    figure = Figure(figsize=(width_in, height_in), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, np.asarray(figure.subplots(rows, columns, squeeze=False))


def render(figure: Figure, kind: str, dpi: int = _DPI) -> bytes:
    """Encode a figure as ``png`` or ``pdf``, without dates: the same figure gives the same bytes on one machine."""
    options: dict[str, Any] = {"metadata": {"Creator": None, "Producer": None, "CreationDate": None}}
    if kind == "png":
        options = {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": _COMPRESSION}}
    buffer = io.BytesIO()
    with matplotlib.style.context(["default", _PARAMETERS]):
        figure.savefig(buffer, format=kind, dpi=dpi, **options)
    return buffer.getvalue()


def save_figure(figure: Figure, stem: Path, kinds: Sequence[str] = ("png", "pdf")) -> tuple[Path, ...]:
    """Write ``stem``.png and ``stem``.pdf, or one of them, and return the paths."""
    paths = tuple(stem.with_name(f"{stem.name}.{kind}") for kind in kinds)
    for path in paths:
        path.write_bytes(render(figure, path.suffix[1:]))
    return paths


def show_image(axes: Axes, image: NDArray[np.floating[Any]], window: Window | None = None) -> None:
    """Show an image so that the centre of its first pixel is at (0.5, 0.5), stretched to its 99.8th percentile.

    With a window, the percentile is that of its pixels.
    """
    height, width = image.shape
    seen = image if window is None else windowed(image, window)
    top = next(one for one in (float(np.percentile(seen, 99.8)), float(seen.max()), 1.0) if one > 0.0)
    axes.imshow(image, cmap="gray", vmin=0.0, vmax=top, extent=(0, width, height, 0), interpolation="nearest")
    axes.grid(visible=False)


def hide_axes(axes: Axes) -> None:
    """Remove ticks, frame and grid."""
    axes.set(xticks=[], yticks=[])
    axes.set_axis_off()


def image_panel(axes: Axes, image: NDArray[np.floating[Any]], title: str = "", window: Window | None = None) -> None:
    """Show an image without axes, or the window (left, right), (top, bottom) of it."""
    show_image(axes, image, window)
    height, width = image.shape
    (left, right), (top, bottom) = window or ((0, width), (0, height))
    axes.set(xlim=(left, right), ylim=(bottom, top))
    hide_axes(axes)
    axes.set_title(title)


def windowed(image: NDArray[T], window: Window) -> NDArray[T]:
    """Return the pixels of an image (H, W) that a window shows, whole or in part; at least one."""
    (left, right), (top, bottom) = window
    height, width = image.shape
    row, column = min(max(int(top), 0), height - 1), min(max(int(left), 0), width - 1)
    return image[row : max(math.ceil(bottom), row + 1), column : max(math.ceil(right), column + 1)]


def window_around(
    points_px: FloatArray, share: float, least_px: float = 0.0, image: NDArray[np.floating[Any]] | None = None
) -> Window:
    """Return (left, right), (top, bottom) of points (n, 2) with a margin, within an image if there is one.

    The margin is a share of the larger extent of the points, and ``least_px`` more.
    """
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    margin = share * float((high - low).max()) + least_px
    low, high = low - margin, high + margin
    if image is not None:
        low, high = np.maximum(low, 0.0), np.minimum(high, image.shape[::-1])
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def finish(
    figure: Figure, title: str, credit_lines: Sequence[str] = (), legend: Axes | None = None, columns: int = 4
) -> Figure:
    """Print the title above the panels, and below them the legend of one of them and the credits of real images."""
    if legend is not None:
        handles, labels = legend.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), columns))
    figure.suptitle(title, fontsize=9.5)
    if credit_lines:
        figure.supxlabel("; ".join(credit_lines), fontsize=7, color=GREY, x=0.995, ha="right")
    return figure


def add_footer(figure: Figure, lines: Sequence[str]) -> None:
    """Print small lines at the bottom of a figure, below those of earlier calls, and make the figure higher for them.

    The layout is fixed afterwards: nothing more can be drawn.
    """
    before = next((text for text in figure.texts if text.get_gid() == _FOOTER), None)
    _grow(figure, _FOOTER_LINE_IN * len(lines))
    earlier = [] if before is None else [before.get_text()]
    if before is not None:
        before.remove()
    words = "\n".join([*earlier, *lines])
    text = figure.text(
        0.995, 0.01 / figure.get_figheight(), words, fontsize=_FOOTER_SIZE, color=GREY, ha="right", va="bottom"
    )
    text.set_gid(_FOOTER)


def _grow(figure: Figure, strip_in: float) -> None:
    """Add an empty strip at the bottom without changing the rest of the layout.

    Everything is placed by hand, as the constrained layout would put a legend outside the axes into the strip.
    """
    engine = figure.get_layout_engine()
    with matplotlib.style.context(["default", _PARAMETERS]):
        if engine is not None:
            engine.execute(figure)
        figure.set_layout_engine(
            None
        )  # with "none", a placeholder engine would stay and each file would be drawn twice
    before = figure.get_figheight()
    after = before + strip_in
    figure.set_figheight(after)
    for axes in figure.axes:
        at = axes.get_position(original=True)
        axes.set_position((at.x0, (at.y0 * before + strip_in) / after, at.width, at.height * before / after))
    for text in figure.texts:
        text.set_y((text.get_position()[1] * before + strip_in) / after)
    for legend in figure.legends:
        legend.set_bbox_to_anchor((0.0, strip_in / after, 1.0, before / after), figure.transFigure)


def shared_edges(samples: Sequence[FloatArray], bins: int = 40, percent: float = 99.0) -> FloatArray:
    """Choose bin edges (bins + 1,) from 0 to a round number above the percentile ``percent`` of every sample."""
    top = max((float(np.percentile(sample, percent)) for sample in samples if len(sample)), default=1.0) or 1.0
    unit = 10.0 ** np.floor(np.log10(top))
    step = next(s for s in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) if s * unit >= top * (1 - 1e-9))
    return np.linspace(0.0, step * unit, bins + 1)


def step_histogram(axes: Axes, sample: FloatArray, edges: FloatArray, **line: Any) -> int:
    """Draw a step histogram in frequency per unit, normalised by the whole sample.

    Return how many values lie beyond the last edge. They are not drawn, but the normalisation includes them.
    """
    inside = np.histogram(sample, edges)[0]
    axes.stairs(inside / (max(len(sample), 1) * np.diff(edges)), edges, **line)
    return int(np.count_nonzero(sample > edges[-1]))


def histogram_panel(
    axes: Axes,
    samples: Mapping[str, FloatArray],
    lines: Sequence[Mapping[str, Any]],
    edges: FloatArray,
    median_top: float,
) -> int:
    """Draw step histograms by their labels in the legend, with dotted lines at the medians up to a share of the height.

    Return how many values lie beyond the last edge, see `step_histogram`.
    """
    beyond = 0
    for (label, sample), line in zip(samples.items(), lines, strict=True):
        if len(sample):
            axes.axvline(float(np.median(sample)), ymax=median_top, color=line["color"], linewidth=0.9, linestyle=":")
        beyond += step_histogram(axes, sample, edges, label=label, **line)
    axes.set_xlim(0, edges[-1])
    raise_top(axes, len(samples))
    axes.legend(loc="upper right")
    return beyond


def beyond_text(beyond: int, limit: float, unit: str) -> str:
    """Return a note for the axis label on how many values lie beyond the axis; '' if none."""
    return f"  ({beyond} beyond {limit:g}{f' {unit}' if unit else ''})" if beyond else ""


def mark_on_axis(axes: Axes, value: float, colour: str) -> None:
    """Mark a published value by an open triangle on the axis."""
    axes.plot(
        [value], [0.0], marker="^", markersize=7, markerfacecolor="white", markeredgecolor=colour,
        transform=axes.get_xaxis_transform(), clip_on=False, zorder=5, linestyle="none",
    )  # fmt: skip


def raise_top(axes: Axes, lines: int) -> None:
    """Extend the axis above the data for a legend of ``lines`` lines."""
    axes.set_ylim(0, axes.get_ylim()[1] * (1.02 + 0.085 * lines))


def mark_revolutions(axes: Axes, anomaly_deg: ArrayLike) -> None:
    """Draw a dotted line at every whole revolution up to the largest anomaly; none where no frame was estimated."""
    last_deg = np.fmax.reduce(np.asarray(anomaly_deg, dtype=np.float64), initial=0.0)  # NaN: frames without one
    for turn in range(1, int(last_deg / _FULL_TURN_DEG) + 1):
        axes.axvline(turn * _FULL_TURN_DEG, color="black", linewidth=0.6, linestyle=":")


def percentile_band(values: pd.Series, over: pd.Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 5 % and 95 % quantiles of ``values`` at each value of ``over``.

    Where there are too few values for these quantiles, the band goes from the minimum to the maximum.
    """
    groups = values.groupby(over)
    enough = groups.count().map(lambda n: has_quantile(n, _BAND[0])).to_numpy()
    low, high = (groups.quantile(share).to_numpy() for share in _BAND)
    return np.where(enough, low, groups.min()), np.where(enough, high, groups.max())


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points of a curve: (n,) abscissae and values, and (n, 2) bounds of their intervals."""

    x: FloatArray
    y: FloatArray
    low_high: FloatArray


def draw_points(axes: Axes, points: Points, style: PlotStyle, **line: Any) -> None:
    """Draw points with their intervals, joined by a line in the colour and line style of an estimator."""
    line = {"marker": "o", "markersize": 3, "capsize": 2, **line}
    spread = np.abs(points.low_high.T - points.y)
    axes.errorbar(points.x, points.y, yerr=spread, color=style.colour, linestyle=style.line, **line)


def draw_band(axes: Axes, values: pd.Series, over: pd.Series, style: PlotStyle, alpha: float) -> None:
    """Draw the band of 5 to 95 % of values at each value of a coordinate, see `percentile_band`."""
    low, high = percentile_band(values, over)
    axes.fill_between(np.unique(over), low, high, color=style.colour, alpha=alpha, linewidth=0)


def band_label(trials: int) -> str:
    """Name the band of `percentile_band` over this number of trials, for captions."""
    return "the band of 5 to 95 % of them" if has_quantile(trials, _BAND[0]) else "the band of all of them"


def mark_decades(axis: Axis) -> None:
    """Label the decades of a logarithmic axis, and 2 and 5 of each if the labels fit; the limits must be set."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def scale_ordinate(axes: Axes, typical: Sequence[float]) -> None:
    """Make the ordinate linear from 0, or logarithmic where the typical values of the curves are far apart.

    It ends at 1000 times the largest typical value, so that a method that diverges in one frame does not hide the
    other curves. If values lie beyond, it is logarithmic too, and a note in the panel gives the largest value.
    """
    known = [value for value in typical if np.isfinite(value)]
    if not known or min(known) <= 0.0:
        axes.set_ylim(bottom=0.0)
        return
    top, limit = float(axes.dataLim.y1), _DIVERGED * max(known)
    if max(known) > _FAR_APART * min(known) or top > limit:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    if top > limit:
        axes.set_ylim(float(axes.dataLim.minposy) / 1.5, limit)
        axes.annotate(f"up to {top:.1g}", (0.99, 0.98), xycoords="axes fraction", ha="right", va="top", fontsize=7.5)
    if axes.get_yscale() == "log":
        mark_decades(axes.yaxis)
