"""Pixels of a track whose errors add up from frame to frame: their equations, and the elimination of their landmarks.

The errors of the pixels of one track are correlated, so that a landmark couples its views directly, and the blocks
between landmark and view are not symmetric. All else is as in `equations` and `descent`, to which this adds.
"""

from __future__ import annotations

import numpy as np

from boresight.estimators.slam.adjustment.compiled import inner
from boresight.estimators.slam.adjustment.compiled.envelope import add_entry
from boresight.estimators.slam.adjustment.compiled.problem import (
    LANES,
    FlatEquations,
    FlatOrdering,
    FlatProblem,
    Places,
)
from boresight.scenarios.arrays import FloatArray


@inner
def add_correlated_pixels(
    problem: FlatProblem,
    ordering: FlatOrdering,
    at: Places,
    system: FlatEquations,
) -> float:
    """Add all pixels to the equations; return r' C^-1 r, inf with a landmark behind a camera.

    The terms of a cell are a (3, 3) block, minus the derivative of the gradient of its view by its landmark.
    """
    # Sorted by landmark and view.
    point, total, first = problem.seen_point, 0.0, 0
    system.terms[:] = 0.0
    while first < len(point):
        end = first + 1
        while end < len(point) and point[end] == point[first]:
            end += 1
        total += _add_landmark(problem, ordering, at, system, first, end)
        first = end
    return total


@inner
def _add_landmark(
    problem: FlatProblem,
    ordering: FlatOrdering,
    at: Places,
    system: FlatEquations,
    first: int,
    end: int,
) -> float:
    """Add the pixels from ``first`` to ``end``, those of one landmark; return their part of the sum of squares."""
    kept, gradient, by_point, terms = system
    count, j = end - first, problem.seen_point[first]
    g, lane = ordering.group[j], ordering.lane[j]
    J, F, r, sound = _residuals(problem, at, first, end)
    if not sound:
        return np.inf
    weight = _inverse_covariance(problem, first, end)
    WJ, WF, Wr = np.zeros_like(J), np.zeros_like(F), np.zeros_like(r)
    total = 0.0
    for i in range(count):
        for k in range(count):
            for row in range(2):
                Wr[i, row] += weight[i, k] * r[k, row]
                for axis in range(3):
                    WJ[i, row, axis] += weight[i, k] * J[k, row, axis]
                    WF[i, row, axis] += weight[i, k] * F[k, row, axis]
        total += r[i, 0] * Wr[i, 0] + r[i, 1] * Wr[i, 1]
    common = len(problem.free_views) - 1  # the last view stands for the common errors, if there are any
    moves, common_slot = len(problem.seen_moved) > 0, ordering.view_slot[common]
    for i in range(count):
        view = problem.seen_view[first + i]
        slot, cell = ordering.view_slot[view], view - ordering.offset[g]
        for a in range(3):
            pull = J[i, 0, a] * Wr[i, 0] + J[i, 1, a] * Wr[i, 1]
            by_point[g, (6 + a) * LANES + lane] += pull
            if slot >= 0:
                gradient[slot, a] -= pull
            for b in range(3):
                block = J[i, 0, a] * WJ[i, 0, b] + J[i, 1, a] * WJ[i, 1, b]
                terms[cell, (3 * a + b) * LANES + lane] += block
                if b >= a:
                    by_point[g, _entry(a, b) * LANES + lane] += block
            if moves:
                gradient[common_slot, a] += F[i, 0, a] * Wr[i, 0] + F[i, 1, a] * Wr[i, 1]
                for b in range(3):
                    block = F[i, 0, a] * WJ[i, 0, b] + F[i, 1, a] * WJ[i, 1, b]
                    terms[common - ordering.offset[g], (3 * a + b) * LANES + lane] -= block
                    block = F[i, 0, a] * WF[i, 0, b] + F[i, 1, a] * WF[i, 1, b]
                    add_entry(kept, ordering.shape, common_slot, a, common_slot, b, block)
                    if slot >= 0:
                        block = J[i, 0, a] * WF[i, 0, b] + J[i, 1, a] * WF[i, 1, b]
                        add_entry(kept, ordering.shape, slot, a, common_slot, b, -block)
        for k in range(i, count):
            other = ordering.view_slot[problem.seen_view[first + k]]
            if slot >= 0 and other >= 0:
                for a in range(3):
                    for b in range(3):
                        block = weight[i, k] * (J[i, 0, a] * J[k, 0, b] + J[i, 1, a] * J[k, 1, b])
                        add_entry(kept, ordering.shape, slot, a, other, b, block)
    return total


