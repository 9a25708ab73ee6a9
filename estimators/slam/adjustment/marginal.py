"""Marginalisation: replace measurements that leave a window by a quadratic prior of the remaining variables.

The prior is the Schur complement of the removed variables in the normal equations of the removed measurements, eq. (3),
linearised at the state of the removal. It is exact for linear measurements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from boresight.estimators.slam.adjustment.compiled import marginal as kernels
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


def marginalise_outside(problem: Adjustment, state: State, retained: Retained) -> QuadraticPrior:
    """Marginalise all views, landmarks and measurements outside a window at once.

    All are linearised at ``state``. Motions between two remaining views remain. The prior covers the remaining views
    and landmarks that a removed measurement constrains, by their numbers in ``problem``.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the removed variables are not determined.
    """
    # Only removed measurements enter the prior: each measurement is then either in it or in the window, never in both.
    part = _outside_part(problem, retained)
    # Two steps: block-diagonal elimination of the landmarks that go, then dense elimination of the views that go and of
    # landmarks that an old prior couples.
    matrix, right, view_slots, point_slots = reduced_system(part, state)
    views = np.flatnonzero(part.free_views & retained.views)
    points = np.flatnonzero(point_slots >= 0)
    remaining = np.zeros(len(right) // 3, dtype=np.bool_)
    remaining[view_slots[views]] = True
    remaining[point_slots[points]] = True
    # The right-hand side is minus the gradient. At x0 = ``state`` this is g of the prior g' (x - x0).
    information, gradient = eliminate_rows(matrix, -right, np.repeat(~remaining, 3))
    origin = np.concatenate([state.positions_m[views], state.points_m[points]])
    return without_empty_variables(QuadraticPrior(views, points, origin, information, gradient))


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


def _outside_part(problem: Adjustment, retained: Retained) -> Adjustment:
    """Return the removed part of ``problem``; its free landmarks are those that it constrains."""
    seen, measured, moved = problem.pixels, problem.distances, problem.motions
    removed, ranged = ~retained.pixels, ~retained.distances
    # A motion goes with the first of its two views: the prior then couples the remaining one.
    motion = ~(retained.views[moved.start] & retained.views[moved.end])
    part = replace(
        problem,
        pixels=seen.subset(removed),
        distances=measured.subset(ranged),
        motions=moved.subset(motion),
    )
    constrained = constrained_points(part)
    return replace(part, free_points=constrained, kept_points=constrained & retained.points)


def marginalise_view(problem: Adjustment, state: State, view: int, lost: BoolArray) -> QuadraticPrior:
    """Marginalise a view and the landmarks marked in ``lost`` (L,), linearised at ``state``.

    The new prior covers the remaining variables that the removed measurements or the old prior constrain.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the removed variables are not determined.
    """
    at = floats(state.positions_m), floats(state.points_m)
    known, views, points, information, gradient = kernels.marginalise(problem.flat, *at, view, lost)
    if not known:
        raise np.linalg.LinAlgError("the eliminated variables are not determined")
    origin = np.concatenate([state.positions_m[views], state.points_m[points]])
    return QuadraticPrior(views, points, origin, information, gradient)


def eliminate_rows(
    information: NDArray[np.float64], gradient: NDArray[np.float64], out: BoolArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eliminate the rows marked in ``out`` by the Schur complement; return the remaining information and gradient.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not determined.
    """
    known, left, right = kernels.without(information, gradient, out)
    if not known:
        raise np.linalg.LinAlgError("the eliminated variables are not determined")
    return left, right


def constrained_points(part: Adjustment) -> BoolArray:
    """(L,) which landmarks a measurement of ``part`` or its prior constrains."""
    constrained = np.zeros(len(part.free_points), dtype=np.bool_)
    constrained[part.pixels.point] = True
    constrained[part.distances.point] = True
    if part.prior is not None:
        constrained[part.prior.points] = True
    return constrained


def without_empty_variables(prior: QuadraticPrior) -> QuadraticPrior:
    """Drop the variables whose rows of the information matrix are zero."""
    # An exact test: nothing is ever added to the rows of an unconstrained variable.
    constrained = np.any(prior.information.reshape(len(prior.origin_m), -1) != 0.0, axis=1)
    rows = np.repeat(constrained, 3)
    count = len(prior.views)
    return QuadraticPrior(
        prior.views[constrained[:count]],
        prior.points[constrained[count:]],
        prior.origin_m[constrained],
        prior.information[np.ix_(rows, rows)],
        prior.gradient[rows],
    )
