"""Marginalisation: replace measurements that leave a window by a quadratic prior of the remaining variables.

The prior is the Schur complement of the removed variables in the normal equations of the removed measurements, eq. (3),
linearised at the state of the removal. It is exact for linear measurements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from boresight.estimators.slam.adjustment.compiled import marginal as kernels
from boresight.estimators.slam.adjustment.compiled.envelope import without
from boresight.estimators.slam.adjustment.compiled.problem import floats
from boresight.estimators.slam.adjustment.problem import Adjustment, QuadraticPrior, State
from boresight.estimators.slam.adjustment.solver import reduced_system
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class Retained:
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
    stays = retained.views, retained.points, retained.pixels, retained.distances
    known, views, points, information, gradient = kernels.marginalise(problem.flat, *at, stays)
    if not known:
        raise np.linalg.LinAlgError("the eliminated variables are not determined")
    origin_m = np.concatenate([state.positions_m[views], state.points_m[points]])
    return QuadraticPrior(views, points, origin_m, information, gradient)


def removed_part(problem: Adjustment, retained: Retained, coupled: IndexArray) -> Adjustment:
    """Return the removed measurements of ``problem``; the free landmarks are those that they or the prior constrain.

    ``coupled`` are the landmarks of the prior. They are kept for the dense elimination even if they go.
    """
    # Only removed measurements enter the prior: each measurement is then either in it or in the window, never in both.
    moved = problem.motions
    part = replace(
        problem,
        pixels=problem.pixels.subset(~retained.pixels),
        distances=problem.distances.subset(~retained.distances),
        # A motion goes with the first of its two views: the prior then couples the remaining one.
        motions=moved.subset(~(retained.views[moved.start] & retained.views[moved.end])),
    )
    # Landmarks that no removed measurement sees would be eliminated as zero blocks, which have no inverse.
    constrained = np.zeros(len(part.free_points), dtype=np.bool_)
    for points in (part.pixels.point, part.distances.point, coupled):
        constrained[points] = True
    kept = constrained & retained.points
    kept[coupled] = True
    return replace(part, free_points=part.free_points & constrained, kept_points=kept)


def eliminate_rows(information: FloatArray, gradient: FloatArray, out: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Eliminate the rows marked in ``out`` by the Schur complement; return the remaining information and gradient.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not determined.
    """
    known, left, right = without(information, gradient, out)
    if not known:
        raise np.linalg.LinAlgError("the eliminated variables are not determined")
    return left, right


def landmark_covariance(problem: Adjustment, state: State, points: IndexArray) -> FloatArray:
    """(3 n, 3 n) joint covariance of landmarks in the reduced system of ``problem``, m^2.

    Raises
    ------
    scipy.linalg.LinAlgError
        If the reduced matrix is not positive definite.
    """
    matrix, _, _, slots = reduced_system(problem, state)
    # Kept landmarks have slots after the views. Columns of the inverse by solving: only those of the wanted landmarks
    # are computed.
    rows = (3 * slots[points][:, None] + np.arange(3)).ravel()
    solved = cho_solve(cho_factor(matrix), np.eye(len(matrix))[:, rows])[rows]
    return np.asarray(0.5 * (solved + solved.T), dtype=np.float64)