@inner
def _residuals(
    problem: FlatProblem, at: Places, first: int, end: int
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Return derivatives (m, 2, 3) of pixels by landmark and by common errors, and residuals (m, 2), px.

    The last value is False if the landmark is behind a camera. A pixel is off by ``seen_moved`` times the common ones.
    """
    positions, points, frozen_positions, frozen_points = at
    fx, fy, cx, cy = problem.pinhole
    J, F, r = np.empty((end - first, 2, 3)), np.zeros((end - first, 2, 3)), np.empty((end - first, 2))
    line, base, common, moves = np.empty(3), np.empty(3), positions[-1], len(problem.seen_moved) > 0
    for i in range(end - first):
        view, j = problem.seen_view[first + i], problem.seen_point[first]
        for axis in range(3):
            line[axis] = points[j, axis] - positions[view, axis]
            base[axis] = frozen_points[j, axis] - frozen_positions[view, axis]
        R = problem.attitudes[view]
        depth = R[2, 0] * line[0] + R[2, 1] * line[1] + R[2, 2] * line[2]
        if not depth > 0.0:
            return J, F, r, False
        x = R[0, 0] * line[0] + R[0, 1] * line[1] + R[0, 2] * line[2]
        y = R[1, 0] * line[0] + R[1, 1] * line[1] + R[1, 2] * line[2]
        r[i, 0] = fx * x / depth + cx - problem.seen_px[first + i, 0]
        r[i, 1] = fy * y / depth + cy - problem.seen_px[first + i, 1]
        depth = R[2, 0] * base[0] + R[2, 1] * base[1] + R[2, 2] * base[2]
        x = (R[0, 0] * base[0] + R[0, 1] * base[1] + R[0, 2] * base[2]) / depth
        y = (R[1, 0] * base[0] + R[1, 1] * base[1] + R[1, 2] * base[2]) / depth
        for axis in range(3):
            J[i, 0, axis] = fx * (R[0, axis] - x * R[2, axis]) / depth
            J[i, 1, axis] = fy * (R[1, axis] - y * R[2, axis]) / depth
        if moves:
            for row in range(2):
                for axis in range(3):
                    F[i, row, axis] = problem.seen_moved[first + i, row, axis]
                    r[i, row] += F[i, row, axis] * common[axis]
    return J, F, r, True


@inner
def _inverse_covariance(problem: FlatProblem, first: int, end: int) -> FloatArray:
    """(m, m) inverse of sigma^2 I + C, with C the smaller of two variances of the walk, for one coordinate, 1/px^2.

    Pixels of one landmark with the same branch share a walk.
    """
    m = end - first
    inverse = np.empty((m, m))
    for i in range(m):
        for k in range(m):
            same = problem.seen_branch[first + i] == problem.seen_branch[first + k]
            walk = min(problem.seen_walk_px2[first + i], problem.seen_walk_px2[first + k])
            inverse[i, k] = (walk if same else 0.0) + (problem.seen_sigma_px[first + i] ** 2 if i == k else 0.0)
    # Gauss-Jordan in place: pivots of a positive definite matrix need no exchange of rows.
    for p in range(m):
        pivot = 1.0 / inverse[p, p]
        inverse[p, p] = 1.0
        for k in range(m):
            inverse[p, k] *= pivot
        for i in range(m):
            if i != p:
                factor = inverse[i, p]
                inverse[i, p] = 0.0
                for k in range(m):
                    inverse[i, k] -= factor * inverse[p, k]
    return inverse


@inner
def add_symmetric_terms(terms: FloatArray, added: FloatArray) -> None:
    """Add cells of symmetric blocks xx, xy, xz, yy, yz, zz to those of (3, 3) blocks, in place."""
    for cell in range(len(terms)):
        for a in range(3):
            for b in range(3):
                for lane in range(LANES):
                    terms[cell, (3 * a + b) * LANES + lane] += added[cell, _entry(a, b) * LANES + lane]


@inner
def couple_kept_points(ordering: FlatOrdering, kept: FloatArray, terms: FloatArray) -> None:
    """Add the coupling blocks between free views and kept landmarks."""
    for g in range(ordering.eliminated, len(ordering.begin) - 1):
        for cell in range(ordering.begin[g], ordering.begin[g + 1]):
            slot = ordering.view_slot[cell + ordering.offset[g]]
            for lane in range(LANES):
                j = ordering.landmark[g, lane]
                if slot >= 0 and j >= 0 and ordering.point_slot[j] >= 0:
                    for a in range(3):
                        for b in range(3):
                            block = terms[cell, (3 * a + b) * LANES + lane]
                            add_entry(kept, ordering.shape, slot, a, ordering.point_slot[j], b, -block)


@inner
def subtract_correlated(
    system: FlatEquations,
    ordering: FlatOrdering,
    inverse: FloatArray,
    matrix: FloatArray,
    right: FloatArray,
) -> None:
    """Subtract the Schur complement's terms W V^-1 W' and W V^-1 h of the eliminated landmarks, in place."""
    by_point, terms = system.by_point, system.terms
    views = len(ordering.view_slot)
    slots, W, product = np.empty(views, np.int64), np.empty((views, 3, 3)), np.empty((3, 3))
    for g in range(ordering.eliminated):
        for lane in range(LANES):
            # The views that the landmark is coupled with; all blocks of an empty lane are zero.
            count = 0
            for cell in range(ordering.begin[g], ordering.begin[g + 1]):
                coupled, slots[count] = False, ordering.view_slot[cell + ordering.offset[g]]
                for entry in range(9):
                    W[count, entry // 3, entry % 3] = terms[cell, entry * LANES + lane]
                    coupled |= terms[cell, entry * LANES + lane] != 0.0
                count += int(coupled and slots[count] >= 0)
            for i in range(count):
                for a in range(3):
                    for b in range(3):
                        product[a, b] = 0.0
                        for c in range(3):
                            product[a, b] += W[i, a, c] * inverse[g, _entry(b, c) * LANES + lane]
                        right[3 * slots[i] + a] -= product[a, b] * by_point[g, (6 + b) * LANES + lane]
                for k in range(i, count):
                    for a in range(3):
                        for b in range(3):
                            value = product[a, 0] * W[k, b, 0] + product[a, 1] * W[k, b, 1] + product[a, 2] * W[k, b, 2]
                            add_entry(matrix, ordering.shape, slots[i], a, slots[k], b, -value)


@inner
def _entry(a: int, b: int) -> int:
    """Return the place of an entry of a symmetric matrix among xx, xy, xz, yy, yz, zz."""
    return min(a, b) * (5 - min(a, b)) // 2 + max(a, b)


@inner
def add_coupled_steps(terms: FloatArray, cell: int, step: FloatArray, slot: int, right: FloatArray) -> None:
    """Add -W' dx of a view's step to the right-hand side (3 LANES,) of the landmarks of a cell."""
    for a in range(3):
        for b in range(3):
            for lane in range(LANES):
                right[b * LANES + lane] += terms[cell, (3 * a + b) * LANES + lane] * step[3 * slot + a]
