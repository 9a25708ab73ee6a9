"""Feature tracks of a sequence of images, with epipolar outlier rejection."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from boresight.estimators.slam.vision.features import ImageFeatures
from boresight.estimators.slam.vision.matching import (
    direction_inliers,
    fitted_direction,
    fundamental_inliers,
    guided_rows,
    off_plane,
)
from boresight.estimators.slam.vision.point_trackers import (
    LEAST_MATCHES,
    FeatureTracker,
    ImagePair,
    MatchedImage,
    PatchTracker,
    PointTracker,
    area_change,
    local_flow,
)
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.sequence import ImageVisionSpec
from boresight.scenarios.tracks import Prediction

_LEAST_APART_PX = 3.0
"""Least distance of a new track from all others: nearer ones would be the same feature."""


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarInliers:
    """(K,) inliers of the matches with the previous frame.

    ``direction`` is the unit direction of motion fitted to them, body axes; None if they are fewer than 2.
    """

    kept: BoolArray
    direction: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """Tracks of a frame.

    Parameters
    ----------
    tracks, uv_px
        (n,) numbers of the tracks, ascending, and (n, 2) their pixels.
    kept
        (K,) epipolar inliers of the matches with the previous frame.
    seconds
        Computing time, without detection and matching of descriptors.
    """

    tracks: IndexArray
    uv_px: FloatArray
    kept: BoolArray
    seconds: float


class Tracker:
    """Tracker of the strongest features; a lost track never returns, and a new one replaces it."""

    def __init__(self, camera: Camera, spec: ImageVisionSpec, rng: np.random.Generator) -> None:
        self._camera = camera
        self._spec = spec
        self._rng = rng
        self._point_tracker: PointTracker = (
            FeatureTracker() if spec.carry == "feature" else PatchTracker(spec.growth_max)
        )
        self._features: ImageFeatures | None = None
        self._R_cam_body = np.eye(3)
        self._tracks = np.empty(0, dtype=np.int64)
        self._next = 0

    def advance(
        self, current: MatchedImage, R_cam_body: FloatArray, prediction: Prediction | None = None
    ) -> TrackedFrame:
        """Track to the next image, with the known attitude of its camera.

        With a prediction of the tracks' pixels, and tracking by features, the matching is guided by it.
        """
        started = time.perf_counter()
        kept = np.zeros(len(current.pairs), dtype=np.bool_)
        preferred = np.zeros(len(current.features), dtype=np.bool_)
        if self._features is not None:
            inliers = self._epipolar_inliers(self._features, current, R_cam_body)
            kept = inliers.kept
            step, direction = ImagePair(self._features, current, current.pairs[kept]), inliers.direction
            # Guided matches are tested against the prediction, which is stricter than the epipolar line: no direction
            # is needed.
            if prediction is not None and isinstance(self._point_tracker, FeatureTracker):
                step, direction = replace(step, pairs=self._guided(self._features, current, prediction)), None
            self._carry(step, direction, R_cam_body)
            preferred[current.pairs[kept, 1]] = self._keeps_size(self._features, current, kept)
        self._features, self._R_cam_body = current.features, R_cam_body
        self._begin(current, preferred)
        return TrackedFrame(self._tracks, self._point_tracker.places_px, kept, time.perf_counter() - started)

    def _guided(self, before: ImageFeatures, current: MatchedImage, prediction: Prediction) -> IndexArray:
        """(k, 2) rows of the tracks' features and of the features matched with them by the prediction."""
        assert isinstance(self._point_tracker, FeatureTracker)  # noqa: S101
        _, ours, theirs = np.intersect1d(self._tracks, prediction.tracks, assume_unique=True, return_indices=True)
        rows = self._point_tracker.rows[ours]
        both = (2 * theirs[:, None] + np.arange(2)).ravel()
        known = Prediction(
            prediction.tracks[theirs], prediction.uv_px[theirs], prediction.covariance_px2[np.ix_(both, both)]
        )
        found = guided_rows(known, before.descriptors[rows], current.features, self._spec.sigma_px)
        return np.column_stack([rows, found])[found >= 0]

    def _epipolar_inliers(
        self, before: ImageFeatures, current: MatchedImage, R_cam_body: FloatArray
    ) -> EpipolarInliers:
        first, second = before.uv_px[current.pairs[:, 0]], current.features.uv_px[current.pairs[:, 1]]
        rays = self._rays(first, second, R_cam_body)
        if self._spec.epipolar == "fundamental":
            kept = fundamental_inliers(first, second, self._spec.epipolar_max_px)
        else:
            kept = direction_inliers(*rays, self._limit_rad, self._rng)
        return EpipolarInliers(kept, fitted_direction(rays[0][kept], rays[1][kept]) if kept.sum() >= 2 else None)

    def _carry(self, step: ImagePair, direction: FloatArray | None, R_cam_body: FloatArray) -> None:
        """Continue the tracks that are found again near their epipolar lines."""
        before_px = self._point_tracker.places_px
        found = self._point_tracker.advance(step)
        self._tracks = self._tracks[found]
        if direction is not None:
            rays = self._rays(before_px[found], self._point_tracker.places_px, R_cam_body)
            near = np.abs(off_plane(*rays, direction)) < self._limit_rad
            self._point_tracker.keep(near)
            self._tracks = self._tracks[near]

    def _keeps_size(self, before: ImageFeatures, current: MatchedImage, kept: BoolArray) -> BoolArray:
        """Return which of the inlier matches lie where the local scale of the image is constant.

        Towards the limb it changes with the foreshortening, and features are found again less often.
        """
        if kept.sum() < LEAST_MATCHES:
            return np.ones(int(kept.sum()), dtype=np.bool_)
        first, second = before.uv_px[current.pairs[kept, 0]], current.features.uv_px[current.pairs[kept, 1]]
        _, change = local_flow(first, second, first)
        return np.asarray(area_change(change) <= self._spec.growth_max, dtype=np.bool_)

    def _begin(self, current: MatchedImage, preferred: BoolArray) -> None:
        """Start new tracks at the strongest features that are far enough from the others.

        The preferred ones come first: features that were found twice are found again more often.
        """
        apart_px = max(self._spec.spacing_px, _LEAST_APART_PX)
        places = list(self._point_tracker.places_px)
        rows: list[int] = []
        # Features are sorted by strength; the stable sort keeps that order within the preferred ones and within the
        # others.
        for row in np.argsort(~preferred, kind="stable").tolist():
            if len(places) >= self._spec.tracks:
                break
            place = current.features.uv_px[row]
            if not places or float(np.linalg.norm(np.array(places) - place, axis=1).min()) >= apart_px:
                places.append(place)
                rows.append(row)
        self._point_tracker.start(current, np.array(rows, dtype=np.int64))
        self._tracks = np.concatenate([self._tracks, np.arange(self._next, self._next + len(rows), dtype=np.int64)])
        self._next += len(rows)

    def _rays(
        self, before_px: FloatArray, after_px: FloatArray, R_cam_body: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Directions (K, 3) in body axes of pixels of the previous frame and of this one."""
        # Row vectors times R_cam_body: camera to body axes, in which the two rays and the baseline can be compared.
        return self._camera.unproject(before_px) @ self._R_cam_body, self._camera.unproject(after_px) @ R_cam_body

    @property
    def _limit_rad(self) -> float:
        return self._spec.epipolar_max_px * self._camera.pixel_angle_rad
