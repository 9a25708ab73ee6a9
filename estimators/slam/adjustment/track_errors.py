"""Errors of pixels that add up along a track, in an adjustment of views: a random walk, and errors common to all.

From frame to frame a pixel at p takes a random step of its own, and the common step ``d - c (p - p0)`` (`TrackFrame`).
The walk counts from the `branch`: the frame in which the track, or the one that it goes on, began, or the oldest frame
of the window; it is eliminated with the landmark, and what a window hands to the next one is about the landmark at the
new oldest frame. The common errors count from the beginning of the track. They are linear in c and d, by the sum of all
pixels of the track so far. A track that is recognised begins with what its landmark has (`TrackErrors.resume`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from boresight.estimators.slam.adjustment.problem import (
    NO_PRIOR,
    AddedErrors,
    Adjustment,
    PixelMeasurements,
    QuadraticPrior,
)
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera, angle_between
from boresight.scenarios.observation import TrackFrame

COMMON = 2**60
"""Number of the view that stands for the common errors: after those of all frames."""


def common_steps(camera: Camera, frame: TrackFrame) -> FloatArray:
    """(n, 2, 3) derivatives of the steps of a frame's pixels by (c, d_u, d_v), each over its standard deviation, px."""
    steps = np.zeros((len(frame.tracks), 2, 3))
    steps[:, :, 0] = frame.contraction * ([camera.cx_px, camera.cy_px] - frame.uv_px)
    steps[:, [0, 1], [1, 2]] = frame.drift_px
    return steps


