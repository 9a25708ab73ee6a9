"""The cheap judgement of a new frame: all of its pixels fit where the map alone puts its camera.

Nearly all frames without a wrong association pass, and need no covariance of the window. A pixel is expected here with
no more uncertainty than it has of its own: what it shares with others would only widen its limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.slam.expected import guessed_points, line_information
from estimators.slam.gating import mahalanobis_squares
from estimators.slam.journal import Journal
from estimators.slam.state import Adjustment, State

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_FEWEST = 8
"""Landmarks of the map, below which a wrong one draws the camera along."""


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What a new frame sees of what is known.

    Parameters
    ----------
    view
        The frame; its camera has been placed by its motion and the landmarks of the map.
    points
        (n,) for each of its tracks the landmark of the adjustment before, or -1.
    once
        Rows that were seen once before, and (view, track) there.
    depth_m
        Their distance at a guess.
    """

    view: int
    points: IndexArray
    once: tuple[IndexArray, list[tuple[int, int]]]
    depth_m: float


def all_fit(journal: Journal, heard: Heard, before: tuple[Adjustment, State], limit: float) -> bool:
    """Tell whether the squared distance of every pixel is within ``limit``; False where the map is too small."""
    rows = np.flatnonzero(heard.points >= 0)
    if len(rows) < _FEWEST:
        return False
    problem, state = before
    points = heard.points[rows]
    squares = _squares(journal, heard.view, rows, state.points_m[points], None)
    odd = np.flatnonzero(~(squares <= limit))
    if len(odd):
        if 2 * len(odd) > len(rows) or (problem.prior is not None and np.isin(points[odd], problem.prior.points).any()):
            return False
        own = np.asarray(np.linalg.inv(line_information(problem, state, points[odd]).sum(axis=1)), dtype=np.float64)
        if not (_squares(journal, heard.view, rows[odd], state.points_m[points[odd]], own) <= limit).all():
            return False
    once, sights = heard.once
    if not len(once):
        return True
    guessed, own = guessed_points(journal, sights, heard.depth_m)
    return bool((_squares(journal, heard.view, once, guessed, own) <= limit).all())


def _squares(
    journal: Journal, view: int, rows: IndexArray, points_m: FloatArray, own_m2: FloatArray | None
) -> FloatArray:
    """(n,) squared distances of pixels from where landmarks (n, 3) of covariance (n, 3, 3) are; NaN behind."""
    frame, camera = journal.frames[view], journal.camera
    in_camera = (points_m - journal.positions_m[view]) @ frame.R_cam_body.T
    off = frame.uv_px[rows] - camera.project(in_camera)
    if own_m2 is None:
        return np.asarray((off**2).sum(axis=1) / frame.sigma_px**2, dtype=np.float64)
    by_line = camera.jacobian(in_camera) @ frame.R_cam_body
    spread = by_line @ own_m2 @ np.swapaxes(by_line, 1, 2) + frame.sigma_px**2 * np.eye(2)
    return mahalanobis_squares(off, np.asarray(spread, dtype=np.float64))
