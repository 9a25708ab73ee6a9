"""Edges by two Canny passes: sharp rims with a small kernel, degraded ones with a large kernel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.estimators.craters.detection.preparation import PreparedImage
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import pixel_from_opencv

_NOISE = 3.5  # gradients below so many standard deviations of their noise are set to zero
_SCALE = 4096.0  # cv2.Canny takes gradients as 16-bit integers


@dataclass(frozen=True, slots=True, eq=False)
class Gradient:
    """Derivatives of the normalised brightness along columns and rows, each (H, W), per pixel."""

    along_u: NDArray[np.float32]
    along_v: NDArray[np.float32]

    @property
    def strength(self) -> NDArray[np.float32]:
        """Return the (H, W) length."""
        return np.hypot(self.along_u, self.along_v)


@dataclass(frozen=True, slots=True, eq=False)
class EdgePixels:
    """Edge pixels of one pass.

    ``uv_px`` (n, 2) are subpixel positions of the steepest gradient, ``gradient`` (n, 2) is that there; ``mask`` (H, W)
    are the pixels.
    """

    uv_px: FloatArray
    gradient: FloatArray
    mask: NDArray[np.bool_]


def gradient_of(image: NDArray[np.float32], kernel_px: int) -> Gradient:
    """Differentiate with Sobel's binomial kernels of an odd width; a linear ramp of slope 1 gives 1."""
    derive, smooth = cv2.getDerivKernels(1, 0, kernel_px, normalize=True)
    along_u = cv2.sepFilter2D(image, cv2.CV_32F, derive, smooth, borderType=cv2.BORDER_REPLICATE)
    along_v = cv2.sepFilter2D(image, cv2.CV_32F, smooth, derive, borderType=cv2.BORDER_REPLICATE)
    # OpenCV's sum is a correlation with the kernel: its response to the ramp u is the kernel's first moment.
    ramp = float(np.abs(np.sum(derive.ravel() * (np.arange(kernel_px) - kernel_px // 2))))
    return Gradient(along_u / np.float32(ramp), along_v / np.float32(ramp))


def noise_gain(kernel_px: int) -> float:
    """Return the standard deviation, per pixel, of one derivative of `gradient_of` for white noise of unit variance."""
    derive, smooth = cv2.getDerivKernels(1, 0, kernel_px, normalize=True)
    ramp = np.abs(np.sum(derive.ravel() * (np.arange(kernel_px) - kernel_px // 2)))
    return float(np.linalg.norm(derive) * np.linalg.norm(smooth) / ramp)


def canny(picture: PreparedImage, kernel_px: int, strong_share: float, weak_ratio: float) -> EdgePixels:
    """Run one pass; ``strong_share`` of the ground exceeds the upper threshold, the lower is ``weak_ratio`` times it.

    ``kernel_px`` is the odd width of the derivative kernel.
    """
    gradient = gradient_of(picture.even, kernel_px)
    strength = gradient.strength
    # The strength of pure noise is Rayleigh distributed: it exceeds 3.5 sigma at 0.2 % of the pixels.
    above = strength > _NOISE * noise_gain(kernel_px) * picture.noise
    upper = float(np.quantile(strength[picture.ground], 1.0 - strong_share))
    # Quantised finely, but without an overflow of 16 bits; the thresholds are scaled alike.
    scale = min(_SCALE, 32000.0 / max(float(strength.max()), 1e-9))
    u16 = np.clip(np.rint(scale * gradient.along_u), -32767, 32767).astype(np.int16)
    v16 = np.clip(np.rint(scale * gradient.along_v), -32767, 32767).astype(np.int16)
    u16[~above], v16[~above] = 0, 0
    # OpenCV's non-maximum suppression and hysteresis on our gradients, with noise set to zero.
    found = cv2.Canny(u16, v16, scale * weak_ratio * upper, scale * upper, L2gradient=True) > 0
    return _place_subpixel(found & picture.ground, gradient, strength)


def _place_subpixel(mask: NDArray[np.bool_], gradient: Gradient, strength: NDArray[np.float32]) -> EdgePixels:
    """Move each edge pixel to the vertex of a parabola through the gradient strengths along its gradient."""
    rows, columns = np.nonzero(mask)
    g = np.stack([gradient.along_u[rows, columns], gradient.along_v[rows, columns]], axis=1).astype(np.float64)
    middle = strength[rows, columns].astype(np.float64)
    n = g / np.maximum(middle, 1e-12)[:, None]

    def neighbour(sign: float) -> FloatArray:
        u = (columns + sign * n[:, 0]).astype(np.float32).reshape(1, -1)
        v = (rows + sign * n[:, 1]).astype(np.float32).reshape(1, -1)
        return np.asarray(_sample(strength, u, v), dtype=np.float64)

    before, after = neighbour(-1.0), neighbour(1.0)
    bend = before - 2.0 * middle + after
    # Vertex of the parabola through (-1, before), (0, middle), (1, after). OpenCV suppresses non-maxima along four
    # directions only, so that a neighbour along the gradient can be higher and the vertex far away: it is clipped.
    offset = np.where(bend < 0.0, 0.5 * (before - after) / np.minimum(bend, -1e-12), 0.0)
    place = np.stack([columns, rows], axis=1) + np.clip(offset, -0.6, 0.6)[:, None] * n
    return EdgePixels(pixel_from_opencv(place), g, mask)


def _sample(field: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
    """Interpolate at array indices, in pieces that ``cv2.remap`` accepts (its sides are 16-bit)."""
    pieces = [
        cv2.remap(field, u[:, i : i + 30000], v[:, i : i + 30000], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for i in range(0, u.shape[1], 30000)
    ]
    return np.concatenate(pieces, axis=1)[0] if pieces else np.empty(0, dtype=np.float32)
