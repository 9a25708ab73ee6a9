"""Marginalisation: dense elimination of variables from the reduced system of the measurements that leave a window."""

from __future__ import annotations

import numpy as np

from boresight.estimators.slam.adjustment.compiled import kernel
from boresight.estimators.slam.adjustment.compiled.descent import reduced_at
from boresight.estimators.slam.adjustment.compiled.envelope import dense
from boresight.estimators.slam.adjustment.compiled.problem import FlatProblem
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray


@kernel
def marginalise(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, view: int, lost: BoolArray
) -> tuple[bool, IndexArray, IndexArray, FloatArray, FloatArray]:
    """Marginalise a view and the landmarks marked in ``lost`` (L,) from their measurements and the prior.

    Returns the views and landmarks that remain, by their numbers in the problem, and their information and gradient;
    unconstrained variables do not remain. The first value is False if the removed variables are not determined.
    """
    determined, values, right, ordering = reduced_at(_departing(problem, view, lost), positions, points)
    views, landmarks = np.flatnonzero(ordering.view_slot >= 0), np.flatnonzero(ordering.point_slot >= 0)
    # Slots are in the order of the numbers, views first. The old prior couples its lost landmarks, so that these are
    # eliminated here, with the view. The right-hand side is minus the gradient.
    out = np.concatenate((views == view, lost[landmarks]))
    known, matrix, gradient = without(dense(values, ordering.shape), -right, np.repeat(out, 3))
    # An exact test: nothing is ever added to the rows of an unconstrained variable.
    constrained = np.empty(len(gradient) // 3, np.bool_)
    for i in range(len(constrained)):
        constrained[i] = np.any(matrix[3 * i : 3 * i + 3] != 0.0)
    rows = np.flatnonzero(np.repeat(constrained, 3))
    views, landmarks = views[views != view], landmarks[~lost[landmarks]]
    return (
        determined and known,
        views[constrained[: len(views)]],
        landmarks[constrained[len(views) :]],
        matrix[rows][:, rows],
        gradient[rows],
    )


@kernel
def _departing(problem: FlatProblem, view: int, lost: BoolArray) -> FlatProblem:
    """Return what is removed with a view and the landmarks marked in ``lost`` (L,): their measurements, and the prior.

    The remaining landmarks are kept in its reduced system.
    """
    # All pixels of a lost landmark go with it, also those in views that remain: its variable no longer exists.
    seen = (problem.seen_view == view) | lost[problem.seen_point]
    ranged = (problem.ranged_view == view) | lost[problem.ranged_point]
    moved = (problem.motion_start == view) | (problem.motion_end == view)
    # Landmarks that no removed measurement sees would be eliminated as zero blocks, which have no inverse.
    constrained = np.zeros(len(lost), np.bool_)
    for points in (problem.seen_point[seen], problem.ranged_point[ranged], problem.prior_points):
        for j in points:
            constrained[j] = True
    return FlatProblem(
        problem.pinhole,
        problem.attitudes,
        problem.seen_view[seen],
        problem.seen_point[seen],
        problem.seen_px[seen],
        problem.seen_sigma_px[seen],
        problem.ranged_view[ranged],
        problem.ranged_point[ranged],
        problem.range_m[ranged],
        problem.range_sigma_m[ranged],
        problem.motion_start[moved],
        problem.motion_end[moved],
        problem.motion_m[moved],
        problem.motion_information[moved],
        problem.prior_views,
        problem.prior_points,
        problem.prior_origin_m,
        problem.prior_information,
        problem.prior_gradient,
        problem.frozen_positions_m,
        problem.frozen_points_m,
        problem.free_views,
        problem.free_points & constrained,
        problem.free_points & ~lost,
    )


@kernel
def without(matrix: FloatArray, gradient: FloatArray, out: BoolArray) -> tuple[bool, FloatArray, FloatArray]:
    """Eliminate the rows marked in ``out`` (n,) by the Schur complement; False first if they are not determined."""
    # Eliminated rows first; the remaining rows keep their order and the sums their rounding.
    order, count = np.concatenate((np.flatnonzero(out), np.flatnonzero(~out))), int(np.count_nonzero(out))
    sorted_matrix, sorted_gradient = matrix[order][:, order], gradient[order]
    # Elimination pivot by pivot shows an undetermined variable by a pivot that is not positive; an inverse would return
    # large numbers instead.
    known = eliminate(sorted_matrix, sorted_gradient, count)
    return known, sorted_matrix[count:, count:].copy(), sorted_gradient[count:]


@kernel
def eliminate(matrix: FloatArray, right: FloatArray, count: int) -> bool:
    """Eliminate the first ``count`` rows: the other rows and ``right`` (n,) become their Schur complement.

    False if the eliminated part is not positive definite; the values are then undefined.
    """
    n = len(matrix)
    for i in range(count):
        pivot = matrix[i, i]
        # NaN fails too.
        if not pivot > 0.0:
            return False
        for j in range(i + 1, n):
            # Only the upper triangle is used: column i of a symmetric matrix is its row i.
            part = matrix[i, j] / pivot
            # Uncoupled rows stay exactly as they are: a row of zeros remains one.
            if part != 0.0:
                right[j] -= part * right[i]
                for k in range(j, n):
                    matrix[j, k] -= part * matrix[i, k]
    # The lower triangle was not updated: mirror the upper one.
    for i in range(count, n):
        for j in range(i):
            matrix[i, j] = matrix[j, i]
    return True
