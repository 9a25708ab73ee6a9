"""The shift of a rendering by the greatest correlation coefficient with the image, and its derivatives."""

from __future__ import annotations

import cv2
import numpy as np

from boresight.estimators.approach.body import Patch
from boresight.scenarios.arrays import FloatArray

_EDGE_PX = 4
_GRID = np.stack([(x := np.tile([-1.0, 0.0, 1.0], 3)), (y := np.repeat([-1.0, 0.0, 1.0], 3)), x * x, x * y, y * y], 1)
_FIT = np.linalg.pinv(np.column_stack([np.ones(9), _GRID]))


def correlation_shift(observed: Patch, rendered: Patch) -> FloatArray:
    """Shift (2,), px, of a rendering onto an image by the peak of their normalised cross-correlation.

    The template is the lit part of the rendering with an edge of sky. All shifts at which it covers half of the light
    of the observed body are tried. A quadratic function of column and row through the peak and its eight neighbours, by
    least squares, has its vertex at the shift, as in GIANT.
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
    around = coefficient[row - 1 : row + 2, column - 1 : column + 2]
    if around.shape != (3, 3) or row == 0 or column == 0:
        return np.array([du, dv])
    _, b, c, d, e, f = _FIT @ around.ravel().astype(np.float64)
    # The gradient b + 2 d x + e y, c + e x + 2 f y vanishes at the vertex, a peak where the Hessian is negative.
    determinant = 4.0 * d * f - e * e
    if d < 0.0 < determinant:
        du += float(np.clip((e * c - 2.0 * f * b) / determinant, -1.0, 1.0))
        dv += float(np.clip((e * b - 2.0 * d * c) / determinant, -1.0, 1.0))
    return np.array([du, dv])


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
