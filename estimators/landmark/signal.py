"""Separate the body from the background of an image and scale it, for corners, centroid and alignment."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import sigmaclip

from boresight.estimators.contract import Stopwatch
from boresight.scenarios.arrays import MAD_TO_SIGMA
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Frame

KNOWN_SKY = (0.0, 0.0)
"""Level and noise of the background of a rendered image."""

_CORNER_FRACTION = 1 / 16
_MIN_SIDE_PX = 16
_MIN_SIGNAL_PX = 16
_FULL_SCALE_PERCENTILE = 99.0
_COVERED, _CLEAR_SIGMA = 0.1, 5.0
_UNEVEN, _UNEVEN_TIMES = 0.05, 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """An image without its background.

    ``image`` (H, W) float32 is 0 on the background, 1 at the body's bright level (the 99th percentile of its pixels),
    whatever the unit of the image. ``background`` is the level that was subtracted, and ``noise`` its standard
    deviation, in the image's unit.
    """

    image: NDArray[np.float32]
    background: float
    noise: float

    @property
    def empty(self) -> bool:
        """Whether no pixel is above the background: a black image."""
        return not self.image.any()


def unusable(frame: Frame, camera: Camera) -> str:
    """Return the reason why no method can use an image, '' without one; raise BoresightError if its size is wrong."""
    expected = (camera.height_px, camera.width_px)
    if frame.image.shape != expected:
        raise BoresightError(
            f"the image has shape {frame.image.shape}, but the camera's is {expected}: hand in the camera's own image"
        )
    return "" if np.isfinite(frame.image).all() else "the image holds NaN or infinite pixels"


def observed_signal(frame: Frame, camera: Camera, clock: Stopwatch | None = None) -> NDArray[np.float32] | str:
    """Return the signal (H, W) of an observed image, see `Signal`, or the reason why no pose can be estimated from it.

    ``clock`` adds the time to ``centroid``, the stage of the paper's Table 1 that begins with it. Raise BoresightError
    if the image does not have the camera's size: the caller has passed another image.
    """
    if fault := unusable(frame, camera):
        return fault
    with nullcontext() if clock is None else clock("centroid"):
        signal = extract_signal(frame.image)
    return "the image is black: nothing above its background" if signal.empty else signal.image


def background_level(image: NDArray[np.float32]) -> tuple[float, float]:
    """Level and standard deviation of the dark sky in the darkest corner, or of shadows where no corner shows sky.

    Such a corner is brighter than a tenth of the image's range, and than what the differences of neighbouring pixels
    have of noise; or it is uneven: its deviation is a twentieth of that range and twice the noise of its pixels. The
    darkest hundredth of the image are then taken for black, and no noise is told from texture.
    """
    height, width = image.shape
    rows, columns = max(4, round(height * _CORNER_FRACTION)), max(4, round(width * _CORNER_FRACTION))
    blocks = [image[r, c] for r in (slice(rows), slice(-rows, None)) for c in (slice(columns), slice(-columns, None))]
    corner = min(blocks, key=lambda block: float(np.median(block)))
    level, noise = background_of(corner)
    low, high = (float(value) for value in np.percentile(image, (1.0, _FULL_SCALE_PERCENTILE)))
    rise = level - low
    bright = rise > _COVERED * (high - low) and rise > _CLEAR_SIGMA * _noise_of_pixels(image)
    uneven = noise > _UNEVEN * (high - level) and noise > _UNEVEN_TIMES * _noise_of_pixels(corner)
    return (min(low, level), 0.0) if bright or uneven else (level, noise)


def _noise_of_pixels(image: NDArray[np.float32]) -> float:
    return background_of(np.diff(image, axis=1))[1] / math.sqrt(2.0)


def background_of(sky: NDArray[np.float32]) -> tuple[float, float]:
    """Level and standard deviation of pixels of the sky, without stars, hot pixels and what of the body is among them.

    They are the median and the scaled median absolute deviation. Where noise is below a grey level most pixels are
    equal, and that deviation is 0: then mean and deviation of the pixels within five deviations, from the levels next
    to the median on.
    """
    values = sky.astype(np.float64).ravel()
    level = float(np.median(values))
    apart = np.abs(values - level)
    noise = MAD_TO_SIGMA * float(np.median(apart))
    if noise > 0.0:
        return level, noise
    step = float(np.diff(np.unique(values)).min(initial=np.inf))
    near = sigmaclip(values[apart <= _CLEAR_SIGMA * step], _CLEAR_SIGMA, _CLEAR_SIGMA).clipped
    return float(near.mean()), float(near.std())


def extract_signal(
    image: NDArray[np.float32],
    sky: tuple[float, float] | None = None,
    threshold_sigma: float = 5.0,
    threshold_fraction: float = 0.02,
) -> Signal:
    """Subtract the background and scale the rest to a fixed range.

    ``image`` (H, W) is any linear measure of radiance. ``sky`` is level and standard deviation of the background, where
    they are known; measured in the image if None. Pixels less than ``threshold_sigma`` standard deviations above the
    background become 0. So do those below ``threshold_fraction`` of the body's bright level, which removes haze and
    quantisation. Raise BoresightError if the image is not two-dimensional or holds NaN or infinity.
    """
    if image.ndim != 2 or min(image.shape) < _MIN_SIDE_PX:
        raise BoresightError(f"an image must be (H, W) with at least {_MIN_SIDE_PX} pixels a side, not {image.shape}")
    if not np.isfinite(image).all():
        raise BoresightError(f"the image holds {int((~np.isfinite(image)).sum())} pixels that are NaN or infinite")
    level, noise = background_level(image) if sky is None else sky
    rise = image.astype(np.float32) - np.float32(level)
    # Pixels of the body, by the noise alone: the level of the body, on which the second threshold depends, is not known
    # yet.
    bright = rise[rise > max(threshold_sigma * noise, 0.0)]
    if bright.size < _MIN_SIGNAL_PX:
        return Signal(np.zeros_like(rise), level, noise)
    # A percentile, as glints and cosmic rays would scale the whole image down.
    full_scale = float(np.percentile(bright, _FULL_SCALE_PERCENTILE))
    # The higher of both: noise decides in faint images, haze and quantisation in bright ones.
    floor = max(threshold_sigma * noise, threshold_fraction * full_scale)
    scaled = np.where(rise > floor, rise / np.float32(full_scale), np.float32(0.0))
    return Signal(scaled.astype(np.float32), level, noise)
