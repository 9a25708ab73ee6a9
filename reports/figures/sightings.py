"""An image of a sequence and the features found in it (figures 6.1 and 6.2 of Delpech et al. 2015)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from reports.figures.style import ORANGE, hide_axes, new_figure, show_image, styled


@styled
def draw_sightings(image: NDArray[np.float32], uv_px: NDArray[np.float64], title: str) -> Figure:
    """Draw an image, with rings about features.

    Parameters
    ----------
    image
        (H, W) any linear measure of radiance.
    uv_px
        (n, 2) features to mark, centre of the first pixel at (0.5, 0.5); none for the image alone.
    title
        Printed above.
    """
    figure, (axes,) = new_figure(1, width_in=5.0, height_in=5.2)
    show_image(axes, image)
    if len(uv_px):
        axes.scatter(uv_px[:, 0], uv_px[:, 1], s=70, facecolors="none", edgecolors=ORANGE, linewidths=1.2)
    height, width = image.shape
    axes.set(xlim=(0, width), ylim=(height, 0))
    hide_axes(axes)
    axes.set_title(title)
    return figure
