"""Outlier rejection in a window of views: wrong associations of pixels with landmarks.

Each pixel is tested twice: in a new frame, against its prediction by the map and the predicted motion, before any
adjustment uses it; and after each adjustment, while its view is in the window, by its residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Adjustment, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap, lookup
from boresight.estimators.slam.adjustment.solver import StoppingRule
from boresight.estimators.slam.association.gating import gate_frame, pixel_squares
from boresight.estimators.slam.association.prediction import (
    FrameMatches,
    guessed_points,
    line_information,
    predict_lines,
)
from boresight.estimators.slam.options import OutlierOptions
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.observation import TrackFrame

_MAX_ROUNDS = 5
"""Adjustments of a frame at most, each without the outliers that the previous one found."""

_MAX_GATED_VARIABLES = 1500
"""Size of the reduced system up to which its covariance is computed; beyond, pixels are tested by residuals only."""

_FRAMES_BACK = 5
"""Previous frames in which the last pixel of an unmapped track is looked for."""

_REFUSALS_IN_A_ROW = 2
"""Consecutive refusals after which the older pixels of a landmark are doubted instead."""

_DEPTH_RATIO = 3.0
"""Largest ratio of a landmark's distance to the median one, or of the median one to it."""

_READMIT_SHARE = 0.5
"""Part of the chi-square limit below which a refused pixel is readmitted."""

_LEAST_MAPPED = 8
"""Mapped landmarks below which a single wrong one may displace the camera."""


def all_within_gate(slam_map: SlamMap, matches: FrameMatches, before: tuple[Adjustment, State], limit: float) -> bool:
    """Return whether every pixel is within the chi-square ``limit``; False if the map is too small.

    A fast test: the landmarks' covariances are used only where a pixel fails without them.
    """
    rows = np.flatnonzero(matches.points >= 0)
    # The camera was placed by these pixels: with few of them a wrong one would displace it until it fits.
    if len(rows) < _LEAST_MAPPED:
        return False
    problem, state = before
    frame = slam_map.frames[matches.view]
    points = matches.points[rows]
    lines_m = state.points_m[points] - slam_map.positions_m[matches.view]
    # Without the landmarks' covariances the test is too strict, never too lenient: what passes here passes with them.
    noise_px2 = slam_map.noise_px2(matches.view, rows)
    squares = pixel_squares(slam_map.camera, frame, rows, lines_m, np.zeros((len(rows), 3, 3)), noise_px2)
    # NaN, a landmark behind the camera, counts as odd.
    odd = np.flatnonzero(~(squares <= limit))
    if len(odd):
        # The information of pixels and distances alone underestimates what is known of a landmark of the prior.
        if 2 * len(odd) > len(rows) or np.isin(points[odd], problem.prior_points).any():
            return False
        own = np.asarray(np.linalg.inv(line_information(problem, state, points[odd]).sum(axis=1)), dtype=np.float64)
        squares = pixel_squares(slam_map.camera, frame, rows[odd], lines_m[odd], own, noise_px2[odd])
        if not (squares <= limit).all():
            return False
    once, single_pixels = matches.once
    if not len(once):
        return True
    guessed, own = guessed_points(slam_map, single_pixels, matches.depth_m)
    noise_px2 = slam_map.noise_px2(matches.view, once)
    squares = pixel_squares(slam_map.camera, frame, once, guessed - slam_map.positions_m[matches.view], own, noise_px2)
    return bool((squares <= limit).all())


def residual_squares(problem: Adjustment, state: State) -> FloatArray:
    """(k,) squared pixel residuals in standard deviations; NaN where a landmark is behind its camera."""
    seen = problem.pixels
    lines = state.points_m[seen.point] - state.positions_m[seen.view]
    predicted_px = problem.camera.project(np.einsum("kij,kj->ki", problem.R_cam_body[seen.view], lines))
    if seen.added is not None and len(seen.added.moved):
        predicted_px = predicted_px + seen.added.moved @ state.positions_m[-1]
    return np.asarray((((predicted_px - seen.uv_px) / seen.whole_sigma_px[:, None]) ** 2).sum(axis=1), dtype=np.float64)


