"""Measure the displacement of a window of the rendered image in the observed one, by correlation or least squares.

Normalised cross-correlation finds a window within a search region. Adaptive least squares correlation (Gruen 1985) with
Tukey's biweight refines it to a small fraction of a pixel: shadows of boulders that the onboard shape does not resolve
lie on the side away from the Sun and bias a plain correlation, by a tenth of a pixel at low Sun. Therefore dark pixels
are left out, and pixels with large residuals lose their weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from boresight.scenarios.arrays import MAD_TO_SIGMA, BoolArray, FloatArray, Image

_REWEIGHTINGS = 5
_TUKEY = 2.5
_LEAST_PIXELS = 60

# Second-order polynomial through 3 x 3 values by least squares: rows give 1, x, y, x^2, xy, y^2.
_X, _Y = (axis.ravel().astype(np.float64) for axis in np.meshgrid([-1, 0, 1], [-1, 0, 1]))
_FIT = np.linalg.pinv(np.stack([np.ones(9), _X, _Y, _X * _X, _X * _Y, _Y * _Y], axis=1))
_FARTHEST_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """The displacement (2,), px, of a window from rendered to observed position, and its covariance (2, 2), px^2.

    ``correlation`` is the correlation coefficient of the two images after the shift.
    """

    shift_px: FloatArray
    covariance_px2: FloatArray
    correlation: float


def correlate_window(
    observed: Image, template: Image, usable: Image, corner: tuple[int, int], reach: tuple[int, int], noise_px2: float
) -> Displacement | None:
    """Find a template in its surroundings in the observed image by normalised cross-correlation.

    ``observed`` (H, W) is taken as 0 beyond its edges. ``template`` (h, w) is a window of the rendered image,
    ``usable`` (h, w) its mask, 1 where pixels are used, 0 elsewhere, and ``corner`` has column and row of its first
    pixel in the rendered image. ``reach`` is the largest shift along columns and rows, integers of 1 or more, and
    ``noise_px2`` the area over which differences of the two images are correlated. None where the template has no
    contrast or the peak is at the edge of the search region.
    """
    counted = template[usable > 0.0]
    if not counted.size or np.ptp(counted) == 0.0:
        return None
    # Zero-mean normalised: gain and offset of the observed image, and thus exposure and albedo, do not matter.
    area = _cut(observed, corner, template.shape, reach)
    correlation = cv2.matchTemplate(area, template, cv2.TM_CCOEFF_NORMED, mask=usable)
    correlation[~np.isfinite(correlation)] = -1.0  # no contrast below the template
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(correlation)), correlation.shape))
    # A maximum at the edge of the search region may belong to a peak outside it.
    if not (0 < row < correlation.shape[0] - 1 and 0 < column < correlation.shape[1] - 1):
        return None
    peak = _polynomial_peak(correlation[row - 1 : row + 2, column - 1 : column + 2].astype(np.float64))
    if peak is None:
        return None
    offset, height, curvature = peak
    shift = np.array([column - reach[0], row - reach[1]]) + offset
    return Displacement(shift, shift_covariance(height, curvature, float(usable.sum()) / noise_px2), height)


def _cut(observed: Image, corner: tuple[int, int], shape: tuple[int, ...], reach: tuple[int, int]) -> Image:
    """Return the search region of the template in the observed image, 0 beyond the edges."""
    height, width = observed.shape
    left, top = corner[0] - reach[0], corner[1] - reach[1]
    right, bottom = corner[0] + shape[1] + reach[0], corner[1] + shape[0] + reach[1]
    inside = observed[max(top, 0) : min(bottom, height), max(left, 0) : min(right, width)]
    pad = ((max(-top, 0), max(bottom - height, 0)), (max(-left, 0), max(right - width, 0)))
    return np.ascontiguousarray(np.pad(inside, pad))


def _polynomial_peak(around: FloatArray) -> tuple[FloatArray, float, FloatArray] | None:
    """Offset (2,), value and second derivatives (2, 2) at the maximum of a polynomial through 3 x 3 correlations."""
    constant, gx, gy, xx, xy, yy = _FIT @ around.ravel()
    curvature = np.array([[2.0 * xx, xy], [xy, 2.0 * yy]])
    if not (xx < 0.0 and np.linalg.det(curvature) > 0.0):
        return None
    offset = np.linalg.solve(curvature, [-gx, -gy])
    if np.abs(offset).max() > _FARTHEST_PX:
        return None
    # Value at the vertex: c + g . x / 2, as the curvature times x is -g there.
    return offset, float(constant + 0.5 * np.dot([gx, gy], offset)), curvature


def shift_covariance(correlation: float, curvature: FloatArray, samples: float) -> FloatArray:
    """Return the covariance (2, 2) of a shift from the curvature of its correlation peak.

    With unknown gain and offset, and Gaussian noise of unknown variance, the log-likelihood of a shift is
    -n/2 log(1 - rho^2); its second derivatives at the peak, n rho rho'' / (1 - rho^2), are the information. The
    correlation is rho, ``curvature`` (2, 2) has its second derivatives, per px^2, negative definite, and ``samples`` is
    the number n of independent samples.
    """
    # Clipped, as the information is infinite for a perfect correlation.
    rho = float(np.clip(correlation, 1e-3, 1.0 - 1e-6))
    information = -samples * rho / (1.0 - rho * rho) * curvature
    return np.asarray(np.linalg.inv(information), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ImagePair:
    """Observed and rendered image (H, W), smoothed alike, scaled so that the bright level of the body is 1.

    ``du`` and ``dv`` (H, W) are derivatives of the rendered image along columns and rows, and ``usable`` (H, W) pixels
    on the body that are dark in neither image.
    """

    observed: Image
    rendered: Image
    du: Image
    dv: Image
    usable: BoolArray


def make_pair(observed: Image, rendered: Image, on_body: BoolArray, blur_px: float, dark: float) -> ImagePair:
    """Smooth both images, differentiate the rendered one, and find the usable pixels.

    ``observed`` and ``rendered`` (H, W) are signals, bright level 1, and ``on_body`` (H, W) pixels well within the
    body's outline. ``blur_px`` is the standard deviation of the smoothing, which the derivative of a sampled image
    needs. ``dark`` is the level below which a pixel is left out together with its neighbours.
    """
    # Dark in either image: a shadow that only one of them has would pull the shift.
    shade = (observed < dark) | (rendered < dark)
    near_shade = cv2.dilate(shade.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    smooth = [np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), dtype=np.float32) for image in (observed, rendered)]
    # np.gradient gives the derivative along rows first.
    dv, du = (np.asarray(slope, dtype=np.float32) for slope in np.gradient(smooth[1]))
    return ImagePair(smooth[0], smooth[1], du, dv, on_body & ~near_shade)


def refine_window(pair: ImagePair, window: tuple[slice, slice], noise_px2: float) -> Displacement | None:
    """Solve for the shift of a window, together with gain, offset and a linear trend of the brightness.

    The rendered image is expanded to first order about zero shift, so the shift should be well below a pixel; the next
    rendering reduces the remaining error. ``window`` has rows and columns, and ``noise_px2`` is the area over which
    differences of the two images are correlated. None where too few pixels are usable or their contrast does not
    determine both components.
    """
    row, column = np.nonzero(pair.usable[window])
    if len(row) < _LEAST_PIXELS:
        return None
    du, dv, rendered, observed = (
        image[window][row, column].astype(np.float64) for image in (pair.du, pair.dv, pair.rendered, pair.observed)
    )
    # Scaled to about -1/2 to 1/2, as the brightness is to 0 to 1, for the condition of the normal matrix.
    trend = [(axis - axis.mean()) / (np.ptp(axis) + 1.0) for axis in (column, row)]
    # observed(x) = gain rendered(x - shift) + offset + trend = gain rendered - gain shift . gradient + ...
    design = np.stack([-du, -dv, rendered, np.ones(len(row)), *trend], axis=1)
    weights = np.ones(len(row))
    for _ in range(_REWEIGHTINGS):
        weighted = design * weights[:, None]
        normal = design.T @ weighted
        if np.linalg.cond(normal) > 1e12:
            return None
        solution = np.asarray(np.linalg.solve(normal, weighted.T @ observed), dtype=np.float64)
        residual = observed - design @ solution
        sigma = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
        # Tukey's biweight: pixels beyond 2.5 sigma, as of shadows that the shape does not resolve, have no weight at
        # all.
        weights = np.clip(1.0 - (residual / (_TUKEY * sigma)) ** 2, 0.0, None) ** 2
    # The unknowns of the first two columns are gain times shift.
    gain = float(solution[2])
    # A negative gain fits the negative of the rendering: a wrong place.
    if gain <= 0.0:
        return None
    # Neighbouring residuals are correlated: noise_px2 pixels count as one. The gain converts to the shift.
    covariance = np.asarray(sigma**2 * noise_px2 / gain**2 * np.linalg.inv(normal)[:2, :2], dtype=np.float64)
    shift: FloatArray = solution[:2] / gain
    model = design @ solution
    return Displacement(shift, covariance, float(np.corrcoef(model, observed)[0, 1]))
