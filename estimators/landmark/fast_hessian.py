"""Detect blobs by the Fast-Hessian detector of SURF.

H. Bay, A. Ess, T. Tuytelaars, L. Van Gool: Speeded-Up Robust Features (SURF), Computer Vision and Image Understanding
110 (2008) 346, sections 3.2 and 3.3. OpenCV's free packages do not contain SURF. Unlike SURF, all octaves are sampled
at every pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from boresight.scenarios.arrays import FloatArray, Image

OCTAVES = ((9, 15, 21, 27), (15, 27, 39, 51))
"""Sides of the box filters, pixels: the first two octaves of Bay et al."""

_MIXED_WEIGHT = 0.9
_SCALE_OF_SIDE = 1.2 / 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Blobs of an image, bright and dark.

    ``peaks`` (M, 2) are rows and columns of the maxima, ``offsets_px`` (M, 2) lead from the peaks to the interpolated
    maxima in (u, v), within half a pixel, and ``strength`` (M,) is the determinant of the Hessian at the maximum, of an
    image scaled to 0..1. ``scale_px`` (M,) is the interpolated scale by Bay et al.'s definition: a filter of side 9
    stands for a Gaussian of standard deviation 1.2. The second moments of the filters are larger, so that the scale of
    a Gaussian blob is about three quarters of its standard deviation.
    """

    peaks: NDArray[np.intp]
    offsets_px: FloatArray
    scale_px: FloatArray
    strength: FloatArray


def fast_hessian(image: Image) -> Blobs:
    """Find the maxima of the determinant of the Hessian in position and scale; the image (H, W) is scaled to 0..1."""
    sides = sorted({side for octave in OCTAVES for side in octave})
    layers = {side: determinant(image, side) for side in sides}
    dilated = {side: np.asarray(cv2.dilate(layer, np.ones((3, 3), np.uint8))) for side, layer in layers.items()}
    found = [_maxima(layers, dilated, octave[i - 1 : i + 2]) for octave in OCTAVES for i in range(1, len(octave) - 1)]
    return Blobs(
        np.concatenate([blobs.peaks for blobs in found]),
        np.concatenate([blobs.offsets_px for blobs in found]),
        np.concatenate([blobs.scale_px for blobs in found]),
        np.concatenate([blobs.strength for blobs in found]),
    )


def determinant(image: Image, side: int) -> Image:
    """Dxx Dyy - (0.9 Dxy)^2 of box filters of a side, normalised by their area, (H, W)."""
    lobe = side // 3
    long = 2 * lobe - 1
    # Lobes of weight 1, -2, 1: the whole box once, minus three times its middle third.
    xx = _box(image, (side, long)) - 3.0 * _box(image, (lobe, long))
    yy = _box(image, (long, side)) - 3.0 * _box(image, (long, lobe))
    xy = _mixed(_box(image, (lobe, lobe)), (lobe + 1) // 2)
    # Each derivative is divided by the area of the filter, side^2, so that responses of all sides compare; 0.9 balances
    # the box filters against Gaussian derivatives (Bay et al., section 3.2).
    normalised: Image = (xx * yy - (_MIXED_WEIGHT * xy) ** 2) / np.float32(side**4)
    return normalised


def _box(image: Image, size: tuple[int, int]) -> Image:
    """Sum over a window (width, height) about each pixel, by running sums whose cost does not depend on the size."""
    return np.asarray(cv2.boxFilter(image, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_REPLICATE))


def _mixed(lobe: Image, reach: int) -> Image:
    """Mixed derivative Dxy: four lobes about each pixel with alternating signs."""
    wide = cv2.copyMakeBorder(lobe, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    first, last = slice(None, -2 * reach), slice(2 * reach, None)
    mixed: Image = wide[first, first] + wide[last, last] - wide[first, last] - wide[last, first]
    return mixed


def _maxima(layers: Mapping[int, Image], dilated: Mapping[int, Image], sides: tuple[int, ...]) -> Blobs:
    """Maxima of the middle one of three layers (H, W) among their 26 neighbours."""
    below, middle, above = sides
    around = np.maximum(np.maximum(dilated[below], dilated[above]), dilated[middle])
    highest = (layers[middle] == around) & (layers[middle] > 0.0)
    # Filters that reach beyond the image see replicated pixels.
    reach = above // 2 + 1
    highest[:reach] = highest[-reach:] = False
    highest[:, :reach] = highest[:, -reach:] = False
    peaks = np.argwhere(highest)
    offsets = _interpolated([layers[side] for side in sides], peaks)
    scale_px = _SCALE_OF_SIDE * (middle + offsets[:, 2] * (middle - below))
    return Blobs(peaks, offsets[:, :2], scale_px, layers[middle][highest].astype(np.float64))


def _interpolated(layers: Sequence[Image], peaks: NDArray[np.intp]) -> FloatArray:
    """Offsets (M, 3) in (u, v, layer), within a half, to the maximum of a quadratic through the neighbours.

    After M. Brown, D. Lowe: Invariant features from interest point groups, BMVC 2002; 0 where the quadratic has no
    maximum.
    """
    rows, columns = peaks[:, 0], peaks[:, 1]

    def at(step: NDArray[np.intp]) -> FloatArray:
        return np.asarray(layers[1 + step[2]][rows + step[1], columns + step[0]], dtype=np.float64)

    axes = np.eye(3, dtype=np.intp)
    slope = np.stack([0.5 * (at(axis) - at(-axis)) for axis in axes], axis=-1)
    curvature = np.empty((len(peaks), 3, 3))
    for i, one in enumerate(axes):
        for j, other in enumerate(axes):
            if i == j:
                curvature[:, i, i] = at(one) - 2.0 * at(0 * one) + at(-one)
            else:
                curvature[:, i, j] = 0.25 * (at(one + other) + at(-one - other) - at(one - other) - at(other - one))
    # Only a negative definite curvature has a maximum; elsewhere the Newton step leads to a saddle.
    peaked = np.linalg.eigvalsh(curvature)[:, -1] < 0.0
    offsets = np.zeros((len(peaks), 3))
    offsets[peaked] = -np.linalg.solve(curvature[peaked], slope[peaked, :, None])[..., 0]
    return np.clip(offsets, -0.5, 0.5)
