"""Registration of patches to later images by inverse compositional alignment (Lucas-Kanade).

S. Baker, I. Matthews: Lucas-Kanade 20 years on, IJCV 56 (2004) 221, with an affine warp and with gain and offset of the
brightness removed. The reference is always the first image of a patch, so that its position does not drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.geometry import pixel_to_opencv

HALF_PX = 5
_ITERATIONS = 15
_MARGIN_PX = 3 * HALF_PX
"""Margin of the spline about the outermost pixel: room for a patch that is deformed or moves during registration."""

_CONVERGED_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class TrackPatches:
    """Patches about n points, of P = (2 HALF_PX + 1)^2 pixels.

    ``values`` (n, P) is the brightness, of mean 0 and length 1. ``steps`` (n, 6, P) is the pseudo-inverse of the
    steepest-descent images: brightness misfit to step of the warp, [linear part (4), shift (2)].
    """

    values: FloatArray
    steps: FloatArray

    def __getitem__(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> TrackPatches:
        return TrackPatches(self.values[rows], self.steps[rows])

    def joined(self, other: TrackPatches) -> TrackPatches:
        """Append other patches."""
        return TrackPatches(np.concatenate([self.values, other.values]), np.concatenate([self.steps, other.steps]))


@dataclass(frozen=True, slots=True, eq=False)
class AffineWarps:
    """Affine maps from patches to an image: ``A x + t``, with A (n, 2, 2) and the position t (n, 2), px."""

    linear: FloatArray
    place_px: FloatArray


class Spline:
    """Cubic spline of an image (H, W), computed about the given pixels (n, 2) and constant beyond that area."""

    def __init__(self, image: NDArray[np.float32], places_px: FloatArray) -> None:
        height, width = image.shape
        low, high = (np.zeros(2), np.zeros(2)) if not len(places_px) else (places_px.min(axis=0), places_px.max(axis=0))
        left, top = np.clip(low.astype(int) - _MARGIN_PX, 0, [width - 1, height - 1])
        right, bottom = high.astype(int) + _MARGIN_PX
        self._corner_px = np.array([left, top], dtype=np.float64)
        # The spline filter runs over all pixels of its input: limit it to the area about the points.
        self._coefficients = spline_filter(image[top : bottom + 1, left : right + 1].astype(np.float64), order=3)

    def at(self, uv_px: FloatArray) -> FloatArray:
        """(...) values at pixels (..., 2)."""
        # scipy counts from the centre of the first pixel, as OpenCV does.
        columns, rows = np.moveaxis(pixel_to_opencv(uv_px) - self._corner_px, -1, 0)
        values: FloatArray = map_coordinates(
            self._coefficients, [rows, columns], order=3, mode="nearest", prefilter=False
        )
        return values


def grid() -> FloatArray:
    """(P, 2) offsets of the pixels of a patch."""
    side = np.arange(-HALF_PX, HALF_PX + 1, dtype=np.float64)
    return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


def cut_patches(image: Spline, places_px: FloatArray) -> TrackPatches:
    """Cut patches about (n, 2) places."""
    offsets = grid()
    at = places_px[:, None] + offsets
    # Mean 0 and length 1 remove offset and gain: the misfit of two such patches is 2 minus twice their correlation.
    values, scale = _normalised(image.at(at))
    # Central differences over two pixels, which also smooth the noise; on the scale of the normalised values.
    slopes = [0.5 * (image.at(at + step) - image.at(at - step)) / scale for step in np.eye(2)]
    x, y = offsets.T
    # Steepest-descent images, gradient times dW/dp with W(x) = (I + [p1 p2; p3 p4]) x + (p5, p6).
    rows = [slopes[0] * x, slopes[0] * y, slopes[1] * x, slopes[1] * y, *slopes]
    steepest = np.stack(rows, axis=1)
    # Project out gain and offset of the brightness, so that they cause no step of the warp.
    steepest = steepest - steepest.mean(axis=2, keepdims=True)
    steepest = steepest - np.einsum("nip,np->ni", steepest, values)[..., None] * values[:, None]
    # Inverse compositional: the Gauss-Newton matrix is that of the patch, computed once; damped for flat patches.
    normal = np.einsum("nip,njp->nij", steepest, steepest)
    damping = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)
    return TrackPatches(values, np.linalg.solve(normal + damping, steepest))


def register_patches(image: Spline, patches: TrackPatches, start: AffineWarps) -> tuple[AffineWarps, FloatArray]:
    """Register patches to an image in at most 15 steps; also return the correlation (n,) of patch and image there."""
    offsets = grid()
    linear, place = start.linear.copy(), start.place_px.copy()
    for _ in range(_ITERATIONS):
        seen, _ = _normalised(image.at(_mapped(linear, place, offsets)))
        step = np.einsum("nip,np->ni", patches.steps, seen - patches.values)
        turn = np.eye(2) + step[:, :4].reshape(-1, 2, 2)
        good = np.abs(np.linalg.det(turn)) > 0.1  # a nearly singular step has no inverse: skip it
        turn[~good] = np.eye(2)
        # The step (B, s) is one of the patch, so the warp (A, t) is composed with its inverse, W := W o dW^-1:
        # A := A B^-1, then t := t - A s.
        linear = linear @ np.linalg.inv(turn)
        shift = np.einsum("nij,nj->ni", linear, np.where(good[:, None], step[:, 4:], 0.0))
        place = place - shift
        # All patches together: those that have converged take steps of about zero in the meantime.
        if np.abs(shift).max(initial=0.0) < _CONVERGED_PX:
            break
    # Once more after the last step, for the correlation at the final warp.
    seen, _ = _normalised(image.at(_mapped(linear, place, offsets)))
    return AffineWarps(linear, place), np.einsum("np,np->n", seen, patches.values)


def _mapped(linear: FloatArray, place: FloatArray, offsets: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,pj->npi", linear, offsets) + place[:, None], dtype=np.float64)


def _normalised(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalise (n, P) to mean 0 and length 1; return the lengths (n, 1) as well."""
    centred = values - values.mean(axis=1, keepdims=True)
    length = np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-12)
    return centred / length, length
