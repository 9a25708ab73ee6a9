"""Predict the pixels of landmarks in the next frame with their covariance, for guided matching and for gating.

Landmarks are those of the last adjustment, and those seen once, at a guessed distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from boresight.estimators.slam.adjustment.problem import AdjustedWindow, Adjustment, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import reduced_system
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.tracks import Prediction, TrackFrame

DEPTH_SIGMA = 0.3
"""Standard deviation of a guessed distance, relative, for gating."""

_UNKNOWN_DEPTH = 0.15  # standard deviation of the distance of a landmark seen once, relative, for guided matching


def joint_covariance(problem: Adjustment, state: State, view: int, points: NDArray[np.int64]) -> FloatArray:
    """(3 + 3 n, 3 + 3 n) joint covariance of a free view's position and of n landmarks, m^2.

    It is marginal over all other variables.

    Raises
    ------
    LinAlgError
        If the normal matrix is singular.
    """
    # All landmarks stay in the reduced system, so that its inverse has their correlations with the view and with each
    # other.
    whole = replace(problem, kept_points=np.ones(len(state.points_m), dtype=np.bool_))
    matrix, _, view_slots, point_slots = reduced_system(whole, state)
    slots = np.concatenate([[view_slots[view]], point_slots[points]])
    # Rows of the inverse are marginal: those of all other variables are left out.
    rows = (3 * slots[:, None] + np.arange(3)).ravel()
    return np.asarray(np.linalg.inv(matrix)[np.ix_(rows, rows)], dtype=np.float64)


def predict_from_window(
    slam_map: SlamMap, view: int, frame: TrackFrame, solved: AdjustedWindow | None
) -> Prediction | None:
    """Predict from the last adjustment, whose last view is ``view``, and its landmarks.

    Before the first adjustment the position is certain, and all landmarks are at a guessed distance. None if the
    covariance does not exist.
    """
    if solved is None:
        # Landmarks relative to a known position: only their distances and the motion are uncertain.
        return predict_pixels(slam_map, view, frame, (), np.zeros((3, 3)))
    state, tracks = solved.state, solved.tracks
    rows = np.flatnonzero(np.isin(tracks, slam_map.frames[view].tracks))
    try:
        covariance = joint_covariance(solved.problem, state, len(state.positions_m) - 1, rows)
    except np.linalg.LinAlgError:
        return None
    return predict_pixels(slam_map, view, frame, tracks[rows].tolist(), covariance)


def predict_pixels(
    slam_map: SlamMap, view: int, frame: TrackFrame, tracks: Sequence[int], covariance: FloatArray
) -> Prediction:
    """Predict the pixels of all landmarks of a view in the frame after it.

    Parameters
    ----------
    view
        The last view.
    tracks
        The landmarks in ``covariance``; the others are at the median depth on their lines of sight.
    covariance
        (3 + 3 t, 3 + 3 t) of the view's position, then of those landmarks, m^2.
    """
    seen = np.sort(slam_map.frames[view].tracks)
    depth = slam_map.median_depth(view)
    place = {track: slot for slot, track in enumerate(tracks)}
    here = slam_map.positions_m[view]
    camera = here + frame.motion_m
    # Derivatives of landmark minus camera by the variables of the covariance, and each landmark's independent error.
    by_known = np.zeros((len(seen), 3, len(covariance)))
    own = np.zeros((len(seen), 3, 3))
    points = np.empty((len(seen), 3))
    for row, track in enumerate(seen.tolist()):
        # Line of sight = landmark - camera.
        by_known[row, :, :3] = -np.eye(3)
        if track in place:
            points[row] = slam_map.points_m[track]
            by_known[row, :, 3 + 3 * place[track] : 6 + 3 * place[track]] = np.eye(3)
        else:
            ray = slam_map.ray(view, track)
            points[row] = here + depth * ray
            by_known[row, :, :3] = 0.0  # placed relative to the camera that saw it
            # Uncertain along the line of sight; the pixel's error across it is left out.
            own[row] = (_UNKNOWN_DEPTH * depth) ** 2 * np.outer(ray, ray)
    by_line = slam_map.camera.jacobian((points - camera) @ frame.R_cam_body.T) @ frame.R_cam_body
    rows = (by_line @ by_known).reshape(2 * len(seen), -1)
    # The new camera is the old one plus the motion, so the motion's error has the sign of the camera's.
    by_motion = -by_line.reshape(2 * len(seen), 3)
    # First order: the joint error of camera and landmarks, and that of the motion, which is independent of it.
    spread = rows @ covariance @ rows.T + by_motion @ frame.motion_covariance_m2 @ by_motion.T
    # A pixel depends on the camera's displacement over the distance; the product of both errors is of second order.
    alone = by_line @ own @ np.swapaxes(by_line, 1, 2)
    product = by_line @ (covariance[:3, :3] + frame.motion_covariance_m2) @ np.swapaxes(by_line, 1, 2)
    alone += _UNKNOWN_DEPTH**2 * np.array([track not in place for track in seen.tolist()])[:, None, None] * product
    for row, block in enumerate(alone):
        spread[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += block
    uv = slam_map.camera.project((points - camera) @ frame.R_cam_body.T)
    return Prediction(seen, uv, spread)


@dataclass(frozen=True, slots=True, eq=False)
class PredictedLines:
    """Predicted lines of sight from the new camera to the landmarks of its frame.

    Parameters
    ----------
    rows
        (n,) of the frame.
    lines_m
        (n, 3) landmark minus camera, body axes.
    by_shared
        (n, 3, m) derivative of a line by the shared variables.
    covariance
        (m, m) of the shared variables: those of the adjustment's reduced system, and the last motion.
    own_m2
        (n, 3, 3) covariance of the independent error of each line.
    known
        (n,): mapped; the others have a guessed distance.
    """

    rows: IndexArray
    lines_m: FloatArray
    by_shared: FloatArray
    covariance: FloatArray
    own_m2: FloatArray
    known: BoolArray

    def subset(self, which: BoolArray) -> PredictedLines:
        """Return those marked in ``which`` (n,)."""
        return PredictedLines(
            self.rows[which],
            self.lines_m[which],
            self.by_shared[which],
            self.covariance,
            self.own_m2[which],
            self.known[which],
        )

    def joined(self, other: PredictedLines) -> PredictedLines:
        """Append lines with the same shared variables."""
        return PredictedLines(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.lines_m, other.lines_m]),
            np.concatenate([self.by_shared, other.by_shared]),
            self.covariance,
            np.concatenate([self.own_m2, other.own_m2]),
            np.concatenate([self.known, other.known]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class SharedUncertainty:
    """Joint covariance of the shared variables: free views, landmarks of the prior, and the motion to the new frame.

    Parameters
    ----------
    covariance
        (m, m); the motion has the last three columns.
    views, points
        First column of each free view, by frame number, and of each landmark of the prior.
    """

    covariance: FloatArray
    views: dict[int, int]
    points: dict[int, int]

    @classmethod
    def of(
        cls, adjusted: tuple[Adjustment, State] | None, views: Sequence[int], motion_covariance_m2: FloatArray
    ) -> SharedUncertainty:
        """Combine the covariance of an adjustment with that of the motion after it.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the adjustment is not determined.
        """
        if adjusted is None:
            return cls(motion_covariance_m2.copy(), {}, {})
        # The motion after the adjustment is independent of it: block-diagonal.
        before, view_slots, point_slots = kept_covariance(*adjusted)
        size = len(before)
        covariance = np.zeros((size + 3, size + 3))
        covariance[:size, :size] = before
        covariance[size:, size:] = motion_covariance_m2
        free = {view: 3 * slot for view, slot in zip(views, view_slots.tolist(), strict=True) if slot >= 0}
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
    by_pixel = problem.camera.jacobian(lines) @ turn / seen.sigma_px[:, None, None]
    lines = state.points_m[ranged.point] - state.positions_m[ranged.view]
    by_range = (lines / (np.linalg.norm(lines, axis=1) * ranged.sigma_m)[:, None])[:, None, :]
    information = np.zeros((len(points), len(state.positions_m), 3, 3))
    # add.at, because a view may have both a pixel and a distance to a landmark.
    np.add.at(information, (place[seen.point], seen.view), np.swapaxes(by_pixel, 1, 2) @ by_pixel)
    np.add.at(information, (place[ranged.point], ranged.view), np.swapaxes(by_range, 1, 2) @ by_range)
    return information


def kept_covariance(problem: Adjustment, state: State) -> tuple[FloatArray, IndexArray, IndexArray]:
    """(3 n, 3 n) covariance of the free views and the prior's landmarks, m^2, and the slots of views and landmarks.

    Slots are -1 for fixed and eliminated variables.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not determined.
    """
    # Derivatives at the state, as in `line_information`, so that both describe one linearisation.
    matrix, _, views, points = reduced_system(replace(problem, frozen=None), state)
    if not len(matrix):
        return matrix, views, points
    # Cholesky refuses a matrix that is not positive definite; an inverse would be returned with negative variances.
    inverse = np.asarray(cho_solve(cho_factor(matrix), np.eye(len(matrix))), dtype=np.float64)
    return 0.5 * (inverse + inverse.T), views, points


def predict_mapped(
    common: SharedUncertainty,
    before: tuple[Adjustment, State, Sequence[int]],
    places: tuple[IndexArray, IndexArray],
    view: int,
    position_m: FloatArray,
) -> PredictedLines:
    """Predict lines of sight from the position of the new ``view`` to landmarks of the adjustment.

    ``places`` are (rows of the frame, indices in the adjustment's state).
    """
    (rows, points), (problem, state, views) = places, before
    by_landmark, own = common.by_landmarks(problem, state, views, points)
    lines = state.points_m[points] - position_m
    # Line of sight = landmark - camera. An error common to both, such as the drift of all views, cancels here.
    by_shared = by_landmark - common.by_camera(view)
    return PredictedLines(rows, lines, by_shared, common.covariance, own, np.ones(len(rows), dtype=np.bool_))


def predict_guessed(
    common: SharedUncertainty,
    slam_map: SlamMap,
    places: tuple[IndexArray, Sequence[tuple[int, int]]],
    depth_m: float,
    view: int,
) -> PredictedLines:
    """Predict lines of sight to landmarks that were seen once, at their measured or guessed distance.

    ``places`` are (rows of the frame, (view, track) of the earlier pixel).
    """
    rows, single_pixels = places
    points, own = guessed_points(slam_map, single_pixels, depth_m)
    at = slam_map.positions_m[view - 1] + slam_map.frames[view].motion_m
    by_camera = common.by_camera(view)
    # The landmark moves with the view that saw it: only the displacement since then is uncertain.
    by_shared = np.array([common.by_view(other) - by_camera for other, _ in single_pixels])
    return PredictedLines(
        rows,
        points - at,
        by_shared.reshape(len(single_pixels), 3, len(common.covariance)),
        common.covariance,
        own,
        np.zeros(len(single_pixels), dtype=np.bool_),
    )


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
