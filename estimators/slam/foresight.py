"""Where the landmarks of a window will be in the next image, with the joint covariance of their pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.slam.association import Adjusted
from estimators.slam.journal import Journal
from estimators.slam.normal import Layout, normal_equations
from estimators.slam.state import Adjustment, State
from scenarios.tracks import Prediction, TrackFrame

FloatArray = NDArray[np.float64]

_UNKNOWN_DEPTH = 0.15  # of the distance: standard deviation of what was seen once


def joint_covariance(problem: Adjustment, state: State, view: int, points: NDArray[np.int64]) -> FloatArray:
    """(3 + 3 n, 3 + 3 n) covariance of a free view's position and of n landmarks, all else taken for unknown, m^2.

    Raises
    ------
    LinAlgError
        If the normal matrix is singular.
    """
    whole = replace(problem, kept_points=np.ones(len(state.points_m), dtype=np.bool_))
    layout = Layout.of(whole)
    matrix, _, _ = normal_equations(whole, state, layout).reduced()
    slots = np.concatenate([[layout.view[view]], layout.kept_point[points]])
    rows = (3 * slots[:, None] + np.arange(3)).ravel()
    return np.asarray(np.linalg.inv(matrix)[np.ix_(rows, rows)], dtype=np.float64)


def foreseen_by_window(journal: Journal, view: int, frame: TrackFrame, solved: Adjusted | None) -> Prediction | None:
    """Predict from the last adjustment, whose last view is ``view``, and the landmarks that it was of.

    Before the first one the position is known, and no landmark. None where the covariance does not exist.
    """
    if solved is None:
        return predicted_pixels(journal, view, frame, (), np.zeros((3, 3)))
    state, tracks = solved.state, solved.tracks
    rows = np.flatnonzero(np.isin(tracks, journal.frames[view].tracks))
    try:
        covariance = joint_covariance(solved.problem, state, len(state.positions_m) - 1, rows)
    except np.linalg.LinAlgError:
        return None
    return predicted_pixels(journal, view, frame, tracks[rows].tolist(), covariance)


def predicted_pixels(
    journal: Journal, view: int, frame: TrackFrame, tracks: Sequence[int], covariance: FloatArray
) -> Prediction:
    """Predict the pixels of all landmarks that a view sees in the frame after it.

    Parameters
    ----------
    view
        The last view.
    tracks
        The landmarks that ``covariance`` knows; the others lie somewhere on their rays.
    covariance
        (3 + 3 t, 3 + 3 t): of the position of the view, then of those landmarks.
    """
    seen = np.sort(journal.frames[view].tracks)
    depth = journal.median_depth(view)
    place = {track: slot for slot, track in enumerate(tracks)}
    here = journal.positions_m[view]
    camera = here + frame.motion_m
    # Rows of the derivatives by the known variables, and what each landmark has of its own.
    by_known = np.zeros((len(seen), 3, len(covariance)))
    own = np.zeros((len(seen), 3, 3))
    points = np.empty((len(seen), 3))
    for row, track in enumerate(seen.tolist()):
        by_known[row, :, :3] = -np.eye(3)
        if track in place:
            points[row] = journal.points_m[track]
            by_known[row, :, 3 + 3 * place[track] : 6 + 3 * place[track]] = np.eye(3)
        else:
            ray = journal.ray(view, track)
            points[row] = here + depth * ray
            by_known[row, :, :3] = 0.0  # it goes with the camera that saw it
            own[row] = (_UNKNOWN_DEPTH * depth) ** 2 * np.outer(ray, ray)
    by_line = journal.camera.jacobian((points - camera) @ frame.R_cam_body.T) @ frame.R_cam_body
    rows = (by_line @ by_known).reshape(2 * len(seen), -1)
    by_motion = -by_line.reshape(2 * len(seen), 3)
    spread = rows @ covariance @ rows.T + by_motion @ frame.motion_covariance_m2 @ by_motion.T
    # A pixel goes with the camera's way over the distance: where both are uncertain, so is their product.
    alone = by_line @ own @ np.swapaxes(by_line, 1, 2)
    product = by_line @ (covariance[:3, :3] + frame.motion_covariance_m2) @ np.swapaxes(by_line, 1, 2)
    alone += _UNKNOWN_DEPTH**2 * np.array([track not in place for track in seen.tolist()])[:, None, None] * product
    for row, block in enumerate(alone):
        spread[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += block
    uv = journal.camera.project((points - camera) @ frame.R_cam_body.T)
    return Prediction(seen, uv, spread)
