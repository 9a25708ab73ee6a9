"""Preparation of an image for detection: checks, the lit ground, even contrast, its gradients, and edges.

Edges are found by two Canny passes: sharp rims with a small kernel, degraded ones with a large kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, Image
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, pixel_from_opencv
from boresight.scenarios.observation import Frame

Mask = NDArray[np.bool_]

SATURATED_SHARE = 0.25  # of the pixels at the highest value: so many are not equal by chance
GROUND_SHARE = 0.02  # of the image that must be lit ground


@dataclass(frozen=True, slots=True, eq=False)
class PreparedImage:
    """An image ready for detection.

    ``even`` (H, W) is the brightness minus its local mean, in units of its local standard deviation, 0 off the ground,
    and ``noise`` (H, W) the standard deviation of the noise in it. ``relief`` (H, W) is the brightness minus its local
    mean, divided by that mean. ``ground`` (H, W) is the lit surface, eroded at its edges, and ``sun_px`` (2,) the unit
    vector towards the Sun along columns and rows.
    """

    even: Image
    relief: Image
    noise: Image
    ground: Mask
    sun_px: NDArray[np.float64]

    def on_ground(self, ellipses: Ellipses, count: int = 48) -> NDArray[np.float64]:
        """Return the share (n,) of each rim on the ground: about half for ellipses along the limb."""
        height, width = self.ground.shape
        pixel = np.floor(ellipses.points(count)[0]).astype(np.int64)
        inside = np.all((pixel >= 0) & (pixel < [width, height]), axis=-1)
        held = np.clip(pixel, 0, [width - 1, height - 1])
        return np.asarray((inside & self.ground[held[..., 1], held[..., 0]]).mean(axis=1), dtype=np.float64)


def check_image(image: Image, camera: Camera) -> None:
    """Raise BoresightError for an image of another size than the camera's, not finite, black, uniform, or saturated."""
    if image.shape != (camera.height_px, camera.width_px):
        size = f"{camera.width_px} x {camera.height_px}"
        raise BoresightError(
            f"the image is {image.shape[::-1]} pixels, the camera {size}: hand in the camera's own image"
        )
    bad = int(np.count_nonzero(~np.isfinite(image)))
    if bad:
        raise BoresightError(f"the image has {bad} pixels that are not finite: mend or leave out the image")
    top = float(image.max())
    if top <= 0.0:
        raise BoresightError("the image is black: no crater can be seen in it")
    if float(image.min()) == top:
        raise BoresightError(f"the image is {top:g} all over: no crater can be seen in it")
    share = float(np.mean(image == top))
    if share > SATURATED_SHARE:
        raise BoresightError(f"{100 * share:.0f} % of the image is saturated at {top:g}: expose it for less time")


def lit_ground(image: Image, floor: float = 0.12, margin_px: int = 4) -> Mask:
    """Return the mask of the lit surface: brighter than ``floor`` times the level of bright pixels, with holes filled.

    Shadows in craters are dark too: dark areas of a crater's size within the bright surface count as ground.
    """
    # The level of bright pixels is their 99th percentile, which a few outliers do not raise.
    smooth = cv2.GaussianBlur(image, (0, 0), 2.0)
    bright = (smooth > floor * np.percentile(smooth, 99.0)).astype(np.uint8)
    closer = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (31, 31))
    pad = 32
    # Replicated beyond the frame by more than the reach of both kernels: the frame is no edge of the ground.
    padded = cv2.copyMakeBorder(bright, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, closer)
    # The limb and the terminator are edges too: the margin keeps their gradients off the ground.
    eaten = cv2.erode(closed, np.ones((2 * margin_px + 1,) * 2, np.uint8))
    return np.asarray(eaten[pad:-pad, pad:-pad] > 0)


def noise_level(image: Image, ground: Mask) -> float:
    """Estimate the standard deviation of white noise on the ground from second differences across both axes.

    The mask is that of Immerkaer (1996), who averages absolute values; we take their median.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    # Planes cancel in the mask; white noise is amplified by the root of the sum of its squares, 6. The median absolute
    # value of a Gaussian is 0.6745 sigma, and a few edges do not change it.
    rough = cv2.filter2D(image, cv2.CV_32F, mask)
    return float(np.median(np.abs(rough[ground])) / 0.6745 / 6.0)


def prepare_image(frame: Frame, camera: Camera, window_px: float) -> PreparedImage:
    """Check an image, find its lit ground and normalise its contrast.

    Fixed thresholds fail at high or low Sun; the brightness is therefore divided by its local standard deviation.
    ``window_px`` is the standard deviation of the Gaussian window of mean and variance. Raise BoresightError as
    `check_image` does, if less than a fiftieth of the image is lit ground, and if the Sun is along the boresight.
    """
    check_image(frame.image, camera)
    ground = lit_ground(frame.image)
    if ground.mean() < GROUND_SHARE:
        raise BoresightError(f"{100 * ground.mean():.1f} % of the image is lit ground: no crater can be seen in it")
    across = np.asarray(frame.sun_dir_cam[:2], dtype=np.float64)
    if np.linalg.norm(across) < 1e-3:
        raise BoresightError("the Sun stands along the boresight: no side of a crater is shaded")
    image = frame.image
    weight = ground.astype(np.float32)
    # Normalised convolution: divided by the blurred mask, so that black sky does not enter the means.
    share = np.maximum(cv2.GaussianBlur(weight, (0, 0), window_px), 1e-3)
    mean = cv2.GaussianBlur(image * weight, (0, 0), window_px) / share
    square = cv2.GaussianBlur(np.square(image - mean) * weight, (0, 0), window_px) / share
    noise = noise_level(image, ground)
    # The noise and 2 % of the mean keep flat ground from being amplified to the contrast of craters.
    spread = np.maximum(np.sqrt(square + (2.0 * noise) ** 2 + (0.02 * mean) ** 2), 1e-12)
    level = np.maximum(mean, 0.02 * float(mean[ground].max()))
    even = np.where(ground, (image - mean) / spread, 0.0).astype(np.float32)
    relief = np.where(ground, (image - mean) / level, 0.0).astype(np.float32)
    return PreparedImage(even, relief, (noise / spread).astype(np.float32), ground, across / np.linalg.norm(across))


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
