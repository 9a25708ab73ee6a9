"""Track points from image to image: by matches of their features, or by registration of their patches.

Patches are registered by inverse compositional alignment: S. Baker, I. Matthews: Lucas-Kanade 20 years on, IJCV 56
(2004) 221, with an affine warp and with gain and offset of the brightness removed. The reference is always the first
image of a patch, so that its position does not drift.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter
from scipy.spatial import cKDTree

from boresight.estimators.slam.vision.matching import ImageFeatures
from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray
from boresight.scenarios.geometry import pixel_to_opencv

HALF_PX = 5
_ITERATIONS = 15
_MARGIN_PX = 3 * HALF_PX
"""Margin of the spline about the outermost pixel: room for a patch that is deformed or moves during registration."""

_CONVERGED_PX = 1e-3

LEAST_MATCHES = 16
_LEAST_CORRELATION = 0.85
_MOST_CORRECTION_PX = 3.0

_NEIGHBOURS = 16
_TRIMS = 2
_KEPT_SHARE = 0.75


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


def local_flow(before_px: FloatArray, after_px: FloatArray, at_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit an affine map (local optical flow) to the matches nearest to each point, without the worst quarter.

    ``before_px`` and ``after_px`` (K, 2) are matches, K at least 3, and ``at_px`` (n, 2) points of the first image.
    Return the predicted points (n, 2) in the second image, and the derivatives (n, 2, 2) of the map there.
    """
    # Over a few neighbours the ground is nearly a plane and the flow nearly affine.
    count = min(_NEIGHBOURS, len(before_px))
    _, rows = cKDTree(before_px).query(at_px, k=count)
    # Relative to the point: the constant of the fit is then the predicted pixel itself.
    offset = before_px[rows] - at_px[:, None]
    target = after_px[rows]
    design = np.concatenate([offset, np.ones((*offset.shape[:2], 1))], axis=2)
    weight = np.ones(offset.shape[:2])
    for _ in range(_TRIMS + 1):
        weighted = design * weight[..., None]
        # The small diagonal makes matches on one line solvable.
        normal = np.einsum("nki,nkj->nij", weighted, design) + 1e-9 * np.eye(3)
        found = np.linalg.solve(normal, np.einsum("nki,nkj->nij", weighted, target))
        # Trimmed least squares: remaining wrong matches are among the largest misfits.
        misfit = np.linalg.norm(np.einsum("nki,nij->nkj", design, found) - target, axis=2)
        weight = (misfit <= np.quantile(misfit, _KEPT_SHARE, axis=1, keepdims=True)).astype(np.float64)
    # The design has row vectors, x' M: the derivative is M'.
    return found[:, 2], np.swapaxes(found[:, :2], 1, 2)


def area_change(change: FloatArray) -> FloatArray:
    """(n,) factor by which an area grows or shrinks, at least 1, under maps with derivatives (n, 2, 2)."""
    area = np.maximum(np.abs(np.linalg.det(change)), 1e-12)
    return np.asarray(np.maximum(area, 1.0 / area), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class MatchedImage:
    """An image (H, W), its features, and their matches with those of the previous image.

    ``pairs`` are (K, 2) rows of the previous features and of these, from `match_descriptors`; none in the first image.
    """

    image: Image
    features: ImageFeatures
    pairs: IndexArray

    @cached_property
    def spline(self) -> Spline:
        """Cubic spline of the image about its features."""
        return Spline(self.image, self.features.uv_px)


class FeatureTracker:
    """Tracking by matched features: of n points, in the order in which they were started.

    ``rows`` (n,) are the features of the points in the present image, ``places_px`` (n, 2) their pixels.
    """

    def __init__(self) -> None:
        self.rows = np.empty(0, dtype=np.int64)
        self.places_px = np.empty((0, 2))

    def advance(self, before: ImageFeatures, after: MatchedImage, pairs: IndexArray) -> BoolArray:
        """Track to the next image; return which points (n,) were found there. The others are dropped.

        ``pairs`` (K, 2) are the inlier matches of the features of both images.
        """
        follow = np.full(len(before), -1, dtype=np.int64)
        follow[pairs[:, 0]] = pairs[:, 1]
        rows = follow[self.rows]
        found = rows >= 0
        self.rows = rows[found]
        self.places_px = after.features.uv_px[self.rows]
        return found

    def keep(self, keep: BoolArray) -> None:
        """Drop all points but those marked in ``keep`` (n,)."""
        self.rows, self.places_px = self.rows[keep], self.places_px[keep]

    def start(self, current: MatchedImage, rows: IndexArray) -> None:
        """Start points at features ``rows`` of the present image."""
        self.rows = np.concatenate([self.rows, rows])
        self.places_px = np.concatenate([self.places_px, current.features.uv_px[rows]])


class PatchTracker:
    """Tracking by registration of the patch from each point's first image; the methods are those of `FeatureTracker`.

    The local flow of the matches gives the initial position and deformation of the patch.
    """

    def __init__(self, growth_max: float) -> None:
        self._growth_max = growth_max
        self._patches: TrackPatches | None = None
        self._warps = AffineWarps(np.empty((0, 2, 2)), np.empty((0, 2)))

    @property
    def places_px(self) -> FloatArray:
        """(n, 2) pixels of the points in the present image."""
        return self._warps.place_px

    def advance(self, before: ImageFeatures, after: MatchedImage, pairs: IndexArray) -> BoolArray:
        """Track to the next image."""
        none = np.zeros(len(self.places_px), dtype=np.bool_)
        if self._patches is None or len(pairs) < LEAST_MATCHES or not len(none):
            self.keep(none)
            return none
        first, second = before.uv_px[pairs[:, 0]], after.features.uv_px[pairs[:, 1]]
        expected_px, change = local_flow(first, second, self._warps.place_px)
        # The patch is always that of the first image, so its deformation is the product of all changes since.
        start = AffineWarps(change @ self._warps.linear, expected_px)
        self._warps, correlation = register_patches(after.spline, self._patches, start)
        corrected_px = np.linalg.norm(self._warps.place_px - expected_px, axis=1)
        found: BoolArray = (correlation > _LEAST_CORRELATION) & (corrected_px < _MOST_CORRECTION_PX)
        found &= area_change(change) < self._growth_max**2
        self.keep(found)
        return found

    def keep(self, keep: BoolArray) -> None:
        """Drop all points but some."""
        if self._patches is not None:
            self._patches = self._patches[keep]
        self._warps = AffineWarps(self._warps.linear[keep], self._warps.place_px[keep])

    def start(self, current: MatchedImage, rows: IndexArray) -> None:
        """Start points at features."""
        if not len(rows):
            return
        places = current.features.uv_px[rows]
        fresh = cut_patches(current.spline, places)
        self._patches = fresh if self._patches is None else self._patches.joined(fresh)
        self._warps = AffineWarps(
            np.concatenate([self._warps.linear, np.tile(np.eye(2), (len(rows), 1, 1))]),
            np.concatenate([self._warps.place_px, places]),
        )


PointTracker = FeatureTracker | PatchTracker
