"""Errors of pixels that add up along a track, in an adjustment of views: a random walk, and a field common to all.

A landmark is the point that its track follows, at the frame of its `branch`: the frame in which the track began, or the
oldest one of the window. From there on each pixel of the track is off by a walk, eliminated with the landmark, and the
field moves the point (`TrackFrame`). What a window hands to the next one is about the landmark at the new oldest frame.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from boresight.estimators.slam.adjustment.problem import NO_PRIOR, AddedErrors, Adjustment, QuadraticPrior
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame

FIELD = 2**60
"""Number of the view that stands for the field: after those of all frames."""


class TrackErrors:
    """What the frames so far declare of such errors, and the frames in which their tracks began.

    ``since`` is the oldest frame of the window.
    """

    def __init__(self) -> None:
        self.since = 0
        self.field_m = 0.0
        self._began: dict[int, int] = {}
        # Sums over the frames up to each: variances of the steps, and rotations from camera to body axes.
        self._walk_px2: list[float] = []
        self._R_body_cam: list[FloatArray] = []

    def add(self, frame: TrackFrame) -> None:
        """Add the next frame."""
        number = len(self._walk_px2)
        self._walk_px2.append(frame.walk_px**2 + (self._walk_px2[-1] if number else 0.0))
        self._R_body_cam.append(frame.R_cam_body.T + (self._R_body_cam[-1] if number else 0.0))
        self.field_m = self.field_m if number else frame.field_m
        for track in frame.tracks.tolist():
            self._began.setdefault(track, number)

    @property
    def declared(self) -> bool:
        """Whether there are any."""
        return self.field_m > 0.0 or sum(self._walk_px2[-1:]) > 0.0

    def branch(self, track: int) -> int:
        """Return the frame at which a landmark is the point that its track follows."""
        return max(self._began[track], self.since)

    def walk_px2(self, view: int, tracks: Sequence[int]) -> FloatArray:
        """(n,) variance of the walk of each track at a frame, px^2."""
        if not self.declared:
            return np.zeros(len(tracks))
        walked = self._walk_px2
        return np.array([walked[view] - walked[self.branch(track)] for track in tracks], dtype=np.float64)

    def views(self, views: Sequence[int]) -> list[int]:
        """Return views, and the field if there is one."""
        return [*views, FIELD] if self.field_m else [*views]

    def prior(self, prior: QuadraticPrior | None) -> QuadraticPrior | None:
        """Return a prior without landmarks and that of the field."""
        if not self.field_m:
            return prior
        given = NO_PRIOR if prior is None else prior
        origin_m, information = np.append(given.origin_m, np.zeros((1, 3)), axis=0), np.eye(3) / self.field_m**2
        return QuadraticPrior(
            np.append(given.views, FIELD),
            given.points,
            origin_m,
            np.asarray(block_diag(given.information, information), dtype=np.float64),
            np.append(given.gradient, np.zeros(3)),
        )

    def extended(
        self,
        problem: Adjustment,
        views: Sequence[int],
        landmarks: tuple[Sequence[int], FloatArray],
        merged: Mapping[int, Set[int]] | None = None,
    ) -> Adjustment:
        """Return the adjustment of ``views`` with these errors, and with the field as its last view.

        ``landmarks`` are tracks and points (L, 3), m. In a map of all frames ``merged`` has the tracks of landmarks
        with more than one; each begins anew at the landmark. The normals of the surface are taken as those of a sphere
        about the body's centre.
        """
        if not self.declared:
            return problem
        seen = problem.pixels.subset(np.lexsort((problem.pixels.view, problem.pixels.point)))
        tracks, points_m = landmarks
        if merged is None:
            branch = np.array([self.branch(track) for track in tracks], dtype=np.int64)[seen.point]
        else:
            began = [sorted(self._began[one] for one in merged.get(track, {track})) for track in tracks]
            seen_at = zip(seen.view.tolist(), seen.point.tolist(), strict=True)
            branch = np.array([began[j][bisect_right(began[j], views[i]) - 1] for i, j in seen_at], dtype=np.int64)
        here, walked = np.array(views, dtype=np.int64)[seen.view], np.array(self._walk_px2)
        moved = np.zeros((0, 3, 3))
        if self.field_m:
            moved = self._moved(points_m[seen.point], branch, here)
            still = np.concatenate([problem.R_cam_body, np.eye(3)[None]])
            problem = replace(problem, R_cam_body=still, free_views=np.append(problem.free_views, True))
        added = AddedErrors(branch, walked[here] - walked[branch], moved)
        return replace(problem, pixels=replace(seen, added=added))

    def moved_m(self, track: int, view: int, point_m: FloatArray, field_m: FloatArray) -> FloatArray:
        """(3,) displacement of the point (3,) that a track follows by a field (3,), from its branch to a frame."""
        if not self.field_m:
            return np.zeros(3)
        moved = self._moved(point_m[None], np.array([self.branch(track)]), np.array([view]))
        return np.asarray(moved[0] @ field_m, dtype=np.float64)

    def _moved(self, points_m: FloatArray, start: IndexArray, end: IndexArray) -> FloatArray:
        """(k, 3, 3) displacement of points (k, 3) between two frames by the field, body axes from camera axes."""
        normals = points_m / np.linalg.norm(points_m, axis=1)[:, None]
        turned = np.array(self._R_body_cam)
        along = np.einsum("ki,kij->kj", normals, turned[end] - turned[start])
        return np.asarray(normals[:, :, None] * along[:, None, :], dtype=np.float64)

    def carried(
        self, prior: QuadraticPrior, since: int, camera: Camera, at: tuple[FloatArray, FloatArray]
    ) -> QuadraticPrior:
        """Return a prior of landmarks before the oldest frame, by their tracks, as one at that frame.

        ``since`` is the frame that was the oldest before; ``at`` are position (3,) and attitude (3, 3) of the camera
        at the one that is. The walk moves a landmark across its line of sight there.
        """
        if not self.declared or not len(prior.points):
            return prior
        end, first, count = self.since, len(prior.views), len(prior.points)
        began = [min(max(self._began[track], since), end) for track in prior.points.tolist()]
        starts, points_m, ends = np.array(began), prior.origin_m[first:].copy(), np.full(count, end)
        information, gradient, origin_m = prior.information, prior.gradient, prior.origin_m
        if self.field_m:
            # p = p' - D a: another set of variables, of the same cost.
            moved = self._moved(points_m, starts, ends)
            field = int(np.flatnonzero(prior.views == FIELD)[0])
            T = np.eye(len(gradient))
            T[3 * first :, 3 * field : 3 * field + 3] = -moved.reshape(-1, 3)
            information, gradient = T.T @ information @ T, T.T @ gradient
            origin_m = origin_m.copy()
            origin_m[first:] += moved @ prior.origin_m[field]
        position_m, R_cam_body = at
        walked = np.array(self._walk_px2)
        spread = np.sqrt(np.maximum(walked[end] - walked[starts], 0.0))
        J = camera.jacobian((origin_m[first:] - position_m) @ R_cam_body.T) @ R_cam_body
        # The smallest displacement that moves the pixel by one step.
        across = np.swapaxes(np.linalg.solve(J @ np.swapaxes(J, 1, 2), J), 1, 2) * spread[:, None, None]
        E = np.zeros((len(gradient), 2 * count))
        for k in range(count):
            E[3 * (first + k) : 3 * (first + k) + 3, 2 * k : 2 * k + 2] = across[k]
        # x' = x + E w, w of unit variance and eliminated: H' = H - H E (I + E' H E)^-1 E' H.
        HE = information @ E
        gain = np.linalg.solve(np.eye(2 * count) + E.T @ HE, HE.T)
        information = information - HE @ gain
        gradient = gradient - gain.T @ (E.T @ gradient)
        return replace(prior, origin_m=origin_m, information=0.5 * (information + information.T), gradient=gradient)
