"""Figures of crater detection: an image with what is there and what was found, curves and rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.craters import draw_rims
from reports.figures.looks import colour_of
from reports.figures.style import LINE_STYLES, FloatArray, hide_axes, new_figure, show_image, styled
from scenarios.geometry import Ellipses

RimSet = tuple[Ellipses, str]
TRUE_COLOUR, FOUND_COLOUR, FALSE_COLOUR, OTHER_COLOUR = "#ffd21f", "#35c4ff", "#ff4d4d", "#8f8f3c"


@styled
def draw_found_and_true(
    image: NDArray[np.float32], truth: Sequence[RimSet], found: Sequence[RimSet], title: str
) -> Figure:
    """Draw an image, what is true of it and what was found, side by side, after figures 2 and 3 of Cheng et al. (2003).

    Parameters
    ----------
    image
        (H, W).
    truth, found
        Rims, each set with its colour.
    title
        Printed above.
    """
    figure, axes = new_figure(3, width_in=11.0, height_in=3.3)
    sets_of: tuple[Sequence[RimSet], ...] = ((), truth, found)
    for place, sets, name in zip(axes, sets_of, ("image", "truth", "detections"), strict=True):
        show_image(place, image)
        for rims, colour in sets:
            draw_rims(place, rims, colour, width=0.8)
        height, width = image.shape
        place.set(xlim=(0, width), ylim=(height, 0))
        hide_axes(place)
        place.set_title(name)
    figure.suptitle(title, fontsize=9.5)
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class ConfidenceCurve:
    """Shares (m,), %, of false alarms, detectable and clean craters found as the threshold falls.

    ``chosen`` is the point of the detector's own threshold, -1 where nothing reaches it.
    """

    false: FloatArray
    detectable: FloatArray
    clean: FloatArray
    chosen: int


@styled
def draw_confidence_curves(curves: Mapping[str, ConfidenceCurve], title: str) -> Figure:
    """Draw shares of craters found over shares of false alarms of each detector."""
    figure, axes = new_figure(1, width_in=5.2, height_in=4.2)
    (place,) = axes
    for label, curve in curves.items():
        colour = colour_of(label)
        for values, name, style in ((curve.detectable, "detectable", "-"), (curve.clean, "clean", LINE_STYLES[1])):
            place.plot(curve.false, values, color=colour, linewidth=1.3, linestyle=style, label=f"{label}: {name}")
            if curve.chosen >= 0:
                place.plot(curve.false[curve.chosen], values[curve.chosen], marker="o", markersize=5, color=colour)
    place.plot(
        [5.0], [90.0], marker="*", markersize=11, color="black", linestyle="none", label="paper: over 90, under 5"
    )
    place.set(
        xlabel="false alarms among those and detectable craters, %",
        ylabel="craters found, %",
        ylim=(0, 101),
    )
    place.set_xlim(left=0.0)
    place.legend(loc="lower right")
    figure.suptitle(title, fontsize=9.5)
    return figure


@styled
def draw_rates(panels: Mapping[str, Mapping[str, Sequence[tuple[str, float, float, float]]]], title: str) -> Figure:
    """Draw rates with intervals in bins.

    Parameters
    ----------
    panels
        What the bins are of, to detector, to (name of the bin, rate, low, high), %.
    """
    figure, axes = new_figure(len(panels), width_in=3.7 * len(panels), height_in=3.4)
    for place, (what, detectors) in zip(axes, panels.items(), strict=True):
        for k, (label, bins) in enumerate(detectors.items()):
            x = np.arange(len(bins)) + 0.12 * (k - 0.5 * (len(detectors) - 1))
            rate, low, high = (np.array([b[i] for b in bins], dtype=np.float64) for i in (1, 2, 3))
            spread = np.stack([rate - low, high - rate])
            colour = colour_of(label)
            place.errorbar(x, rate, np.maximum(spread, 0.0), marker="o", markersize=3.5, color=colour, label=label)
            place.set_xticks(np.arange(len(bins)), [b[0] for b in bins], rotation=30, ha="right")
        place.set(xlabel=what, ylim=(0, 101))
    axes[0].set_ylabel("detectable craters found, %")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(detectors))
    figure.suptitle(title, fontsize=9.5)
    return figure
