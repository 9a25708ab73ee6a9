"""Marginalisation: replace measurements that leave a window by a quadratic prior of the remaining variables.

The prior is the Schur complement of the removed variables in the normal equations of the removed measurements, eq. (3),
linearised at the state of the removal. It is exact for linear measurements.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from boresight.estimators.slam.adjustment.compiled import marginal as kernels
from boresight.estimators.slam.adjustment.compiled.problem import floats
from boresight.estimators.slam.adjustment.problem import Adjustment, QuadraticPrior, State
from boresight.scenarios.arrays import BoolArray


class Retained(NamedTuple):
    """Masks of the variables and measurements that remain in a window."""

    views: BoolArray
    points: BoolArray
    pixels: BoolArray
    distances: BoolArray

    @classmethod
    def without_view(cls, problem: Adjustment, view: int, lost: BoolArray) -> Retained:
        """Return what remains without a view and without the landmarks marked in ``lost`` (L,)."""
        seen, measured = problem.pixels, problem.distances
        # All pixels of a lost landmark go with it, also those in views that remain: its variable no longer exists.
        return cls(
            np.arange(len(problem.free_views)) != view,
            ~lost,
            (seen.view != view) & ~lost[seen.point],
            (measured.view != view) & ~lost[measured.point],
        )


def marginalise_view(problem: Adjustment, state: State, view: int, lost: BoolArray) -> QuadraticPrior:
    """Marginalise a view and the landmarks marked in ``lost`` (L,); see `marginalise_outside`."""
    return marginalise_outside(problem, state, Retained.without_view(problem, view, lost))


def marginalise_outside(problem: Adjustment, state: State, retained: Retained) -> QuadraticPrior:
    """Marginalise all views, landmarks and measurements outside a window at once.

    All are linearised at ``state``. Motions between two remaining views remain. The prior covers the remaining views
    and landmarks that a removed measurement or the old prior constrains, by their numbers in ``problem``.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the removed variables are not determined.
    """
    at = floats(state.positions_m), floats(state.points_m)
    known, views, points, information, gradient = kernels.marginalise(problem.flat, *at, (*retained,))
    if not known:
        raise np.linalg.LinAlgError("the eliminated variables are not determined")
    origin_m = np.concatenate([state.positions_m[views], state.points_m[points]])
    return QuadraticPrior(views, points, origin_m, information, gradient)
