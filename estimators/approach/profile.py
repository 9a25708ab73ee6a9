"""The profile of brightness across a lit limb, and the limb's sub-pixel place by fitting it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from boresight.estimators.approach.body import Patch
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.compiled import compiler

kernel, inner = compiler(Path(__file__).parent)

_REACH_PX, _STEP_PX, _FINE_PX = 4.0, 0.5, 0.125
# Variances, px^2, of the square of a pixel and of OpenCV's cubic interpolation: the integral of x^2 w(x) over the
# kernel w is 2 (1 + 2 a) / 15, and negative as a = -0.75.
_PIXEL_PX2, _CUBIC_PX2 = 1.0 / 12.0, -1.0 / 15.0
_FITS = 5
_DAMPING = 1e-9
_MOST_GAIN = 1e3
ACROSS_PX = np.arange(-_REACH_PX, _REACH_PX + 0.5 * _STEP_PX, _STEP_PX)
"""Places of a profile's samples, px along the outward normal."""


def sampled(patch: Patch, uv_px: FloatArray) -> FloatArray:
    """Sample a patch at pixels (..., 2) of the image by cubic interpolation; 0 off it."""
    place = (uv_px - [patch.column + 0.5, patch.row + 0.5]).astype(np.float32)
    flat = place.reshape(len(place), -1, 2)
    found = cv2.remap(
        patch.image.astype(np.float32), flat[..., 0], flat[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
    )
    return np.asarray(found, dtype=np.float64).reshape(place.shape[:-1])


def fit_limb(
    samples: FloatArray, towards_sun: FloatArray, start_px: FloatArray, radius_px: float, blur_px: float
) -> tuple[FloatArray, FloatArray]:
    """Fit profiles across the limb: places (n,) along the outward normal, px, and brightnesses (n,) a pixel inside.

    Near its limb a body is a ball of radius rho: at the depth d inside the limb the normal makes the angle psi with
    that of the limb, cos psi = 1 - d / rho. With the cosines s and t of the Sun to the normal of the limb and to the
    camera, ``towards_sun`` (n, 2), the terminator is where s cos psi + t sin psi = 0, and a Lambertian ball is as
    bright as that. Other laws have other shares of the two terms: that of Lommel and Seeliger is a step where Lambert's
    fades. So both shares are fitted with the place, to profiles blurred by the point spread, the pixel and the
    interpolation of the samples. Blur also moves the edge of a disc inwards, by sigma^2 / (2 rho), as more of what is
    around a point of it is outside. In a profile, light at the distance r from the middle of the ball has the weight
    sqrt(r) for that: the Gaussian in two dimensions, averaged over the angle, for r far above sigma.

    ``samples`` (n, m) are at `ACROSS_PX`, and the fit starts at ``start_px`` (n,).
    """
    # px outside the limb, at the middles of steps, so that the limb is between two.
    fine = np.arange(-2.0 * _REACH_PX + 0.5 * _FINE_PX, 2.0 * _REACH_PX, _FINE_PX)
    inside = np.minimum(np.maximum(-fine, 0.0) / radius_px, 1.0)
    cosine = 1.0 - inside
    sine = np.sqrt(1.0 - cosine**2)
    s, t = towards_sun[:, :1], towards_sun[:, 1:]
    lit = (fine < 0.0) & (s * cosine + t * sine > 0.0)
    spread = np.exp(-0.5 * (fine[:, None] - fine) ** 2 / (blur_px**2 + _PIXEL_PX2 + _CUBIC_PX2))
    spread *= np.sqrt(np.maximum(radius_px + fine[:, None], _FINE_PX))
    spread /= spread.sum(axis=0)
    terms = (lit * cosine) @ spread, (lit * sine) @ spread
    bright = np.maximum(samples.max(axis=1), 1e-300)
    place, gain = _fit(samples / bright[:, None], *terms, np.nan_to_num(start_px), float(fine[0]))
    # At a depth of one pixel.
    cosine_1 = 1.0 - min(1.0 / radius_px, 1.0)
    return place, gain @ [cosine_1, np.sqrt(1.0 - cosine_1**2)] * bright


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
