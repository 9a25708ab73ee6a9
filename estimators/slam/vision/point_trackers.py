"""Track points from image to image: by matches of their features, or by registration of their patches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from boresight.estimators.slam.vision.features import ImageFeatures
from boresight.estimators.slam.vision.registration import (
    AffineWarps,
    Spline,
    TrackPatches,
    cut_patches,
    register_patches,
)
from boresight.scenarios.arrays import BoolArray, FloatArray, Image, IndexArray

LEAST_MATCHES = 16
_LEAST_CORRELATION = 0.85
_MOST_CORRECTION_PX = 3.0

_NEIGHBOURS = 16
_TRIMS = 2
_KEPT_SHARE = 0.75


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
