"""The cheap judgement of a new frame: all of its pixels fit where the map alone puts its camera.

Nearly all frames without a wrong association pass, and need no covariance of the window. A pixel is expected here with
no more uncertainty than it has of its own: what it shares with others would only widen its limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.slam.deviations import landmark_information, pixel_squares
from estimators.slam.expected import guessed_points
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
    frame = journal.frames[heard.view]
    points = heard.points[rows]
    lines_m = state.points_m[points] - journal.positions_m[heard.view]
    squares = pixel_squares(journal.camera, frame, rows, lines_m, np.zeros((len(rows), 3, 3)))
    odd = np.flatnonzero(~(squares <= limit))
    if len(odd):
        if 2 * len(odd) > len(rows) or (problem.prior is not None and np.isin(points[odd], problem.prior.points).any()):
            return False
        own = np.asarray(np.linalg.inv(landmark_information(problem, state)[points[odd]]), dtype=np.float64)
        if not (pixel_squares(journal.camera, frame, rows[odd], lines_m[odd], own) <= limit).all():
            return False
    once, sights = heard.once
    if not len(once):
        return True
    guessed, own = guessed_points(journal, sights, heard.depth_m)
    squares = pixel_squares(journal.camera, frame, once, guessed - journal.positions_m[heard.view], own)
    return bool((squares <= limit).all())
