"""Marginalisation: replace measurements that leave a window by a quadratic prior of the remaining variables.

The prior is the Schur complement of the removed variables in the normal equations of the removed measurements, eq. (3),
linearised at the state of the removal. It is exact for linear measurements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from estimators.slam.compiled import descent
from estimators.slam.normal import VariableOrdering, normal_equations
from estimators.slam.problem import Adjustment, QuadraticPrior, State
from estimators.slam.solver import reduced_system

BoolArray = NDArray[np.bool_]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Retained:
    """What remains in a window, as masks: views (V,), landmarks (L,), pixels (k,) and distances (m,)."""

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
    ordering = VariableOrdering.of(part)
    # Two steps: block-diagonal elimination of the landmarks that go, then dense elimination of the views that go and of
    # landmarks that an old prior couples.
    matrix, right, _ = normal_equations(part, state, ordering).reduced()
    views = np.flatnonzero(part.free_views & retained.views)
    points = np.flatnonzero(ordering.kept_point >= 0)
    remaining = np.zeros(ordering.kept, dtype=np.bool_)
    remaining[ordering.view[views]] = True
    remaining[ordering.kept_point[points]] = True
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
    ordering = VariableOrdering.of(problem)
    matrix, _, _ = normal_equations(problem, state, ordering).reduced()
    # Kept landmarks have slots after the views. Columns of the inverse by solving: only those of the wanted landmarks
    # are computed.
    rows = (3 * ordering.kept_point[points][:, None] + np.arange(3)).ravel()
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


def departing_part(problem: Adjustment, view: int, lost: BoolArray) -> Adjustment:
    """Return the part of ``problem`` that is removed with a view and the landmarks marked in ``lost`` (L,).

    It has all measurements of that view and of those landmarks, and the prior. The remaining landmarks are kept in its
    reduced system.
    """
    seen, measured, moved = problem.pixels, problem.distances, problem.motions
    # All pixels of a lost landmark go with it, also those in views that remain: its variable no longer exists.
    removed = (seen.view == view) | lost[seen.point]
    ranged = (measured.view == view) | lost[measured.point]
    motion = (moved.start == view) | (moved.end == view)
    return replace(
        problem,
        pixels=seen.subset(removed),
        distances=measured.subset(ranged),
        motions=moved.subset(motion),
        kept_points=problem.free_points & ~lost,
    )


def marginalise_view(problem: Adjustment, state: State, view: int, lost: BoolArray) -> QuadraticPrior:
    """Marginalise a view and the landmarks marked in ``lost`` (L,), linearised at ``state``.

    The new prior covers the remaining variables that the removed measurements or the old prior constrain.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the removed variables are not determined.
    """
    part = departing_part(problem, view, lost)
    # Landmarks that no removed measurement sees would be eliminated as zero blocks, which have no inverse.
    part = replace(part, free_points=part.free_points & constrained_points(part))
    matrix, right, view_slots, point_slots = reduced_system(part, state)
    slots = point_slots[lost & (point_slots >= 0)]  # the old prior couples these, so they are not eliminated yet
    if view_slots[view] >= 0:
        slots = np.append(slots, view_slots[view])
    out = np.zeros(len(matrix), dtype=np.bool_)
    out.reshape(-1, 3)[slots] = True
    # The right-hand side of the normal equations is minus the gradient.
    information, gradient = eliminate_rows(matrix, -right, out)
    views = np.flatnonzero(problem.free_views & (np.arange(len(problem.free_views)) != view))
    points = np.flatnonzero(part.free_points & ~lost)
    return without_empty_variables(QuadraticPrior(views, points, _values(state, views, points), information, gradient))


def eliminate_rows(
    information: NDArray[np.float64], gradient: NDArray[np.float64], out: BoolArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eliminate the rows marked in ``out`` by the Schur complement; return the remaining information and gradient.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not determined.
    """
    if not out.any():
        return information, gradient
    # Eliminated rows first; stable, so that the remaining rows keep their order and the sums their rounding.
    order, count = np.argsort(~out, kind="stable"), int(np.count_nonzero(out))
    matrix, right = information[order][:, order], gradient[order]
    # Elimination pivot by pivot shows an undetermined variable by a pivot that is not positive; an inverse would return
    # large numbers instead.
    if not descent.eliminate(matrix, right, count):
        raise np.linalg.LinAlgError("the eliminated variables are not determined")
    return matrix[count:, count:].copy(), right[count:].copy()


def constrained_points(part: Adjustment) -> BoolArray:
    """(L,) which landmarks a measurement of ``part`` or its prior constrains."""
    constrained = np.zeros(len(part.free_points), dtype=np.bool_)
    constrained[part.pixels.point] = True
    constrained[part.distances.point] = True
    if part.prior is not None:
        constrained[part.prior.points] = True
    return constrained


def _values(state: State, views: NDArray[np.int64], points: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.concatenate([state.positions_m[views], state.points_m[points]])


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
