"""What an arc of images covers: histograms of counts (figures 8 and 9 of Cheng et al. 2003)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.style import BLUE, GREY, mark_on_axis, new_figure, raise_top, styled

_MOST_BARS = 60


@styled
def draw_count_histogram(
    counts: NDArray[np.int64], label: str, ordinate: str, published: Mapping[str, float], title: str
) -> Figure:
    """Draw a histogram of counts with its mean and median, and what a paper prints as triangles on the axis.

    Parameters
    ----------
    counts
        (n,) not negative.
    label, ordinate
        Of the axes.
    published
        What is printed, to its value.
    title
        Printed above.
    """
    figure, (axes,) = new_figure(1, width_in=5.6, height_in=3.4)
    width = max(1, int(np.ceil((counts.max(initial=0) + 1) / _MOST_BARS)))
    edges = np.arange(0, counts.max(initial=0) + width + 1, width) - 0.5
    axes.hist(counts, edges.tolist(), color=BLUE, alpha=0.75, edgecolor="white", linewidth=0.4)
    median, mean = float(np.median(counts)), float(counts.mean())
    axes.axvline(median, color=GREY, linestyle=":", label=f"median {median:g}")
    axes.axvline(mean, color=GREY, linestyle="--", label=f"mean {mean:.3g}")
    for value in published.values():
        mark_on_axis(axes, value, "black")
    if published:
        said = ", ".join(f"{name} {value:g}" for name, value in published.items())
        axes.plot([], [], marker="^", color="black", markerfacecolor="white", linestyle="none", label=f"paper: {said}")
    axes.set(xlabel=label, ylabel=ordinate)
    axes.set_xlim(left=-0.5)
    raise_top(axes, 2)
    axes.legend(loc="upper right")
    figure.suptitle(title, fontsize=9.5)
    return figure
