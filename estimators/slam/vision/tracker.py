"""Tracks of features from frame to frame."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.vision.carriers import LEAST_MATCHES, Carrier, FeatureCarrier, Look, PatchCarrier, Step
from estimators.slam.vision.epipolar import (
    agree_with_direction,
    agree_with_fundamental,
    fitted_direction,
    off_plane,
)
from estimators.slam.vision.features import Features
from estimators.slam.vision.flow import growth, local_flow
from estimators.slam.vision.guided import guided_rows
from scenarios.geometry import Camera
from scenarios.spec.sequence import ImageVisionSpec
from scenarios.tracks import Prediction

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_LEAST_APART_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """(K,) which of the matches with the frame before RANSAC keeps.

    ``direction`` is the unit direction of motion that those agree on, body axes; None if they are too few.
    """

    kept: BoolArray
    direction: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the vision layer tells of a frame.

    Parameters
    ----------
    tracks, uv_px
        (n,) numbers of the tracks, ascending, and (n, 2) where they are seen.
    kept
        (K,) which of the matches with the frame before RANSAC keeps.
    seconds
        Time that it took, without detection and matching of descriptors.
    """

    tracks: IndexArray
    uv_px: FloatArray
    kept: BoolArray
    seconds: float


class Tracker:
    """Follows the strongest features; one that is not found again is lost for good, and another takes its place."""

    def __init__(self, camera: Camera, spec: ImageVisionSpec, rng: np.random.Generator) -> None:
        self._camera = camera
        self._spec = spec
        self._rng = rng
        self._carrier: Carrier = FeatureCarrier() if spec.carry == "feature" else PatchCarrier(spec.growth_max)
        self._features: Features | None = None
        self._R_cam_body = np.eye(3)
        self._tracks = np.empty(0, dtype=np.int64)
        self._next = 0

    def advance(self, look: Look, R_cam_body: FloatArray, prediction: Prediction | None = None) -> Tracked:
        """Take the next image in, with the known attitude of its camera.

        Where it is predicted where tracks will be, and features carry them, those are sought there.
        """
        started = time.perf_counter()
        kept = np.zeros(len(look.pairs), dtype=np.bool_)
        settled = np.zeros(len(look.features), dtype=np.bool_)
        if self._features is not None:
            agreed = self._agree(self._features, look, R_cam_body)
            kept = agreed.kept
            step, direction = Step(self._features, look, look.pairs[kept]), agreed.direction
            if prediction is not None and isinstance(self._carrier, FeatureCarrier):
                step, direction = replace(step, pairs=self._guided(self._features, look, prediction)), None
            self._carry(step, direction, R_cam_body)
            settled[look.pairs[kept, 1]] = self._settled(self._features, look, kept)
        self._features, self._R_cam_body = look.features, R_cam_body
        self._begin(look, settled)
        return Tracked(self._tracks, self._carrier.places_px, kept, time.perf_counter() - started)

    def _guided(self, before: Features, look: Look, prediction: Prediction) -> IndexArray:
        """(k, 2) rows of features of tracks and of those matched with them."""
        assert isinstance(self._carrier, FeatureCarrier)  # noqa: S101
        _, ours, theirs = np.intersect1d(self._tracks, prediction.tracks, assume_unique=True, return_indices=True)
        rows = self._carrier.rows[ours]
        both = (2 * theirs[:, None] + np.arange(2)).ravel()
        known = Prediction(
            prediction.tracks[theirs], prediction.uv_px[theirs], prediction.covariance_px2[np.ix_(both, both)]
        )
        found = guided_rows(known, before.descriptors[rows], look.features, self._spec.sigma_px)
        return np.column_stack([rows, found])[found >= 0]

    def _agree(self, before: Features, look: Look, R_cam_body: FloatArray) -> Agreement:
        first, second = before.uv_px[look.pairs[:, 0]], look.features.uv_px[look.pairs[:, 1]]
        rays = self._rays(first, second, R_cam_body)
        if self._spec.epipolar == "fundamental":
            kept = agree_with_fundamental(first, second, self._spec.epipolar_max_px)
        else:
            kept = agree_with_direction(*rays, self._limit_rad, self._rng)
        return Agreement(kept, fitted_direction(rays[0][kept], rays[1][kept]) if kept.sum() >= 2 else None)

    def _carry(self, step: Step, direction: FloatArray | None, R_cam_body: FloatArray) -> None:
        """Let the tracks live on that are found again, near their epipolar lines."""
        before_px = self._carrier.places_px
        found = self._carrier.carry(step)
        self._tracks = self._tracks[found]
        if direction is not None:
            rays = self._rays(before_px[found], self._carrier.places_px, R_cam_body)
            near = np.abs(off_plane(*rays, direction)) < self._limit_rad
            self._carrier.drop(near)
            self._tracks = self._tracks[near]

    def _settled(self, before: Features, look: Look, kept: BoolArray) -> BoolArray:
        """Tell of the matches that are kept whether the image about them keeps its size.

        Towards the limb it does not: what is seen there is foreshortened and bends out of its plane.
        """
        if kept.sum() < LEAST_MATCHES:
            return np.ones(int(kept.sum()), dtype=np.bool_)
        first, second = before.uv_px[look.pairs[kept, 0]], look.features.uv_px[look.pairs[kept, 1]]
        _, change = local_flow(first, second, first)
        return np.asarray(growth(change) <= self._spec.growth_max, dtype=np.bool_)

    def _begin(self, look: Look, settled: BoolArray) -> None:
        """Fill up with the strongest features that keep their distance from the tracks.

        Those that are settled come first: what was found twice is found again more often.
        """
        apart_px = max(self._spec.spacing_px, _LEAST_APART_PX)
        places = list(self._carrier.places_px)
        rows: list[int] = []
        for row in np.argsort(~settled, kind="stable").tolist():
            if len(places) >= self._spec.tracks:
                break
            place = look.features.uv_px[row]
            if not places or float(np.linalg.norm(np.array(places) - place, axis=1).min()) >= apart_px:
                places.append(place)
                rows.append(row)
        self._carrier.add(look, np.array(rows, dtype=np.int64))
        self._tracks = np.concatenate([self._tracks, np.arange(self._next, self._next + len(rows), dtype=np.int64)])
        self._next += len(rows)

    def _rays(
        self, before_px: FloatArray, after_px: FloatArray, R_cam_body: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Directions (K, 3) in body axes of pixels of the frame before and of this one."""
        return self._camera.unproject(before_px) @ self._R_cam_body, self._camera.unproject(after_px) @ R_cam_body

    @property
    def _limit_rad(self) -> float:
        return self._spec.epipolar_max_px * self._camera.pixel_angle_rad
