"""The shift of a rendering by the greatest correlation coefficient with the image, and its derivatives."""

from __future__ import annotations

import cv2
import numpy as np

from boresight.estimators.approach.body import Patch
from boresight.scenarios.arrays import FloatArray

_EDGE_PX = 4


def correlation_shift(observed: Patch, rendered: Patch) -> FloatArray:
    """Shift (2,), px, of a rendering onto an image by the peak of their normalised cross-correlation.

    The template is the lit part of the rendering with an edge of sky. All shifts at which it covers half of the light
    of the observed body are tried. A least-squares step from the greatest one adds the fraction of a pixel, see
    `correlation_weights`: the vertex of a parabola through the peak's neighbours is drawn to whole pixels where the
    body has few.
    """
    template = _lit_part(rendered)
    height, width = template.image.shape
    field = Patch(
        np.zeros((observed.image.shape[0] + height, observed.image.shape[1] + width)),
        observed.column - width // 2,
        observed.row - height // 2,
    )
    pixels = observed.cut(field)
    coefficient = cv2.matchTemplate(pixels.astype(np.float32), template.image.astype(np.float32), cv2.TM_CCOEFF_NORMED)
    # Windows of sky alone have no coefficient but what rounding makes.
    sums = cv2.integral(pixels)
    light = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    coefficient[light < 0.5 * light.max()] = -1.0
    row, column = (int(i) for i in np.unravel_index(int(coefficient.argmax()), coefficient.shape))
    du, dv = float(field.column + column - template.column), float(field.row + row - template.row)
    seen, model = pixels[row : row + height, column : column + width], template.image
    both = np.column_stack([model.ravel(), np.ones(model.size)])
    gain = float(np.linalg.lstsq(both, seen.ravel(), rcond=None)[0][0])
    step = correlation_weights(seen, gain * model).reshape(2, -1) @ seen.ravel()
    return np.array([du, dv]) + np.clip(step, -1.0, 1.0)


def correlation_weights(observed: FloatArray, rendered: FloatArray) -> FloatArray:
    """Return the derivatives (2, h, w) of the shift of the greatest correlation by the pixels of the observed image.

    With the rendering g T the observed image is g T + e. The peak is that of least squares with a free gain and offset:
    the shift is -(sum D D^T)^-1 sum D e with D the gradient of g T less its parts along T and 1. So the covariance is
    that of the peak: sum D D^T is the curvature of the correlation, e the residual.
    """
    del observed
    gradient = np.stack([np.gradient(rendered, axis=axis).ravel() for axis in (1, 0)])
    common = np.stack([np.ones(rendered.size), rendered.ravel()])
    gradient = gradient - gradient @ common.T @ np.linalg.solve(common @ common.T, common)
    return -np.linalg.solve(gradient @ gradient.T, gradient).reshape(2, *rendered.shape)


def _lit_part(patch: Patch) -> Patch:
    """Cut a patch to its lit part and an edge."""
    rows, columns = np.nonzero(patch.image)
    top, left = max(int(rows.min()) - _EDGE_PX, 0), max(int(columns.min()) - _EDGE_PX, 0)
    box = slice(top, int(rows.max()) + _EDGE_PX + 1), slice(left, int(columns.max()) + _EDGE_PX + 1)
    return Patch(patch.image[box], patch.column + left, patch.row + top)