class TrackErrors:
    """What the frames so far declare of such errors, and the frames in which their tracks began.

    ``since`` is the oldest frame of the window. The unknowns of the common errors are ``(c, d_u, d_v)``, each over its
    standard deviation, times ``common_m``, so that they are lengths as all others are. Zero: none are declared.
    """

    def __init__(self, camera: Camera) -> None:
        self.since = 0
        self.common_m = 0.0
        self._camera = camera
        self._began: dict[int, int] = {}
        # Of each frame: the sum of the variances of the steps so far, and (2, 3) derivatives by track.
        self._walk_px2: list[float] = []
        self._moved: list[dict[int, FloatArray]] = []
        self._last: dict[int, int] = {}
        # Boresights, body frame, and the sum of their turns from frame to frame. Of recognised tracks the first frame
        # of the landmark with the axis about which the view turned on, and the variance with which it was found anew.
        self._boresights: list[FloatArray] = []
        self._turned_rad = 0.0
        self._first: dict[int, tuple[int, FloatArray]] = {}
        self._found_px2: dict[int, float] = {}

    def add(self, frame: TrackFrame) -> None:
        """Add the next frame."""
        number = len(self._walk_px2)
        self._boresights.append(frame.R_cam_body[2])
        if number:
            self._turned_rad += angle_between(*self._boresights[-2:])
        self._walk_px2.append(frame.walk_px**2 + (self._walk_px2[-1] if number else 0.0))
        if not number:
            angle_rad = math.hypot(frame.contraction, frame.drift_px / self._camera.fx_px)
            ranges_m = [item.range_m for item in frame.ranges] or [1.0]
            self.common_m = angle_rad * float(np.mean(ranges_m))
        tracks = frame.tracks.tolist()
        here = dict.fromkeys(tracks, np.zeros((2, 3)))  # a track begins without error
        steps = common_steps(self._camera, frame) / self.common_m if self.common_m else ()
        for track, step in zip(tracks, steps, strict=False):
            if track in self._last:
                here[track] = self._moved[self._last[track]][track] + step
        self._moved.append(here)
        self._last.update(dict.fromkeys(tracks, number))
        for track in tracks:
            self._began.setdefault(track, number)

    def resume(self, frame: TrackFrame) -> None:
        """Begin the recognised tracks of the newest frame with the errors of their landmarks since the first sighting.

        On real tracks errors follow the view, which the boresight tells here. While it turns on, a track that comes
        back goes on. Where the view comes back too, as after a revolution, the landmark is found anew, with the errors
        of the turn from its first view to this one, in frames of mean turn; turned back, the common ones have the other
        sign.
        """
        number = len(self._walk_px2) - 1
        if not self.declared or not number or not len(frame.again):
            return
        steps = common_steps(self._camera, frame) / (self.common_m or 1.0)
        rows = {track: row for row, track in enumerate(frame.tracks.tolist())}
        views = np.array(self._boresights)
        for new, old in frame.again.tolist():
            if new not in rows or old not in self._last or self._began[new] != number:
                continue
            last, began = self._last[old], self._began[old]
            first, onward = self._first.setdefault(old, (began, np.cross(views[began], views[last])))
            self._first[new] = first, onward
            away = np.arcsin(np.minimum(np.linalg.norm(views[began:] - views[began], axis=1) / 2.0, 1.0))  # half angles
            if 2.0 * away[-1] >= away.max():
                self._began[new], self._found_px2[new] = began, self._found_px2.get(old, 0.0)
                self._moved[number][new] = self._moved[last][old] + (number - last) * steps[rows[new]]
            else:
                turned = angle_between(views[first], views[number]) * number / self._turned_rad
                self._found_px2[new] = turned * frame.walk_px**2
                ahead = np.cross(views[first], views[number]) @ onward >= 0.0
                self._moved[number][new] = (turned if ahead else -turned) * steps[rows[new]]

    @property
    def declared(self) -> bool:
        """Whether there are any."""
        return self.common_m > 0.0 or sum(self._walk_px2[-1:]) > 0.0

    def branch(self, track: int) -> int:
        """Return the frame from which the walk of a track counts."""
        return max(self._began[track], self.since)

    def walk_px2(self, view: int, tracks: Sequence[int]) -> FloatArray:
        """(n,) variance of the walk of each track at a frame, px^2."""
        if not self.declared:
            return np.zeros(len(tracks))
        walked = self._walk_px2
        return np.array([walked[view] - walked[self.branch(track)] for track in tracks], dtype=np.float64)

    def moved(self, view: int, tracks: Sequence[int]) -> FloatArray:
        """(n, 2, 3) derivatives of the pixels of tracks at a frame by the unknowns of the common errors, px/m."""
        if not self.common_m:
            return np.zeros((len(tracks), 2, 3))
        return np.array([self._moved[view][track] for track in tracks]).reshape(-1, 2, 3)

    def views(self, views: Sequence[int]) -> list[int]:
        """Return views, and the one of the common errors if there are any."""
        return [*views, COMMON] if self.common_m else [*views]

    def prior(self, prior: QuadraticPrior | None) -> QuadraticPrior | None:
        """Return a prior without landmarks and that of the common errors."""
        if not self.common_m:
            return prior
        given = NO_PRIOR if prior is None else prior
        origin_m, information = np.append(given.origin_m, np.zeros((1, 3)), axis=0), np.eye(3) / self.common_m**2
        return QuadraticPrior(
            np.append(given.views, COMMON),
            given.points,
            origin_m,
            np.asarray(block_diag(given.information, information), dtype=np.float64),
            np.append(given.gradient, np.zeros(3)),
        )

    def extended(
        self,
        problem: Adjustment,
        views: Sequence[int],
        tracks: Sequence[int],
        merged: Mapping[int, Set[int]] | None = None,
    ) -> Adjustment:
        """Return the adjustment of ``views`` and ``tracks`` with these errors; the common ones are its last view.

        In a map of all frames ``merged`` has the tracks of landmarks with more than one.
        """
        if not self.declared:
            return problem
        seen = problem.pixels.subset(np.lexsort((problem.pixels.view, problem.pixels.point)))
        members = [(merged or {}).get(track, {track}) for track in tracks]
        here = np.array(views, dtype=np.int64)[seen.view]
        at = list(zip(here.tolist(), seen.point.tolist(), strict=True))
        own = [next(track for track in members[j] if track in self._moved[view]) for view, j in at]
        branch = [self.branch(track) if merged is None else self._began[track] for track in own]
        walked, moved = np.array(self._walk_px2), np.zeros((0, 2, 3))
        if self.common_m:
            moved = np.array([self._moved[view][track] for (view, _), track in zip(at, own, strict=True)])
            moved = moved.reshape(-1, 2, 3)
            still = np.concatenate([problem.R_cam_body, np.eye(3)[None]])
            problem = replace(problem, R_cam_body=still, free_views=np.append(problem.free_views, True))
        start = np.array(branch, dtype=np.int64)
        walk_px2 = walked[here] - walked[start]
        if merged is not None:  # alone in a window, a landmark has this error itself
            walk_px2 += [self._found_px2.get(track, 0.0) for track in own]
        return replace(problem, pixels=replace(seen, added=AddedErrors(start, walk_px2, moved)))

    def backwards(
        self, pixels: PixelMeasurements, frames: IndexArray, goes_on: Sequence[int], stays: BoolArray
    ) -> tuple[PixelMeasurements, BoolArray]:
        """Return pixels (k,) with errors about their landmarks at the oldest frame, and which share a walk with it.

        ``frames`` (k,) are theirs, ``goes_on`` (k,) the tracks of their landmarks in the window, and ``stays`` (k,)
        whether these stay in it; other pixels are returned as they are. What another track has gathered before is
        added to by what this one had when it was found, and since then.
        """
        if pixels.added is None:
            return pixels, np.zeros(len(frames), dtype=np.bool_)
        walked, since = np.array(self._walk_px2), self.since
        began = np.array([self._began[track] for track in goes_on], dtype=np.int64)
        shared = stays & (pixels.added.branch == began)
        since_found = walked[since] - walked[np.minimum(began, since)]
        since_found += [self._found_px2.get(track, 0.0) for track in goes_on]
        walk_px2 = pixels.added.walk_px2 + stays * since_found
        walk_px2[shared] = np.abs(walked[since] - walked[frames[shared]])
        return replace(pixels, added=replace(pixels.added, walk_px2=walk_px2)), shared

    def carried(
        self, prior: QuadraticPrior, since: int, camera: Camera, at: tuple[FloatArray, FloatArray]
    ) -> QuadraticPrior:
        """Return a prior of landmarks before the oldest frame, by their tracks, as one at that frame.

        ``since`` is the frame that was the oldest before; ``at`` are position (3,) and attitude (3, 3) of the camera
        at the one that is. The walk moves a landmark across its line of sight there.
        """
        walked, end = np.array(self._walk_px2), self.since
        if not walked.any() or not len(prior.points):
            return prior
        first, count = len(prior.views), len(prior.points)
        began = [min(max(self._began[track], since), end) for track in prior.points.tolist()]
        position_m, R_cam_body = at
        spread = np.sqrt(np.maximum(walked[end] - walked[began], 0.0))
        J = camera.jacobian((prior.origin_m[first:] - position_m) @ R_cam_body.T) @ R_cam_body
        # The smallest displacement that moves the pixel by one step.
        across = np.swapaxes(np.linalg.solve(J @ np.swapaxes(J, 1, 2), J), 1, 2) * spread[:, None, None]
        E = np.zeros((len(prior.gradient), 2 * count))
        for k in range(count):
            E[3 * (first + k) : 3 * (first + k) + 3, 2 * k : 2 * k + 2] = across[k]
        # x' = x + E w, w of unit variance and eliminated: H' = H - H E (I + E' H E)^-1 E' H.
        HE = prior.information @ E
        gain = np.linalg.solve(np.eye(2 * count) + E.T @ HE, HE.T)
        information = prior.information - HE @ gain
        gradient = prior.gradient - gain.T @ (E.T @ prior.gradient)
        return replace(prior, information=0.5 * (information + information.T), gradient=gradient)
