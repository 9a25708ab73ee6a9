"""The profile of brightness across a lit limb, and the limb's sub-pixel place by fitting it."""

from __future__ import annotations

import cv2
import numpy as np

from boresight.estimators.approach.body import Patch
from boresight.scenarios.arrays import FloatArray

_REACH_PX, _STEP_PX, _FINE_PX = 4.0, 0.5, 0.125
_PIXEL_SIGMA = 1.0 / np.sqrt(12.0)
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
    fades. So both shares are fitted with the place, to profiles blurred by the point spread and the pixel.

    ``samples`` (n, m) are at `ACROSS_PX`, and the fit starts at ``start_px`` (n,).
    """
    # px outside the limb, at the middles of steps, so that the limb is between two.
    fine = np.arange(-2.0 * _REACH_PX + 0.5 * _FINE_PX, 2.0 * _REACH_PX, _FINE_PX)
    inside = np.minimum(np.maximum(-fine, 0.0) / radius_px, 1.0)
    cosine = 1.0 - inside
    sine = np.sqrt(1.0 - cosine**2)
    s, t = towards_sun[:, :1], towards_sun[:, 1:]
    lit = (fine < 0.0) & (s * cosine + t * sine > 0.0)
    spread = np.exp(-0.5 * (fine[:, None] - fine) ** 2 / (blur_px**2 + _PIXEL_SIGMA**2))
    spread /= spread.sum(axis=1, keepdims=True)
    terms = (lit * cosine) @ spread, (lit * sine) @ spread
    n, place = len(samples), np.nan_to_num(start_px)
    bright = np.maximum(samples.max(axis=1, keepdims=True), 1e-300)
    gain = np.zeros((n, 2))
    for _ in range(_FITS):
        index = (ACROSS_PX - place[:, None] - fine[0]) / _FINE_PX
        low = np.clip(index.astype(int), 0, len(fine) - 2)
        share, row = np.clip(index - low, 0.0, 1.0), np.arange(n)[:, None]
        columns, slopes = [], []
        for term in terms:
            here, there = term[row, low], term[row, low + 1]
            columns.append(here + share * (there - here))
            slopes.append((here - there) / _FINE_PX)  # by the place
        design = np.stack([*columns, gain[:, :1] * slopes[0] + gain[:, 1:] * slopes[1]], axis=-1)
        normal = np.einsum("nmi,nmj->nij", design, design)
        normal += _DAMPING * (1.0 + np.trace(normal, axis1=1, axis2=2)[:, None, None]) * np.eye(3)
        error = samples / bright - gain[:, :1] * columns[0] - gain[:, 1:] * columns[1]
        step = np.linalg.solve(normal, np.einsum("nmi,nm->ni", design, error)[..., None])[..., 0]
        gain = np.clip(gain + step[:, :2], -_MOST_GAIN, _MOST_GAIN)
        place = np.clip(place + np.clip(step[:, 2], -1.0, 1.0), -_REACH_PX, _REACH_PX)
    # At a depth of one pixel.
    cosine_1 = 1.0 - min(1.0 / radius_px, 1.0)
    level = gain @ [cosine_1, np.sqrt(1.0 - cosine_1**2)]
    return place, level * bright[:, 0]
