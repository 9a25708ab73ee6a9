"""The displacement of a window to a small fraction of a pixel, by robust least squares on its grey values.

Adaptive least squares correlation (Gruen 1985) with Tukey's biweight. Shadows and boulders that the onboard shape does
not resolve all lie on the far side from the Sun: in a plain correlation they pull every window that way, by a tenth of
a pixel where the Sun stands low. So dark pixels are left out, and what fits badly loses its weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.maplets.correlation import Displacement

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.float32]

_REWEIGHTINGS = 5
_TUKEY = 2.5
_MAD_TO_SIGMA = 1.4826
_LEAST_PIXELS = 60


@dataclass(frozen=True, slots=True, eq=False)
class ImagePair:
    """Observed and rendered image, smoothed alike, ready for many windows.

    Parameters
    ----------
    observed, rendered
        (H, W) images, scaled so that the bright level of the body is 1.
    du, dv
        (H, W) derivatives of the rendered image along columns and rows.
    usable
        (H, W) pixels on the body that neither image has in the dark.
    """

    observed: Image
    rendered: Image
    du: Image
    dv: Image
    usable: BoolArray


def make_pair(observed: Image, rendered: Image, on_body: BoolArray, blur_px: float, dark: float) -> ImagePair:
    """Smooth both images, differentiate, and find the pixels that count.

    Parameters
    ----------
    observed, rendered
        (H, W) signals, bright level 1.
    on_body
        (H, W) pixels well within the body's outline.
    blur_px
        Standard deviation of the smoothing: the derivative of a sampled picture needs some.
    dark
        Level below which a pixel is in the dark; it is left out together with its neighbours.
    """
    shade = (observed < dark) | (rendered < dark)
    near_shade = cv2.dilate(shade.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    smooth = [np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), dtype=np.float32) for image in (observed, rendered)]
    dv, du = (np.asarray(slope, dtype=np.float32) for slope in np.gradient(smooth[1]))
    return ImagePair(smooth[0], smooth[1], du, dv, on_body & ~near_shade)


def refine_window(pair: ImagePair, window: tuple[slice, slice], noise_px2: float) -> Displacement | None:
    """Solve for the shift of a window, with gain, offset and a linear brightness trend as unknowns beside it.

    The rendered image is expanded to first order about no shift, so the shift should be well below a pixel; the next
    rendering removes what is left.

    Parameters
    ----------
    pair
        The images.
    window
        Rows and columns.
    noise_px2
        Area over which differences of the two pictures hold together.

    Returns
    -------
    The shift, or None where too few pixels count or their contrast does not fix both components.
    """
    row, column = np.nonzero(pair.usable[window])
    if len(row) < _LEAST_PIXELS:
        return None
    du, dv, rendered, observed = (
        image[window][row, column].astype(np.float64) for image in (pair.du, pair.dv, pair.rendered, pair.observed)
    )
    trend = [(axis - axis.mean()) / (np.ptp(axis) + 1.0) for axis in (column, row)]
    design = np.stack([-du, -dv, rendered, np.ones(len(row)), *trend], axis=1)
    weights = np.ones(len(row))
    for _ in range(_REWEIGHTINGS):
        weighted = design * weights[:, None]
        normal = design.T @ weighted
        if np.linalg.cond(normal) > 1e12:
            return None
        solution = np.asarray(np.linalg.solve(normal, weighted.T @ observed), dtype=np.float64)
        residual = observed - design @ solution
        sigma = _MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
        weights = np.clip(1.0 - (residual / (_TUKEY * sigma)) ** 2, 0.0, None) ** 2
    gain = float(solution[2])
    if gain <= 0.0:
        return None
    covariance = np.asarray(sigma**2 * noise_px2 / gain**2 * np.linalg.inv(normal)[:2, :2], dtype=np.float64)
    shift: FloatArray = solution[:2] / gain
    model = design @ solution
    return Displacement(shift, covariance, float(np.corrcoef(model, observed)[0, 1]))
