"""Levenberg-Marquardt, equation (4), and the Schur complement that reduces it to the views.

By blocks, with B of the kept variables, V of the eliminated landmarks (3 x 3 blocks) and W their coupling, the normal
equations are ``B dx + W de = -g`` and ``W' dx + V de = -h``. Eliminating de leaves
``(B - W V^-1 W') dx = W V^-1 h - g``, and then ``de = V^-1 (-h - W' dx)``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.estimators.slam.adjustment.compiled import inner, kernel
from boresight.estimators.slam.adjustment.compiled.correlated import add_coupled_steps, subtract_correlated
from boresight.estimators.slam.adjustment.compiled.envelope import Envelope, add_diagonal, factorise, solve
from boresight.estimators.slam.adjustment.compiled.equations import lane_sum, linearise, six
from boresight.estimators.slam.adjustment.compiled.problem import (
    LANES,
    FlatEquations,
    FlatOrdering,
    FlatProblem,
    make_ordering,
)
from boresight.scenarios.arrays import FloatArray, IndexArray


@kernel
def reduced(
    system: FlatEquations, ordering: FlatOrdering, damping: float
) -> tuple[bool, FloatArray, FloatArray, FloatArray]:
    """Reduced matrix in its envelope, right-hand side (3n,), inverse blocks (G, 6 LANES) of the eliminated landmarks.

    The first value is False if a landmark is not determined.
    """
    # Copies, because rejected steps reduce the same system again with other dampings.
    shape, matrix, right = ordering.shape, system.kept.copy(), np.empty(3 * len(system.kept_gradient))
    for k in range(len(right)):
        right[k] = -system.kept_gradient[k // 3, k % 3]
    add_diagonal(matrix, shape, damping)
    inverse = np.empty((ordering.eliminated, 6 * LANES))
    for g in range(ordering.eliminated):
        # The damping of eq. (4) is on the whole diagonal, so that it has to be added before the elimination.
        if not _invert(system.by_point, ordering.landmark, g, damping, inverse):
            return False, matrix, right, inverse
    if ordering.correlated:
        subtract_correlated(system, ordering, inverse, matrix, right)
    else:
        _subtract_landmarks(system, ordering, inverse, matrix, right)
    return True, matrix, right, inverse


@inner
def _subtract_landmarks(
    system: FlatEquations, ordering: FlatOrdering, inverse: FloatArray, matrix: FloatArray, right: FloatArray
) -> None:
    """Subtract the Schur complement's terms W V^-1 W' and W V^-1 h of the eliminated landmarks, in place."""
    shape, slots, terms, sums = ordering.shape, ordering.view_slot, system.terms, system.by_point
    # Rows and columns of the free views; the eliminated landmarks take nothing from those of the kept ones.
    views = ordering.views
    begin = np.zeros(views + 1, np.int64)
    for i in range(views):
        begin[i + 1] = begin[i] + min(shape.reach[i] + 1, views) - i
    # The sums of each lane, and the product of its coupling block with its inverse.
    blocks, pulls = np.zeros((begin[views], 9 * LANES)), np.zeros((views, 3 * LANES))
    product = np.empty(9 * LANES)
    lanes = terms.shape[1] // 9
    # Landmarks that were merged have frames between their tracks in which they are not seen.
    seen = np.zeros(len(terms), np.bool_)
    for cell in range(len(terms)):
        for k in range(6 * LANES):
            seen[cell] |= terms[cell, k] != 0.0
    for g in range(ordering.eliminated):
        end = ordering.begin[g + 1]
        for cell in range(ordering.begin[g], end):
            i = cell + ordering.offset[g]
            slot = slots[i]
            if slot < 0 or not seen[cell]:
                continue
            for k in range(lanes):
                a, b, c = terms[cell, k], terms[cell, LANES + k], terms[cell, 2 * LANES + k]
                d, e, f = terms[cell, 3 * LANES + k], terms[cell, 4 * LANES + k], terms[cell, 5 * LANES + k]
                p, q, r = inverse[g, k], inverse[g, LANES + k], inverse[g, 2 * LANES + k]
                s, t, u = inverse[g, 3 * LANES + k], inverse[g, 4 * LANES + k], inverse[g, 5 * LANES + k]
                product[k], product[LANES + k] = a * p + b * q + c * r, a * q + b * s + c * t
                product[2 * LANES + k], product[3 * LANES + k] = a * r + b * t + c * u, b * p + d * q + e * r
                product[4 * LANES + k], product[5 * LANES + k] = b * q + d * s + e * t, b * r + d * t + e * u
                product[6 * LANES + k], product[7 * LANES + k] = c * p + e * q + f * r, c * q + e * s + f * t
                product[8 * LANES + k] = c * r + e * t + f * u
            for row in range(3):
                for k in range(lanes):
                    pulls[slot, row * LANES + k] += (
                        product[3 * row * LANES + k] * sums[g, 6 * LANES + k]
                        + product[(3 * row + 1) * LANES + k] * sums[g, 7 * LANES + k]
                        + product[(3 * row + 2) * LANES + k] * sums[g, 8 * LANES + k]
                    )
            for other in range(cell, end):
                column = slots[i + other - cell]
                if column < 0 or not seen[other]:
                    continue
                # Only the upper triangle is stored, and the slots of free views are consecutive.
                at = begin[slot] + column - slot
                for k in range(lanes):
                    a, b, c = terms[other, k], terms[other, LANES + k], terms[other, 2 * LANES + k]
                    d, e, f = terms[other, 3 * LANES + k], terms[other, 4 * LANES + k], terms[other, 5 * LANES + k]
                    x, y, z = product[k], product[LANES + k], product[2 * LANES + k]
                    blocks[at, k] += x * a + y * b + z * c
                    blocks[at, LANES + k] += x * b + y * d + z * e
                    blocks[at, 2 * LANES + k] += x * c + y * e + z * f
                    x, y, z = product[3 * LANES + k], product[4 * LANES + k], product[5 * LANES + k]
                    blocks[at, 3 * LANES + k] += x * a + y * b + z * c
                    blocks[at, 4 * LANES + k] += x * b + y * d + z * e
                    blocks[at, 5 * LANES + k] += x * c + y * e + z * f
                    x, y, z = product[6 * LANES + k], product[7 * LANES + k], product[8 * LANES + k]
                    blocks[at, 6 * LANES + k] += x * a + y * b + z * c
                    blocks[at, 7 * LANES + k] += x * b + y * d + z * e
                    blocks[at, 8 * LANES + k] += x * c + y * e + z * f
    # A coupling block is -A'A, the negative of the stored term. The sign cancels in W V^-1 W' and remains in W V^-1 h,
    # which is therefore subtracted too.
    for i in range(views):
        for row in range(3):
            right[3 * i + row] -= lane_sum(pulls, i, row)
            start = shape.begin[i] + row * shape.width[i]
            for block in range(begin[i], begin[i + 1]):
                for column in range(3):
                    matrix[start + 3 * (block - begin[i]) + column] -= lane_sum(blocks, block, 3 * row + column)


@inner
def _invert(sums: FloatArray, landmark: IndexArray, g: int, damping: float, inverse: FloatArray) -> bool:
    """Invert the symmetric block of each lane plus ``damping`` times the identity; False unless positive definite."""
    sound, determined = np.empty(LANES), True
    lanes = sums.shape[1] // 9
    for k in range(lanes):
        # Empty lanes have the identity.
        added = damping if landmark[g, k] >= 0 else 1.0
        a, b, c = sums[g, k] + added, sums[g, LANES + k], sums[g, 2 * LANES + k]
        d, e, f = sums[g, 3 * LANES + k] + added, sums[g, 4 * LANES + k], sums[g, 5 * LANES + k] + added
        # The pivots of LDL' test the sign of the block, and the inverse follows without a square root.
        over = 1.0 / a
        l1, l2 = b * over, c * over  # LDL'
        d1 = d - l1 * b
        over1 = 1.0 / d1
        l3 = (e - l1 * c) * over1
        d2 = f - l2 * c - l3 * l3 * d1
        over2 = 1.0 / d2
        m = l1 * l3 - l2
        x, y = m * over2, l3 * over2
        inverse[g, k], inverse[g, LANES + k] = over + l1 * l1 * over1 + m * x, -l1 * over1 - l3 * x
        inverse[g, 2 * LANES + k], inverse[g, 3 * LANES + k] = x, over1 + l3 * y
        inverse[g, 4 * LANES + k], inverse[g, 5 * LANES + k] = -y, over2
        # NaN is not positive.
        sound[k] = 1.0 if (a > 0.0) & (d1 > 0.0) & (d2 > 0.0) else 0.0
    for k in range(LANES):
        determined &= sound[k] == 1.0
    return determined


@kernel
def step_landmarks(
    system: FlatEquations, ordering: FlatOrdering, step: FloatArray, inverse: FloatArray, points: FloatArray
) -> float:
    """Add the steps of the eliminated landmarks to ``points``, given those (3n,) of the kept variables.

    Returns the longest coordinate of a step.
    """
    longest, right, terms = 0.0, np.empty(3 * LANES), system.terms
    lanes = terms.shape[1] // 9
    for g in range(ordering.eliminated):
        for k in range(3 * LANES):
            right[k] = -system.by_point[g, 6 * LANES + k]
        for cell in range(ordering.begin[g], ordering.begin[g + 1]):
            slot = ordering.view_slot[cell + ordering.offset[g]]
            if slot >= 0 and ordering.correlated:
                add_coupled_steps(terms, cell, step, slot, right)
            elif slot >= 0:
                # W is minus the stored term, so -W' dx is added.
                x, y, z = step[3 * slot], step[3 * slot + 1], step[3 * slot + 2]
                for k in range(lanes):
                    b, c, e = terms[cell, LANES + k], terms[cell, 2 * LANES + k], terms[cell, 4 * LANES + k]
                    right[k] += terms[cell, k] * x + b * y + c * z
                    right[LANES + k] += b * x + terms[cell, 3 * LANES + k] * y + e * z
                    right[2 * LANES + k] += c * x + e * y + terms[cell, 5 * LANES + k] * z
        for lane in range(lanes):
            j = ordering.landmark[g, lane]
            if j >= 0:
                a, b, c, d, e, f = six(inverse, g, lane)
                x, y, z = right[lane], right[LANES + lane], right[2 * LANES + lane]
                x, y, z = a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z
                longest = max(longest, abs(x), abs(y), abs(z))
                points[j, 0] += x
                points[j, 1] += y
                points[j, 2] += z
    return longest


@kernel
def minimise(
    positions: FloatArray, points: FloatArray, step_m: float, iterations: int, *arrays: Any
) -> tuple[FloatArray, FloatArray, float, int, bool]:
    """Minimise from a state by Levenberg-Marquardt: positions, points, cost, steps, and whether it converged.

    ``arrays`` are those of a `FlatProblem`: from Python, numba recognises arrays sooner than a tuple of them.
    """
    problem = FlatProblem(*arrays)
    ordering = make_ordering(problem)
    value, system = linearise(problem, ordering, positions, points)
    if not np.isfinite(value):
        return positions, points, value, 0, False
    damping = _first_damping(system, ordering)
    # Near the minimum the cost may increase by rounding. First-estimates Jacobians are not the derivatives of the cost,
    # which may increase a little towards the state where their gradient is zero; damping would only delay that.
    slack = 1e-12 if len(problem.frozen_points_m) == 0 and len(problem.frozen_positions_m) == 0 else 1e-6
    for iteration in range(1, iterations + 1):
        accepted, longest = False, 0.0
        # Raise lambda until the cost decreases: 25 factors of 10 make the longest step vanish against any variable.
        for _ in range(25):
            solved, length, ahead, points_ahead = _step(system, ordering, damping, positions, points)
            if solved:
                longest = length
                # In one pass with the next equations, since most steps are accepted.
                best, next_system = linearise(problem, ordering, ahead, points_ahead)
                # It is infinite with a landmark behind its camera.
                if best <= value + slack * abs(value) + 1e-18:
                    positions, points, value, system = ahead, points_ahead, best, next_system
                    accepted = True
                    break
            damping *= 10.0
        # Towards Gauss-Newton, eq. (3), while the quadratic model holds.
        damping *= 0.1
        if not accepted:  # no decrease at any damping: converged if rounding is the cause, with a short last step
            return positions, points, value, iteration, longest <= 1e3 * step_m
        if longest <= step_m:
            return positions, points, value, iteration, True
    return positions, points, value, iterations, False


@kernel
def reduced_at(
    positions: FloatArray, points: FloatArray, *arrays: Any
) -> tuple[bool, FloatArray, FloatArray, Envelope, IndexArray, IndexArray]:
    """Reduced matrix, right-hand side (3n,), envelope, and slots of views (V,) and landmarks (L,) at a state.

    The first value is False if a landmark is not determined. ``arrays`` are those of a `FlatProblem`.
    """
    problem = FlatProblem(*arrays)
    ordering = make_ordering(problem)
    # Without damping, which would count as information.
    determined, matrix, right, _ = reduced(linearise(problem, ordering, positions, points)[1], ordering, 0.0)
    return determined, matrix, right, ordering.shape, ordering.view_slot, ordering.point_slot


@inner
def _first_damping(system: FlatEquations, ordering: FlatOrdering) -> float:
    """Return 1e-6 of the mean diagonal of the normal matrix."""
    # Relative to the matrix, so that the damping does not depend on the unit of length. One lambda for all, eq. (4):
    # all variables are positions in metres.
    total, shape, count = 0.0, ordering.shape, len(ordering.shape.reach)
    for i in range(count):
        for row in range(3):
            total += system.kept[shape.begin[i] + row * (shape.width[i] + 1)]
    for g in range(ordering.eliminated):
        for row in (0, 3, 5):
            total += lane_sum(system.by_point, g, row)
        for lane in range(LANES):
            count += int(ordering.landmark[g, lane] >= 0)
    # Nothing is free: any damping will do.
    return 1e-6 * total / (3 * count) if count > 0 else 1.0


@inner
def _step(
    system: FlatEquations, ordering: FlatOrdering, damping: float, positions: FloatArray, points: FloatArray
) -> tuple[bool, float, FloatArray, FloatArray]:
    """Solve equation (4): the longest coordinate of a step, and positions and points after it."""
    ahead, points_ahead = positions.copy(), points.copy()
    solved, matrix, step, inverse = reduced(system, ordering, damping)
    # A rejected factorisation is answered by more damping.
    if not solved or not factorise(matrix, ordering.shape):
        return False, 0.0, ahead, points_ahead
    solve(matrix, ordering.shape, step)
    longest = step_landmarks(system, ordering, step, inverse, points_ahead)
    for value in step:
        longest = max(longest, abs(value))
    _add_steps(ahead, ordering.view_slot, step)
    _add_steps(points_ahead, ordering.point_slot, step)
    return True, longest, ahead, points_ahead


@inner
def _add_steps(rows: FloatArray, slots: IndexArray, step: FloatArray) -> None:
    """Add to positions or points the steps (3n,) of their slots in place."""
    for i in range(len(rows)):
        if slots[i] >= 0:
            for axis in range(3):
                rows[i, axis] += step[3 * slots[i] + axis]