class OutlierGate:
    """Outlier gate of a window: removes refused pixels from the frames of a map, and readmits those that fit again.

    It refuses none if the options say that all pixels are used. ``raw_frames`` are the frames as measured; those of the
    map lack the refused pixels. ``refused`` has the refused tracks of each view in the window, ``in_a_row`` the
    consecutive views that refused a track.
    """

    def __init__(self, slam_map: SlamMap, options: OutlierOptions) -> None:
        self.slam_map = slam_map
        self.active = slam_map.gated = options.associations == "consensus"
        self.false_alarm = options.false_alarm
        self.limit = float(chdtri(2, options.false_alarm))
        self.raw_frames: dict[int, TrackFrame] = {}
        self.refused: dict[int, set[int]] = {}
        self.in_a_row: dict[int, list[int]] = {}
        self.refused_count = 0

    def diagnostics(self) -> dict[str, float]:
        """Return how many pixels were refused, if any may be."""
        return {"refused_pixels": float(self.refused_count)} if self.active else {}

    def add_frame(self, view: int, frame: TrackFrame) -> None:
        """Add a frame with all its pixels."""
        self.raw_frames[view] = self.slam_map.frames[view] = frame

    def shared(self, first: int, second: int) -> int:
        """Count the landmarks that two frames share, refused pixels included: outliers are not lost tracks."""
        if not self.active:
            return self.slam_map.shared(first, second)
        return len(np.intersect1d(self.raw_frames[first].tracks, self.raw_frames[second].tracks, assume_unique=True))

    def drop_view(self, view: int) -> None:
        """Drop a view that left the window, and its refused pixels."""
        self.raw_frames.pop(view, None)
        self.refused.pop(view, None)

    def drop_tracks(self, view: int, tracks: set[int]) -> None:
        """Drop some tracks from a view."""
        self.raw_frames[view] = without_tracks(self.raw_frames[view], tracks)
        self._set(view, self.refused.get(view, set()) - tracks)

    def adjust(self, adjust: Callable[[], AdjustedWindow]) -> AdjustedWindow:
        """Adjust a window, repeatedly while outliers are rejected."""
        for rounds in range(_MAX_ROUNDS):
            adjusted = adjust()
            # No refusal after the last adjustment: the estimate would have used the refused pixels.
            if not self.active or rounds + 1 == _MAX_ROUNDS or not self.reject_outliers(adjusted):
                break
        return adjusted

    def place(self, view: int, before: AdjustedWindow | None, rule: StoppingRule, depth_m: float) -> None:
        """Place a new view by a motion-only adjustment and gate its pixels, with the joint covariance if necessary.

        ``depth_m`` is the median distance of the landmarks.
        """
        self.slam_map.place(view, rule)
        if not self.active:
            return
        matches = self._match_frame(view, before, depth_m)
        if before is not None and all_within_gate(self.slam_map, matches, (before.problem, before.state), self.limit):
            # No pixel refused in this frame ends all runs.
            self.in_a_row = {}
            return
        self._gate_frame(matches, before)
        # The refused pixels took part in the first placement.
        if self.refused.get(view):
            self.slam_map.place(view, rule)

    def _gate_frame(self, matches: FrameMatches, before: AdjustedWindow | None) -> None:
        """Gate a new frame by its prediction from the last adjustment and the predicted motion.

        If most pixels fail, or the adjustment has no covariance, the prediction is not reliable and all pixels pass.
        """
        view, frame = matches.view, self.raw_frames[matches.view]
        # A dense inverse costs the cube of the size.
        if before is not None:
            kept = np.count_nonzero(before.problem.free_views) + len(before.problem.prior_points)
            if 3 * kept > _MAX_GATED_VARIABLES:
                return
        try:
            seen = predict_lines(self.slam_map, matches, before)
            noise_px2 = self.slam_map.noise_px2(view, seen.rows)
            fit = gate_frame(self.slam_map.camera, frame, seen, noise_px2, self.false_alarm, self.limit)
        except np.linalg.LinAlgError:
            return
        # A majority that fails shows a wrong prediction (a wrong motion, say) rather than as many wrong pixels.
        if 2 * np.count_nonzero(fit) > len(fit):
            refused = frame.tracks[seen.rows[~fit]].tolist()
            self._refuse(view, refused)
            settled = set() if before is None else set(before.tracks[before.problem.prior_points].tolist())
            self._reinitialise(view, refused, settled)

    def reject_outliers(self, adjusted: AdjustedWindow) -> bool:
        """Refuse pixels with large residuals after an adjustment; True if it has to be repeated.

        At a time only the worst pixel of each landmark is refused, and only if it is among the worst of all: one wrong
        pixel increases the residuals of the others. Readmitted pixels are used from the next frame on.
        """
        seen = adjusted.problem.pixels
        squares = residual_squares(adjusted.problem, adjusted.state)
        for view, point in zip(adjusted.problem.distances.view, adjusted.problem.distances.point, strict=True):
            squares[(seen.view == view) & (seen.point == point)] = 0.0  # a ranged landmark must keep its pixel
        self._readmit(adjusted)
        if self._reject_implausible_depths(adjusted):
            return True
        # Residuals of an adjustment are smaller than the errors of its pixels, since the pixels took part: the limit
        # refuses fewer correct ones than its false-alarm probability.
        if squares.max(initial=0.0) <= self.limit:
            return False
        worst = np.zeros(len(adjusted.tracks))
        np.maximum.at(worst, seen.point, squares)
        # Least squares spreads a gross error over the pixels of its landmark and view: the worst first (Baarda's data
        # snooping), and with it those of other landmarks with at least half of its residual.
        out = (squares > self.limit) & (squares >= worst[seen.point]) & (squares >= 0.25 * squares.max())
        for slot, point in zip(seen.view[out].tolist(), seen.point[out].tolist(), strict=True):
            track = int(adjusted.tracks[point])
            self._refuse(adjusted.views[slot], [track])
            # The estimate was drawn by the wrong pixel: triangulate again. A landmark of the prior has to stay.
            if point not in adjusted.problem.prior_points:
                self.slam_map.points_m.pop(track, None)
        return True

    def _reject_implausible_depths(self, adjusted: AdjustedWindow) -> bool:
        """Refuse the newest pixel of landmarks at an implausible distance: two wrong pixels may have zero residuals."""
        seen, state = adjusted.problem.pixels, adjusted.state
        distances = np.sqrt(((state.points_m - state.positions_m[len(adjusted.views) - 1]) ** 2).sum(axis=1))
        # Two bearings with an error along the epipolar line still meet in a point: only its distance shows the error.
        middle = float(np.sort(distances)[len(distances) // 2])
        odd = np.flatnonzero((distances < middle / _DEPTH_RATIO) | (distances > middle * _DEPTH_RATIO)).tolist()
        odd = [point for point in odd if point not in adjusted.problem.prior_points]
        for point in odd:
            slots = seen.view[seen.point == point]
            if len(slots):
                self._refuse(adjusted.views[int(slots.max())], [int(adjusted.tracks[point])])
            self.slam_map.points_m.pop(int(adjusted.tracks[point]), None)
        return bool(odd)

    def _reinitialise(self, view: int, refused: Sequence[int], settled: set[int]) -> None:
        """Reinitialise landmarks that are refused repeatedly, since their older pixels may be the wrong ones.

        Landmarks of the prior and those with a range are left as they are.
        """
        # Built anew: a track that was not refused in this frame loses its run.
        self.in_a_row = {track: [*self.in_a_row.get(track, []), view] for track in refused}
        due = [(track, run) for track, run in self.in_a_row.items() if len(run) >= _REFUSALS_IN_A_ROW]
        ranged = {item.track for frame in self.raw_frames.values() for item in frame.ranges} if due else set()
        for track, run in due:
            if track in settled or track in ranged:
                continue
            for other, frame in self.raw_frames.items():
                # Believe the newer pixels, which agree on a refusal, instead of the older ones.
                if other in run:
                    self._set(other, self.refused.get(other, set()) - {track})
                elif np.any(frame.tracks == track):
                    self._refuse(other, [track])
            self.slam_map.points_m.pop(track, None)
            del self.in_a_row[track]

    def _match_frame(self, view: int, before: AdjustedWindow | None, depth_m: float) -> FrameMatches:
        """Match the tracks of a frame with the mapped landmarks, and with those seen before but not mapped."""
        tracks = self.raw_frames[view].tracks
        points = np.full(len(tracks), -1) if before is None else lookup(before.tracks, tracks)
        unknown = np.flatnonzero(points < 0).tolist()
        # The last of the previous views with an accepted pixel of each.
        views = [other for other in range(view - _FRAMES_BACK, view) if other in self.raw_frames] if unknown else []
        seen = {track: self.slam_map.seeing(track, views) for track in tracks[unknown].tolist()}
        last = {track: by[-1] for track, by in seen.items() if by}
        # Tracks without an accepted pixel in the last frames have no prediction, and are not gated.
        once = [row for row in unknown if int(tracks[row]) in last]
        single_pixels = [(last[int(tracks[row])], int(tracks[row])) for row in once]
        return FrameMatches(view, points, (np.array(once, dtype=np.int64), single_pixels), depth_m)

    def _refuse(self, view: int, tracks: Sequence[int]) -> None:
        if not tracks:
            return
        self.refused_count += len(tracks)
        self._set(view, self.refused.get(view, set()) | set(tracks))

    def _set(self, view: int, refused: set[int]) -> None:
        self.refused[view] = refused
        self.slam_map.frames[view] = without_tracks(self.raw_frames[view], refused)

    def _readmit(self, adjusted: AdjustedWindow) -> None:
        """Readmit refused pixels of the window that fit their landmark, which was adjusted without them."""
        if not any(self.refused.values()):
            return
        points_m = dict(zip(adjusted.tracks.tolist(), adjusted.state.points_m, strict=True))
        for view, position_m in zip(adjusted.views, adjusted.state.positions_m, strict=False):
            frame, again = self.raw_frames[view], set()
            for track in self.refused.get(view, set()) & points_m.keys():
                uv_px = frame.uv_px[np.flatnonzero(frame.tracks == track)[0]]
                predicted_px = self.slam_map.camera.project(frame.R_cam_body @ (points_m[track] - position_m))
                # Common errors, if there are any, are the last of the positions.
                predicted_px += self.slam_map.errors.moved(view, [track])[0] @ adjusted.state.positions_m[-1]
                # The landmark was adjusted without this pixel, so that its error is part of the difference; the lower
                # limit also keeps a pixel from being refused and readmitted in turn.
                walked_px = np.sqrt(self.slam_map.errors.walk_px2(view, [track])[0])
                off = (uv_px - predicted_px) / np.hypot(frame.sigma_px, walked_px)
                if off @ off < _READMIT_SHARE * self.limit:
                    again.add(track)
            if again:
                self._set(view, self.refused[view] - again)


def without_tracks(frame: TrackFrame, tracks: set[int]) -> TrackFrame:
    """Return a frame without some tracks and their ranges."""
    kept = ~np.isin(frame.tracks, np.array(sorted(tracks), dtype=np.int64))
    ranges = tuple(item for item in frame.ranges if item.track not in tracks)
    return replace(frame, tracks=frame.tracks[kept], uv_px=frame.uv_px[kept], ranges=ranges)
