"""Profiles of brightness across a lit limb, and its sub-pixel place by fitting the light of the shape to them."""

from __future__ import annotations

import cv2
import numpy as np

from boresight.estimators.approach.body import Patch
from boresight.estimators.approach.outline import kernel
from boresight.scenarios.arrays import FloatArray

_REACH_PX, _STEP_PX, _FINE_PX = 4.0, 0.5, 0.125
# Variances, px^2, of the square of a pixel and of OpenCV's cubic interpolation: the integral of x^2 w(x) over the
# kernel w is 2 (1 + 2 a) / 15, and negative as a = -0.75.
_PIXEL_PX2, _CUBIC_PX2 = 1.0 / 12.0, -1.0 / 15.0
_FITS = 5
_DAMPING = 1e-9
_MOST_GAIN = 1e3
ACROSS_PX = np.arange(-_REACH_PX, _REACH_PX + 0.5 * _STEP_PX, _STEP_PX)
"""Places of a profile's samples, px along the outward normal."""
# px outside the limb, at the middles of steps, so that the limb is between two.
_FINE = np.arange(-2.0 * _REACH_PX + 0.5 * _FINE_PX, 2.0 * _REACH_PX, _FINE_PX)
DEPTHS_PX = -_FINE[_FINE < 0.0]
"""Places of the light that is seen in profiles, px along the inward normal: as deep as a blur of 1.3 px reaches."""


def sampled(patch: Patch, uv_px: FloatArray) -> FloatArray:
    """Sample a patch at pixels (..., 2) of the image by cubic interpolation; 0 off it."""
    place = (uv_px - [patch.column + 0.5, patch.row + 0.5]).astype(np.float32)
    flat = place.reshape(len(place), -1, 2)
    found = cv2.remap(
        patch.image.astype(np.float32), flat[..., 0], flat[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
    )
    return np.asarray(found, dtype=np.float64).reshape(place.shape[:-1])


def blurred(light: FloatArray, radius_px: float, blur_px: float) -> FloatArray:
    """Blur light (..., d) at `DEPTHS_PX` to profiles (..., k) for `fit_limb`: by point spread, pixel and interpolation.

    Blur also moves the edge of a disc inwards, by sigma^2 / (2 rho), as more of what is around a point of it is
    outside. In a profile, light at the distance r from the middle of a disc of radius rho, ``radius_px``, has the
    weight sqrt(r) for that: the Gaussian in two dimensions, averaged over the angle, for r far above sigma.
    """
    spread = np.exp(-0.5 * (_FINE[:, None] - _FINE) ** 2 / (blur_px**2 + _PIXEL_PX2 + _CUBIC_PX2))
    spread *= np.sqrt(np.maximum(radius_px + _FINE[:, None], _FINE_PX))
    spread /= spread.sum(axis=0)
    return np.asarray(light @ spread[: len(DEPTHS_PX)])


def fit_limb(samples: FloatArray, terms: FloatArray, start_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit profiles across the limb: places (n,) along the outward normal, px, and gains (n, 2) of one or two terms.

    ``samples`` (n, m) are at `ACROSS_PX`, ``terms`` (n, 1 or 2, k) those of `blurred`, and the fit starts at
    ``start_px`` (n,). The gain of a second term that there is not is 0.
    """
    bright = np.maximum(samples.max(axis=1), 1e-300)
    first = np.ascontiguousarray(terms[:, 0])
    second = np.ascontiguousarray(terms[:, 1]) if terms.shape[1] > 1 else np.zeros_like(first)
    place, gain = _fit(samples / bright[:, None], first, second, np.nan_to_num(start_px), float(_FINE[0]))
    return place, gain * bright[:, None]


def second_law(samples: FloatArray, terms: FloatArray, start_px: FloatArray) -> float:
    """Return the share, 0 to 1, of the second term in the light of all profiles; arguments as in `fit_limb`.

    A surface has one law of reflectance. In a profile of a narrow strip of light a change of the law is like a shift:
    with a law for each profile, points are off by 0.1 px where the strip is narrower than 2 px.
    """
    place, gain = fit_limb(samples, terms, start_px)
    first, second = gain[(np.abs(place) < ACROSS_PX[-1] - 1.0) & (gain.sum(axis=1) > 0.0)].sum(axis=0)
    return float(np.clip(second / max(first + second, 1e-300), 0.0, 1.0))


@kernel
def _fit(
    samples: FloatArray, first: FloatArray, second: FloatArray, start: FloatArray, outermost: float
) -> tuple[FloatArray, FloatArray]:
    """Fit places (n,) and gains (n, 2) of two terms (n, k) to profiles (n, m) by damped Gauss-Newton steps.

    The terms are at steps of _FINE_PX from ``outermost`` along the outward normal, px from the limb.
    """
    place, gain = start.copy(), np.zeros((len(samples), 2))
    for row in range(len(samples)):
        for _ in range(_FITS):
            system, a, b = np.zeros((3, 4)), gain[row, 0], gain[row, 1]  # the normal equations
            for sample in range(samples.shape[1]):
                index = (sample * _STEP_PX - _REACH_PX - place[row] - outermost) / _FINE_PX
                low = min(max(int(index), 0), first.shape[1] - 2)
                share = min(max(index - low, 0.0), 1.0)
                p, q = first[row, low], second[row, low]
                dp, dq = first[row, low + 1] - p, second[row, low + 1] - q
                p, q = p + share * dp, q + share * dq
                column = (p, q, -(a * dp + b * dq) / _FINE_PX, samples[row, sample] - a * p - b * q)
                for i in range(3):
                    for j in range(i, 4):
                        system[i, j] += column[i] * column[j]
            damping = _DAMPING * (1.0 + system[0, 0] + system[1, 1] + system[2, 2])
            for i in range(3):
                system[i, i] += damping
            for i in range(2):
                for j in range(i + 1, 3):
                    system[j, j:] -= system[i, j] / system[i, i] * system[i, j:]
            moved = system[2, 3] / system[2, 2]
            second_gain = (system[1, 3] - system[1, 2] * moved) / system[1, 1]
            first_gain = (system[0, 3] - system[0, 2] * moved - system[0, 1] * second_gain) / system[0, 0]
            gain[row, 0] = min(max(a + first_gain, -_MOST_GAIN), _MOST_GAIN)
            gain[row, 1] = min(max(b + second_gain, -_MOST_GAIN), _MOST_GAIN)
            place[row] = min(max(place[row] + min(max(moved, -1.0), 1.0), -_REACH_PX), _REACH_PX)
    return place, gain


def outermost_rise(samples: FloatArray, floor: float) -> FloatArray:
    """Return where profiles (n, m) rise from outside to half of the brightness within: index (n,) of samples, or NaN.

    It is between samples. The brightness within is the greatest of the six samples from the outermost one above
    ``floor`` inwards.
    """
    n, m = samples.shape
    above = samples > floor
    outer = m - 1 - np.argmax(above[:, ::-1], axis=1)
    within = np.maximum(outer[:, None] - np.arange(6), 0)
    half = 0.5 * np.take_along_axis(samples, within, axis=1).max(axis=1)
    over = (samples >= half[:, None]) & (np.arange(m) <= outer[:, None])
    last = m - 1 - np.argmax(over[:, ::-1], axis=1)
    row, after = np.arange(n), np.minimum(last + 1, m - 1)
    here, there = samples[row, last], samples[row, after]
    found = last + (here - half) / np.where(here > there, here - there, 1.0)
    return np.where(above.any(axis=1) & (last < m - 1) & (here > there), found, np.nan)
