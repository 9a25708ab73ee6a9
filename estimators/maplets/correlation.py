"""Where a window of the rendered image is found in the observed one, by normalised cross-correlation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Image = NDArray[np.float32]

# Second-order polynomial through 3 x 3 values by least squares: rows give 1, x, y, x^2, xy, y^2.
_X, _Y = (axis.ravel().astype(np.float64) for axis in np.meshgrid([-1, 0, 1], [-1, 0, 1]))
_FIT = np.linalg.pinv(np.stack([np.ones(9), _X, _Y, _X * _X, _X * _Y, _Y * _Y], axis=1))
_FARTHEST_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """How far a window of the observed image lies from where it was rendered.

    Parameters
    ----------
    shift_px
        (2,) from the rendered to the observed position.
    covariance_px2
        (2, 2) of the shift.
    correlation
        Of the two pictures, once shifted.
    """

    shift_px: FloatArray
    covariance_px2: FloatArray
    correlation: float


def correlate_window(
    observed: Image, template: Image, usable: Image, corner: tuple[int, int], reach: tuple[int, int], noise_px2: float
) -> Displacement | None:
    """Slide a template over its surroundings in the observed image.

    Parameters
    ----------
    observed
        (H, W) image; beyond its edges it is 0.
    template, usable
        (h, w) window of the rendered image, and 1 where its pixels count, 0 elsewhere.
    corner
        Column and row of the template's first pixel in the rendered image.
    reach
        Largest shift along columns and rows, whole pixels of 1 or more.
    noise_px2
        Area over which differences of the two pictures hold together.

    Returns
    -------
    The shift at the peak of the correlation, or None where the template has no contrast or the peak lies at the
    edge of the search.
    """
    counted = template[usable > 0.0]
    if not counted.size or np.ptp(counted) == 0.0:
        return None
    area = _cut(observed, corner, template.shape, reach)
    correlation = cv2.matchTemplate(area, template, cv2.TM_CCOEFF_NORMED, mask=usable)
    correlation[~np.isfinite(correlation)] = -1.0  # no contrast below the template
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(correlation)), correlation.shape))
    if not (0 < row < correlation.shape[0] - 1 and 0 < column < correlation.shape[1] - 1):
        return None
    peak = _polynomial_peak(correlation[row - 1 : row + 2, column - 1 : column + 2].astype(np.float64))
    if peak is None:
        return None
    offset, height, curvature = peak
    shift = np.array([column - reach[0], row - reach[1]]) + offset
    return Displacement(shift, shift_covariance(height, curvature, float(usable.sum()) / noise_px2), height)


def _cut(observed: Image, corner: tuple[int, int], shape: tuple[int, ...], reach: tuple[int, int]) -> Image:
    """Cut the template's place and its surroundings out of the observed image, with 0 beyond the edges."""
    height, width = observed.shape
    left, top = corner[0] - reach[0], corner[1] - reach[1]
    right, bottom = corner[0] + shape[1] + reach[0], corner[1] + shape[0] + reach[1]
    inside = observed[max(top, 0) : min(bottom, height), max(left, 0) : min(right, width)]
    pad = ((max(-top, 0), max(bottom - height, 0)), (max(-left, 0), max(right - width, 0)))
    return np.ascontiguousarray(np.pad(inside, pad))


def _polynomial_peak(around: FloatArray) -> tuple[FloatArray, float, FloatArray] | None:
    """Offset (2,), value and second derivatives (2, 2) at the top of the polynomial through 3 x 3 correlations."""
    constant, gx, gy, xx, xy, yy = _FIT @ around.ravel()
    curvature = np.array([[2.0 * xx, xy], [xy, 2.0 * yy]])
    if not (xx < 0.0 and np.linalg.det(curvature) > 0.0):
        return None
    offset = np.linalg.solve(curvature, [-gx, -gy])
    if np.abs(offset).max() > _FARTHEST_PX:
        return None
    return offset, float(constant + 0.5 * np.dot([gx, gy], offset)), curvature


def shift_covariance(correlation: float, curvature: FloatArray, samples: float) -> FloatArray:
    """Covariance (2, 2) of a shift from the shape of its peak.

    With gain and offset of the picture unknown and Gaussian noise of unknown level, the log-likelihood of a shift is
    -n/2 log(1 - rho^2); its second derivatives at the peak, n rho rho'' / (1 - rho^2), are the information.

    Parameters
    ----------
    correlation, curvature
        rho and its second derivatives (2, 2), per px^2, negative definite.
    samples
        n, independent ones.
    """
    rho = float(np.clip(correlation, 1e-3, 1.0 - 1e-6))
    information = -samples * rho / (1.0 - rho * rho) * curvature
    return np.asarray(np.linalg.inv(information), dtype=np.float64)
