"""Two images of one area with the craters that were taken for the same (figure 6 of Cheng et al. 2003)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from reports.figures.craters import draw_rims
from reports.figures.style import GREY, SERIES_COLOURS, VERMILION, hide_axes, new_figure, show_image, styled
from scenarios.geometry import Ellipses

_COLOURS = tuple(colour for colour in SERIES_COLOURS if colour != VERMILION)


@styled
def draw_matched_pair(
    images: tuple[NDArray[np.float32], NDArray[np.float32]],
    rims: tuple[Ellipses, Ellipses],
    pairs: NDArray[np.int64],
    right: NDArray[np.bool_],
    title: str,
) -> Figure:
    """Draw the detections of both images; those that were matched carry the same number and colour in both.

    Parameters
    ----------
    images
        (H, W) each; nothing but the rims is drawn where an image is black.
    rims
        Detections.
    pairs
        (k, 2) rows of the detections that were matched.
    right
        (k,) whether the match is right; wrong ones are red and dashed.
    title
        Printed above.
    """
    figure, panels = new_figure(2, width_in=9.0, height_in=3.8)
    for side, (panel, image) in enumerate(zip(panels, images, strict=True)):
        _background(panel, image)
        alone = np.setdiff1d(np.arange(len(rims[side])), pairs[:, side])
        draw_rims(panel, rims[side][alone], GREY, width=0.8)
        for number, (row, is_right) in enumerate(zip(pairs[:, side], right, strict=True)):
            colour = _COLOURS[number % len(_COLOURS)] if is_right else VERMILION
            one = rims[side][row : row + 1]
            draw_rims(panel, one, colour, width=1.6, dashed=not is_right)
            place = one.centre_px[0] + [0.0, -one.radius_px[0] - 2.0]
            panel.annotate(
                str(number + 1), place, color=colour, fontsize=8, ha="center", va="bottom", weight="bold",
                annotation_clip=True, path_effects=[withStroke(linewidth=2.0, foreground="white")],
            )  # fmt: skip
        panel.set_title(f"image {side + 1}")
    figure.suptitle(title, fontsize=9.5)
    return figure


def _background(panel: Axes, image: NDArray[np.float32]) -> None:
    height, width = image.shape
    if image.any():
        show_image(panel, image)
    panel.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    hide_axes(panel)
    panel.spines[:].set_visible(True)
