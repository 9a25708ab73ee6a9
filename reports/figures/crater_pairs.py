"""Two looks at craters with what was matched between them (figure 6 of Cheng et al. 2003)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.craters import draw_rims
from reports.figures.style import GREY, VERMILION, hide_axes, new_figure, show_image, styled
from scenarios.geometry import Ellipses

IndexArray = NDArray[np.int64]
_MISSED = "#ffffff"
_MISSED_ON_WHITE = "#000000"


@dataclass(frozen=True, slots=True, eq=False)
class MatchedRims:
    """Rims of two looks and what a matcher made of them.

    Parameters
    ----------
    rims
        Of the first and of the second look.
    pairs
        (k, 2) rows of matched ones.
    right
        (k,) matches that join one crater.
    missed
        (m, 2) rows of craters that both show and that no right match joins.
    """

    rims: tuple[Ellipses, Ellipses]
    pairs: IndexArray
    right: NDArray[np.bool_]
    missed: IndexArray


@styled
def draw_matched_pair(
    images: tuple[NDArray[np.float32], NDArray[np.float32]], found: MatchedRims, title: str
) -> Figure:
    """Draw both looks; matched craters have the same colour and number in both. An empty image draws rims alone."""
    figure, panels = new_figure(2, width_in=11.0, height_in=5.0)
    colours = colormaps["turbo"](np.linspace(0.05, 0.95, max(int(found.right.sum()), 1)))
    for side, (axes, image) in enumerate(zip(panels, images, strict=True)):
        rims, name = found.rims[side], ("first", "second")[side]
        plain = image.size == 0
        if not plain:
            show_image(axes, image)
            axes.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0))
        draw_rims(axes, rims, GREY, width=0.5)
        missed = rims[found.missed[:, side]]
        draw_rims(axes, missed, _MISSED_ON_WHITE if plain else _MISSED, width=1.0, dashed=True)
        draw_rims(axes, rims[found.pairs[~found.right, side]], VERMILION, width=1.3, dashed=True)
        for number, (row, colour) in enumerate(zip(found.pairs[found.right, side], colours, strict=False)):
            draw_rims(axes, rims[np.array([row])], colour, width=1.3)
            _number(axes, rims.centre_px[row], number, colour)
        if plain:
            axes.set_aspect("equal")
            axes.autoscale_view()
            axes.invert_yaxis()
        hide_axes(axes)
        axes.set_title(f"{name} look: {len(rims)} detections")
    right, wrong = int(found.right.sum()), int((~found.right).sum())
    figure.suptitle(f"{title}: {right} right, {wrong} wrong, {len(found.missed)} missed", fontsize=9.5)
    return figure


def _number(axes: Axes, centre_px: NDArray[np.float64], number: int, colour: NDArray[np.float64]) -> None:
    u, v = centre_px
    axes.annotate(str(number + 1), (float(u), float(v)), color=colour, fontsize=6.5, ha="center", va="center")
