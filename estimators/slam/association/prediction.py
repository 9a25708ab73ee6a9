"""Predict the pixels of landmarks in the next frame with their covariance, for guided matching and for gating.

Landmarks are those of the last adjustment, and those seen once, at a guessed distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Adjustment, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap, lookup
from boresight.estimators.slam.adjustment.solver import kept_covariance
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.observation import Prediction, TrackFrame

DEPTH_SIGMA = 0.3
"""Standard deviation of a guessed distance, relative, for gating."""

_UNKNOWN_DEPTH = 0.15  # standard deviation of the distance of a landmark seen once, relative, for guided matching


def predict_from_window(
    slam_map: SlamMap, view: int, frame: TrackFrame, solved: AdjustedWindow | None
) -> Prediction | None:
    """Predict the pixels of all landmarks of the last ``view`` in the frame after it, from the last adjustment.

    Landmarks that are not adjusted are at the median depth on their lines of sight; before the first adjustment all
    are, and the position is certain. None if the covariance does not exist.
    """
    seen = np.sort(slam_map.frames[view].tracks)
    here, depth_m = slam_map.positions_m[view], slam_map.median_depth(view)
    # The landmarks that are not adjusted, relative to the camera that saw them.
    rays = np.array([slam_map.ray(view, track) for track in seen.tolist()])
    points_m, known = here + depth_m * rays, np.zeros(len(seen), dtype=np.bool_)
    # Joint covariance of camera and landmarks, and the derivatives of landmark minus camera by its variables.
    covariance, by_joint, own_view = np.zeros((3, 3)), np.zeros((len(seen), 3, 3)), slice(0, 3)
    if solved is not None:
        # All landmarks are kept, for their correlations with the view and with each other.
        whole = replace(solved.problem, kept_points=np.ones(len(solved.tracks), dtype=np.bool_))
        try:
            covariance, views, slots = kept_covariance(whole, solved.state)
        except np.linalg.LinAlgError:
            return None
        rows = lookup(solved.tracks, seen)
        newest = 3 * views[len(solved.views) - 1]
        known, own_view = rows >= 0, slice(newest, newest + 3)
        by_joint = np.zeros((len(seen), 3, len(covariance)))
        for k in np.flatnonzero(known).tolist():
            points_m[k] = slam_map.points_m[int(seen[k])]
            by_joint[k, :, own_view] = -np.eye(3)
            by_joint[k, :, 3 * slots[rows[k]] : 3 * slots[rows[k]] + 3] = np.eye(3)
    lines_cam_m = (points_m - (here + frame.motion_m)) @ frame.R_cam_body.T
    by_line = slam_map.camera.jacobian(lines_cam_m) @ frame.R_cam_body
    rows_by_joint = (by_line @ by_joint).reshape(2 * len(seen), -1)
    # The new camera is the old one plus the motion, so the motion's error has the sign of the camera's.
    by_motion = -by_line.reshape(2 * len(seen), 3)
    # First order: the joint error of camera and landmarks, and that of the motion, which is independent of it.
    spread = rows_by_joint @ covariance @ rows_by_joint.T + by_motion @ frame.motion_covariance_m2 @ by_motion.T
    # A guessed distance is uncertain along the line of sight; the pixel's error across it is left out. A pixel depends
    # on the camera's displacement over the distance: the product of both errors is of second order.
    guess = depth_m**2 * rays[:, :, None] * rays[:, None, :]
    guess += covariance[own_view, own_view] + frame.motion_covariance_m2
    alone = _UNKNOWN_DEPTH**2 * by_line @ guess @ np.swapaxes(by_line, 1, 2)
    guessed = np.flatnonzero(~known)
    spread.reshape(len(seen), 2, len(seen), 2)[guessed, :, guessed] += alone[guessed]
    return Prediction(seen, slam_map.camera.project(lines_cam_m), spread)


@dataclass(frozen=True, slots=True, eq=False)
class PredictedLines:
    """Predicted lines of sight from the new camera to the landmarks in the rows (n,) of its frame.

    ``lines_m`` (n, 3) are landmark minus camera, body axes, and ``by_shared`` (n, 3, m) their derivatives by the shared
    variables: those of the adjustment's reduced system, and the last motion, with ``covariance`` (m, m). ``own_m2``
    (n, 3, 3) is the covariance of the independent error of each line. Landmarks that are ``known`` (n,) are mapped; the
    others have a guessed distance.
    """

    rows: IndexArray
    lines_m: FloatArray
    by_shared: FloatArray
    covariance: FloatArray
    own_m2: FloatArray
    known: BoolArray

    def subset(self, which: BoolArray) -> PredictedLines:
        """Return those marked in ``which`` (n,)."""
        part = self.rows[which], self.lines_m[which], self.by_shared[which]
        return PredictedLines(*part, self.covariance, self.own_m2[which], self.known[which])


@dataclass(frozen=True, slots=True, eq=False)
class SharedUncertainty:
    """Joint covariance of the shared variables: free views, landmarks of the prior, and the motion to the new frame.

    The motion has the last three columns of ``covariance`` (m, m). ``views``, by frame number, and ``points`` have the
    first column of each free view and of each landmark of the prior.
    """

    covariance: FloatArray
    views: dict[int, int]
    points: dict[int, int]

    @classmethod
    def of(
        cls, adjusted: tuple[Adjustment, State] | None, views: Sequence[int], motion_covariance_m2: FloatArray
    ) -> SharedUncertainty:
        """Combine the covariance of an adjustment with that of the motion after it.

        Raise LinAlgError if the adjustment is not determined.
        """
        if adjusted is None:
            return cls(motion_covariance_m2.copy(), {}, {})
        # The motion after the adjustment is independent of it: block-diagonal.
        # Derivatives at the state, as in `line_information`, so that both describe one linearisation.
        before, view_slots, point_slots = kept_covariance(replace(adjusted[0], frozen=None), adjusted[1])
        size = len(before)
        covariance = np.zeros((size + 3, size + 3))
        covariance[:size, :size] = before
        covariance[size:, size:] = motion_covariance_m2
        # Common errors, which have the slot after those of the views, are left out: they move a pixel little.
        free = {view: 3 * slot for view, slot in zip(views, view_slots.tolist(), strict=False) if slot >= 0}
        return cls(covariance, free, {j: 3 * slot for j, slot in enumerate(point_slots.tolist()) if slot >= 0})

    def by_camera(self, view: int) -> FloatArray:
        """(3, m) derivative of the new camera's position, the previous view's plus the motion."""
        rows = np.zeros((3, len(self.covariance)))
        rows[:, -3:] = np.eye(3)
        # x_new = x_previous + motion; both in body axes, and the rotation of the body is in the motion.
        return rows + self.by_view(view - 1)

    def by_view(self, view: int) -> FloatArray:
        """(3, m) derivative of a view's position; zero if it is not free."""
        rows = np.zeros((3, len(self.covariance)))
        if view in self.views:
            rows[:, self.views[view] : self.views[view] + 3] = np.eye(3)
        return rows

    def by_landmarks(
        self, problem: Adjustment, state: State, views: Sequence[int], points: IndexArray
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 3, m) derivatives of landmarks, and (n, 3, 3) covariance of the independent error of each, m^2.

        An eliminated landmark follows from its views: ``p = sum_v V^-1 W_v x_v`` plus an error of covariance ``V^-1``,
        where ``W_v`` is the information of view v about its line of sight, and V is their sum.
        """
        rows, own = np.zeros((len(points), 3, len(self.covariance))), np.zeros((len(points), 3, 3))
        kept = np.array([j in self.points for j in points.tolist()], dtype=np.bool_)
        for k in np.flatnonzero(kept).tolist():
            column = self.points[int(points[k])]
            rows[k, :, column : column + 3] = np.eye(3)
        # The back-substitution of the adjustment: given the views, an eliminated landmark has covariance V^-1,
        # independent of their error.
        information = line_information(problem, state, points[~kept])
        own[~kept] = np.linalg.inv(information.sum(axis=1))
        weights = own[~kept][:, None] @ information
        for slot, view in enumerate(views):
            if view in self.views:
                rows[~kept, :, self.views[view] : self.views[view] + 3] = weights[:, slot]
        return rows, own


def line_information(problem: Adjustment, state: State, points: IndexArray) -> FloatArray:
    """(n, V, 3, 3) information of each view about its line of sight to each of some landmarks, 1/m^2."""
    place = np.full(len(state.points_m), -1, dtype=np.int64)
    place[points] = np.arange(len(points))
    seen = problem.pixels.subset(place[problem.pixels.point] >= 0)
    ranged = problem.distances.subset(place[problem.distances.point] >= 0)
    # Derivatives of pixels and distances, in standard deviations, by the landmark.
    turn = problem.R_cam_body[seen.view]
    lines = np.einsum("kij,kj->ki", turn, state.points_m[seen.point] - state.positions_m[seen.view])
    by_pixel = problem.camera.jacobian(lines) @ turn / seen.whole_sigma_px[:, None, None]
    lines = state.points_m[ranged.point] - state.positions_m[ranged.view]
    by_range = (lines / (np.linalg.norm(lines, axis=1) * ranged.sigma_m)[:, None])[:, None, :]
    information = np.zeros((len(points), len(state.positions_m), 3, 3))
    # add.at, because a view may have both a pixel and a distance to a landmark.
    np.add.at(information, (place[seen.point], seen.view), np.swapaxes(by_pixel, 1, 2) @ by_pixel)
    np.add.at(information, (place[ranged.point], ranged.view), np.swapaxes(by_range, 1, 2) @ by_range)
    return information


@dataclass(frozen=True, slots=True, eq=False)
class FrameMatches:
    """Tracks of a new frame matched with the map; its camera position is that of the motion-only adjustment.

    ``points`` (n,) is for each of its tracks the landmark of the last adjustment, or -1. ``once`` has the rows of
    tracks that were seen before but are not mapped, and (view, track) of the last such pixel; ``depth_m`` is their
    guessed distance.
    """

    view: int
    points: IndexArray
    once: tuple[IndexArray, list[tuple[int, int]]]
    depth_m: float


def predict_lines(slam_map: SlamMap, matches: FrameMatches, before: AdjustedWindow | None) -> PredictedLines:
    """Predict the lines of sight from a new frame to its matched landmarks, with their covariance.

    First those of the last adjustment, then those seen once, at their measured or guessed distance.
    """
    view, frame = matches.view, slam_map.frames[matches.view]
    # From the predicted position, not from the motion-only adjustment: that one used the pixels that are to be tested.
    at = slam_map.positions_m[view - 1] + frame.motion_m
    adjusted, views = (None, ()) if before is None else ((before.problem, before.state), before.views)
    common = SharedUncertainty.of(adjusted, views, frame.motion_covariance_m2)
    by_camera = common.by_camera(view)
    rows, single_pixels = matches.once
    points, own = guessed_points(slam_map, single_pixels, matches.depth_m)
    # The landmark moves with the view that saw it: only the displacement since then is uncertain.
    by_shared = np.array([common.by_view(other) - by_camera for other, _ in single_pixels])
    by_shared = by_shared.reshape(len(rows), 3, len(common.covariance))
    known = np.zeros(len(rows), dtype=np.bool_)
    if before is not None:
        mapped = np.flatnonzero(matches.points >= 0)
        chosen = matches.points[mapped]
        by_landmark, independent = common.by_landmarks(before.problem, before.state, before.views, chosen)
        rows = np.concatenate([mapped, rows])
        points = np.concatenate([before.state.points_m[chosen], points])
        # Line of sight = landmark - camera. An error common to both, such as the drift of all views, cancels here.
        by_shared = np.concatenate([by_landmark - by_camera, by_shared])
        own = np.concatenate([independent, own])
        known = np.arange(len(rows)) < len(mapped)
    return PredictedLines(rows, points - at, by_shared, common.covariance, own, known)


def guessed_points(
    slam_map: SlamMap, single_pixels: Sequence[tuple[int, int]], depth_m: float
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) landmarks by their single pixels (view, track), and (n, 3, 3) covariance relative to that view, m^2.

    The standard deviation across the line of sight is that of the pixel; along it, 30 % of the guessed distance or the
    error of the measured one.
    """
    n = len(single_pixels)
    depths, sigmas = np.full(n, depth_m), np.full(n, DEPTH_SIGMA * depth_m)
    for k, (other, track) in enumerate(single_pixels):
        for item in slam_map.frames[other].ranges:
            if item.track == track:
                depths[k], sigmas[k] = item.range_m, item.sigma_m
    rays = np.array([slam_map.ray(other, track) for other, track in single_pixels]).reshape(n, 3)
    # A pixel's sigma as an angle times the distance, m.
    noise = np.array([slam_map.frames[other].sigma_px for other, _ in single_pixels]) / slam_map.camera.fx_px * depths
    # Projectors along each line of sight, d d', and across it, I - d d'.
    along = rays[:, :, None] * rays[:, None, :]
    own = (sigmas**2)[:, None, None] * along + (noise**2)[:, None, None] * (np.eye(3) - along)
    anchors = np.array([slam_map.positions_m[other] for other, _ in single_pixels]).reshape(n, 3)
    return anchors + depths[:, None] * rays, own
