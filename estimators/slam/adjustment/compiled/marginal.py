"""Marginalisation: dense elimination of variables from the reduced system of the measurements that leave a window."""

from __future__ import annotations

import numpy as np

from boresight.estimators.slam.adjustment.compiled import kernel
from boresight.estimators.slam.adjustment.compiled.descent import reduced_at
from boresight.estimators.slam.adjustment.compiled.envelope import dense, without
from boresight.estimators.slam.adjustment.compiled.problem import FlatProblem
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray


@kernel
def marginalise(
    problem: FlatProblem,
    positions: FloatArray,
    points: FloatArray,
    stays: tuple[BoolArray, BoolArray, BoolArray, BoolArray],
) -> tuple[bool, IndexArray, IndexArray, FloatArray, FloatArray]:
    """Marginalise all but the views, landmarks, pixels and distances marked in ``stays``, in that order.

    Returns the views and landmarks that remain, by their numbers in the problem, and their information and gradient;
    unconstrained variables do not remain. The first value is False if the removed variables are not determined.
    """
    # Two steps: block-diagonal elimination of the landmarks that go, then dense elimination of the views that go and of
    # landmarks that an old prior couples.
    determined, values, right, ordering = reduced_at(removed(problem, stays), positions, points)
    views, landmarks = np.flatnonzero(ordering.view_slot >= 0), np.flatnonzero(ordering.point_slot >= 0)
    # Slots are in the order of the numbers, views first. The right-hand side is minus the gradient. At x0, the state,
    # this is g of the prior g' (x - x0).
    out = np.concatenate((~stays[0][views], ~stays[1][landmarks]))
    known, matrix, gradient = without(dense(values, ordering.shape), -right, np.repeat(out, 3))
    # An exact test of which variables are constrained: nothing is ever added to the rows of the others.
    constrained = np.empty(len(gradient) // 3, np.bool_)
    for i in range(len(constrained)):
        constrained[i] = np.any(matrix[3 * i : 3 * i + 3] != 0.0)
    rows = np.flatnonzero(np.repeat(constrained, 3))
    views, landmarks = views[stays[0][views]], landmarks[stays[1][landmarks]]
    return (
        determined and known,
        views[constrained[: len(views)]],
        landmarks[constrained[len(views) :]],
        matrix[rows][:, rows],
        gradient[rows],
    )


@kernel
def removed(problem: FlatProblem, stays: tuple[BoolArray, BoolArray, BoolArray, BoolArray]) -> FlatProblem:
    """Return what is removed: measurements that do not stay, and the prior; the landmarks that stay are kept.

    Landmarks that the problem keeps are kept for the dense elimination even if they go. Only removed measurements
    enter the new prior: each measurement is then either in it or in the window, never in both.
    """
    seen, ranged = ~stays[2], ~stays[3]
    # A motion goes with the first of its two views: the prior then couples the remaining one.
    moved = ~(stays[0][problem.motion_start] & stays[0][problem.motion_end])
    # Landmarks that no removed measurement sees would be eliminated as zero blocks, which have no inverse.
    constrained = problem.kept_points.copy()
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
        problem.free_points & (stays[1] | problem.kept_points),
    )
