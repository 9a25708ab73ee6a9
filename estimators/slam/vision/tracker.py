"""Feature tracks of a sequence of images, with epipolar outlier rejection."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from boresight.estimators.slam.vision.matching import (
    ImageFeatures,
    direction_inliers,
    fitted_direction,
    fundamental_inliers,
    guided_rows,
    off_plane,
)
from boresight.estimators.slam.vision.point_trackers import (
    LEAST_MATCHES,
    FeatureTracker,
    MatchedImage,
    PatchTracker,
    PointTracker,
    area_change,
    local_flow,
)
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import Prediction
from boresight.scenarios.spec.vision import ImageVisionSpec

_LEAST_APART_PX = 3.0
"""Least distance of a new track from all others: nearer ones would be the same feature."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """Tracks of a frame: their numbers (n,), ascending, and pixels (n, 2).

    ``kept`` (K,) are the epipolar inliers of the matches with the previous frame, ``seconds`` is the computing time
    without detection and matching of descriptors.
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
            before_px = self._features.uv_px[current.pairs[:, 0]]
            after_px = current.features.uv_px[current.pairs[:, 1]]
            kept, direction = self._epipolar_inliers(before_px, after_px, R_cam_body)
            pairs, tracker = current.pairs[kept], self._point_tracker
            # Guided matches are tested against the prediction, which is stricter than the epipolar line: no direction
            # is needed.
            if prediction is not None and isinstance(tracker, FeatureTracker):
                pairs, direction = self._guided(tracker.rows, self._features, current.features, prediction), None
            # Tracks go on if they are found again near their epipolar lines.
            places_px = tracker.places_px
            found = tracker.advance(self._features, current, pairs)
            self._tracks = self._tracks[found]
            if direction is not None:
                rays = self._rays(places_px[found], tracker.places_px, R_cam_body)
                near = np.abs(off_plane(*rays, direction)) < self._limit_rad
                tracker.keep(near)
                self._tracks = self._tracks[near]
            preferred[current.pairs[kept, 1]] = self._keeps_size(before_px[kept], after_px[kept])
        self._features, self._R_cam_body = current.features, R_cam_body
        self._begin(current, preferred)
        return TrackedFrame(self._tracks, self._point_tracker.places_px, kept, time.perf_counter() - started)

    def _epipolar_inliers(
        self, before_px: FloatArray, after_px: FloatArray, R_cam_body: FloatArray
    ) -> tuple[BoolArray, FloatArray | None]:
        """Return which of the matches (K, 2) with the previous frame are inliers (K,), and their direction of motion.

        It is a unit direction fitted to them, body axes; None if they are fewer than 2.
        """
        rays = self._rays(before_px, after_px, R_cam_body)
        if self._spec.epipolar == "fundamental":
            kept = fundamental_inliers(before_px, after_px, self._spec.epipolar_max_px)
        else:
            kept = direction_inliers(*rays, self._limit_rad, self._rng)
        return kept, fitted_direction(rays[0][kept], rays[1][kept]) if kept.sum() >= 2 else None

    def _guided(
        self, features: IndexArray, before: ImageFeatures, after: ImageFeatures, prediction: Prediction
    ) -> IndexArray:
        """(k, 2) rows of the tracks' ``features`` (n,) and of the features matched with them by the prediction."""
        _, ours, theirs = np.intersect1d(self._tracks, prediction.tracks, assume_unique=True, return_indices=True)
        rows = features[ours]
        both = (2 * theirs[:, None] + np.arange(2)).ravel()
        known = Prediction(
            prediction.tracks[theirs], prediction.uv_px[theirs], prediction.covariance_px2[np.ix_(both, both)]
        )
        found = guided_rows(known, before.descriptors[rows], after, self._spec.sigma_px)
        return np.column_stack([rows, found])[found >= 0]

    def _keeps_size(self, before_px: FloatArray, after_px: FloatArray) -> BoolArray:
        """(K,) which of the inlier matches lie where the local scale of the image is constant.

        Towards the limb it changes with the foreshortening, and features are found again less often.
        """
        if len(before_px) < LEAST_MATCHES:
            return np.ones(len(before_px), dtype=np.bool_)
        _, change = local_flow(before_px, after_px, before_px)
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
