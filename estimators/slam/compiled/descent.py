"""Levenberg-Marquardt, equation (4), and the Schur complement that reduces it to the views.

By blocks, with B of the kept variables, V of the eliminated landmarks (3 x 3 blocks) and W their coupling, the normal
equations are ``B dx + W de = -g`` and ``W' dx + V de = -h``. Eliminating de leaves
``(B - W V^-1 W') dx = W V^-1 h - g``, and then ``de = V^-1 (-h - W' dx)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.slam.compiled import kernel
from boresight.estimators.slam.compiled.envelope import add_diagonal, block_of_inverse, factorise, solve
from boresight.estimators.slam.compiled.equations import FlatEquations, linearise
from boresight.estimators.slam.compiled.problem import FlatOrdering, FlatProblem, make_ordering
from boresight.estimators.slam.compiled.residuals import RESIDUAL_ROWS, evaluate_residuals

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@kernel
def reduced(
    system: FlatEquations, ordering: FlatOrdering, damping: float
) -> tuple[bool, FloatArray, FloatArray, FloatArray]:
    """Reduced matrix in its envelope, right-hand side (3n,), inverse blocks (e, 6) of the eliminated landmarks.

    The first value is False if a landmark is not determined.
    """
    # Copies, because rejected steps reduce the same system again with other dampings.
    matrix, right = system.kept.copy(), -system.kept_gradient.ravel()
    add_diagonal(matrix, ordering.shape, damping)
    inverse = np.empty((len(ordering.eliminated), 6))
    for g in range(len(ordering.eliminated)):
        # The damping of eq. (4) is on the whole diagonal, so that it has to be added before the elimination.
        if not _invert(system.eliminated, ordering.eliminated[g], damping, inverse, g):
            return False, matrix, right, inverse
    _subtract_landmarks(system, ordering, inverse, matrix, right)
    return True, matrix, right, inverse


@kernel
def _subtract_landmarks(
    system: FlatEquations, ordering: FlatOrdering, inverse: FloatArray, matrix: FloatArray, right: FloatArray
) -> None:
    """Subtract the Schur complement's coupling terms W V^-1 W' and W V^-1 g of the eliminated landmarks, in place."""
    link, slots, terms = ordering.link, ordering.link_slot, system.terms
    for g in range(len(ordering.eliminated)):
        begin, end, own = ordering.link_begin[g], ordering.link_begin[g + 1], np.uintp(ordering.eliminated[g])
        px, py, pz = system.eliminated[own, 6], system.eliminated[own, 7], system.eliminated[own, 8]
        # A coupling block is -A'A, the negative of the stored term. The sign cancels in W V^-1 W' and remains in W V^-1
        # h, which is therefore subtracted below.
        i0, i1, i2, i3, i4, i5 = six(inverse, g)
        for a in range(begin, end):
            slot = slots[a]
            block = six(terms, link[a])
            x0, x1, x2 = times(block, i0, i1, i2)  # columns of the block times the inverse
            y0, y1, y2 = times(block, i1, i3, i4)
            z0, z1, z2 = times(block, i2, i4, i5)
            right[3 * slot] -= x0 * px + y0 * py + z0 * pz
            right[3 * slot + 1] -= x1 * px + y1 * py + z1 * pz
            right[3 * slot + 2] -= x2 * px + y2 * py + z2 * pz
            width = ordering.shape.width[slot]
            corner = ordering.shape.begin[slot] - 3 * slot
            # Only the upper triangle is stored. A view with a pixel and a distance to the landmark has two links with
            # the same slot: both orders of the pair pass the test, and both belong to its diagonal block.
            for b in range(begin, end):
                if slots[b] >= slot:
                    at = corner + 3 * slots[b]
                    other = six(terms, link[b])
                    _subtract(matrix, at, times(other, x0, y0, z0))
                    _subtract(matrix, at + width, times(other, x1, y1, z1))
                    _subtract(matrix, at + 2 * width, times(other, x2, y2, z2))


@kernel
def _subtract(matrix: FloatArray, at: int, taken: tuple[float, float, float]) -> None:
    """Subtract from three consecutive numbers; an unsigned index saves the test of its sign."""
    k = np.uintp(at)
    matrix[k] -= taken[0]
    matrix[k + np.uintp(1)] -= taken[1]
    matrix[k + np.uintp(2)] -= taken[2]


@kernel
def back_substitute(
    system: FlatEquations, ordering: FlatOrdering, step: FloatArray, inverse: FloatArray, eliminated_step: FloatArray
) -> None:
    """Compute the steps (e, 3) of the eliminated landmarks from those (3n,) of the kept variables."""
    for g in range(len(ordering.eliminated)):
        own = system.eliminated[ordering.eliminated[g]]
        x, y, z = -own[6], -own[7], -own[8]
        for a in range(ordering.link_begin[g], ordering.link_begin[g + 1]):
            at = 3 * ordering.link_slot[a]
            # W is minus the stored term, so -W' dx is added.
            i, j, k = times(six(system.terms, ordering.link[a]), step[at], step[at + 1], step[at + 2])
            x, y, z = x + i, y + j, z + k
        eliminated_step[g, 0], eliminated_step[g, 1], eliminated_step[g, 2] = times(six(inverse, g), x, y, z)


@kernel
def _invert(sums: FloatArray, k: int, damping: float, inverse: FloatArray, g: int) -> bool:
    """Invert a symmetric 3 x 3 block plus ``damping`` times the identity; False unless it is positive definite."""
    a, b, c = sums[k, 0] + damping, sums[k, 1], sums[k, 2]
    d, e, f = sums[k, 3] + damping, sums[k, 4], sums[k, 5] + damping
    if not a > 0.0:
        return False
    # The pivots of LDL' test the sign of the block, and the inverse follows without a square root.
    l1, l2 = b / a, c / a  # LDL'
    d1 = d - l1 * b
    if not d1 > 0.0:
        return False
    l3 = (e - l1 * c) / d1
    d2 = f - l2 * c - l3 * l3 * d1
    if not d2 > 0.0:
        return False
    m = l1 * l3 - l2
    inverse[g, 0], inverse[g, 1] = 1.0 / a + l1 * l1 / d1 + m * m / d2, -l1 / d1 - l3 * m / d2
    inverse[g, 2], inverse[g, 3] = m / d2, 1.0 / d1 + l3 * l3 / d2
    inverse[g, 4], inverse[g, 5] = -l3 / d2, 1.0 / d2
    return True


@kernel
def six(rows: FloatArray, k: int) -> tuple[float, float, float, float, float, float]:
    """Return the symmetric block xx, xy, xz, yy, yz, zz of a row; an unsigned index saves the test of its sign."""
    i = np.uintp(k)
    return rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4], rows[i, 5]


@kernel
def times(
    block: tuple[float, float, float, float, float, float], x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Product of a symmetric block with a vector."""
    a, b, c, d, e, f = block
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


@kernel
def minimise(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, step_m: float, iterations: int
) -> tuple[FloatArray, FloatArray, float, int, bool]:
    """Minimise from a state by Levenberg-Marquardt: positions, points, cost, steps, and whether it converged."""
    residuals = np.empty((RESIDUAL_ROWS, len(problem.seen_view)))
    value = evaluate_residuals(problem, positions, points, residuals)
    if not np.isfinite(value):
        return positions, points, value, 0, False
    ordering = make_ordering(problem)
    # Negative: not yet set.
    damping = -1.0
    for iteration in range(1, iterations + 1):
        system = linearise(problem, ordering, positions, points, residuals)
        if damping < 0.0:
            damping = _first_damping(system, ordering)
        # ``residuals`` are those of the state: the search below ends with the accepted one.
        accepted, longest, best = False, 0.0, value
        # Raise lambda until the cost decreases: 25 factors of 10 make the longest step vanish against any variable.
        for _ in range(25):
            solved, kept_step, eliminated_step = _step(system, ordering, damping)
            if solved:
                longest = _longest(kept_step, eliminated_step)
                ahead = _stepped_rows(positions, ordering.view_slot, kept_step)
                points_ahead = _stepped_rows(points, ordering.point_slot, kept_step)
                _add_steps(points_ahead, ordering.eliminated, eliminated_step)
                best = evaluate_residuals(problem, ahead, points_ahead, residuals)
                # Near the minimum the cost may increase by rounding; it is infinite with a landmark behind its camera.
                if best <= value + 1e-12 * abs(value) + 1e-18:
                    positions, points, value = ahead, points_ahead, best
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
def place(
    pinhole: FloatArray,
    R_cam_body: FloatArray,
    uv_px: FloatArray,
    sigma_px: float,
    points: FloatArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    rule: tuple[float, int],
) -> FloatArray:
    """(3,) position of one view from its pixels (k, 2) of known landmarks (k, 3) and its predicted motion.

    ``motion`` are the position before (3,), the displacement (3,) and its information (3, 3); ``rule`` the step, m, and
    the number of steps at which the minimisation ends.
    """
    before, moved, information = motion
    count = len(points)
    index, values, row, blocks = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.empty((2, 3, 3))
    blocks[:] = R_cam_body
    positions, motion_m = np.empty((2, 3)), np.empty((1, 3))
    positions[0], positions[1], motion_m[0] = before, before + moved, moved
    # View 0 is the one before, without pixels and fixed as all landmarks are; view 1 is placed.
    problem = FlatProblem(
        pinhole,
        blocks,
        np.ones(count, np.int64),
        np.arange(count),
        uv_px,
        np.full(count, sigma_px),
        index, index, values, values,  # distances
        np.array([0]), np.array([1]), motion_m, information.copy().reshape(1, 3, 3),
        index, index, row, np.zeros((0, 0)), values,  # prior
        row, row,  # frozen
        np.array([False, True]),
        np.zeros(count, np.bool_),
        np.zeros(count, np.bool_),
    )  # fmt: skip
    placed = minimise(problem, positions, points, rule[0], rule[1])[0]
    position: FloatArray = placed[1].copy()
    return position


@kernel
def reduced_at(
    problem: FlatProblem, positions: FloatArray, points: FloatArray
) -> tuple[bool, FloatArray, FloatArray, FlatOrdering]:
    """Reduced matrix and right-hand side at a state; the first value is False if a landmark is not determined."""
    residuals = np.empty((RESIDUAL_ROWS, len(problem.seen_view)))
    evaluate_residuals(problem, positions, points, residuals)
    ordering = make_ordering(problem)
    # Without damping, which would count as information.
    determined, matrix, right, _ = reduced(linearise(problem, ordering, positions, points, residuals), ordering, 0.0)
    return determined, matrix, right, ordering


@kernel
def view_covariance(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, view: int
) -> tuple[bool, FloatArray]:
    """(3, 3) covariance of a free view's position; the first value is False if the matrix is not positive definite."""
    # The inverse of the Schur complement is the kept block of the inverse of the whole matrix: marginal over the
    # landmarks.
    determined, matrix, _, ordering = reduced_at(problem, positions, points)
    if not determined or not factorise(matrix, ordering.shape):
        return False, np.zeros((3, 3))
    return True, block_of_inverse(matrix, ordering.shape, ordering.view_slot[view])


@kernel
def _first_damping(system: FlatEquations, ordering: FlatOrdering) -> float:
    """Return 1e-6 of the mean diagonal of the normal matrix."""
    # Relative to the matrix, so that the damping does not depend on the unit of length. One lambda for all, eq. (4):
    # all variables are positions in metres.
    total, shape = 0.0, ordering.shape
    n, e = len(shape.reach), len(ordering.eliminated)
    # Nothing is free: any damping will do.
    if n + e == 0:
        return 1.0
    for i in range(n):
        for row in range(3):
            total += system.kept[shape.begin[i] + row * (shape.width[i] + 1)]
    for j in ordering.eliminated:
        total += system.eliminated[j, 0] + system.eliminated[j, 3] + system.eliminated[j, 5]
    return 1e-6 * total / (3 * (n + e))


@kernel
def _step(system: FlatEquations, ordering: FlatOrdering, damping: float) -> tuple[bool, FloatArray, FloatArray]:
    """Solve equation (4) for the steps (3n,) of the kept and (e, 3) of the eliminated variables."""
    eliminated_step = np.empty((len(ordering.eliminated), 3))
    solved, matrix, step, inverse = reduced(system, ordering, damping)
    # A rejected factorisation is answered by more damping.
    if not solved or not factorise(matrix, ordering.shape):
        return False, step, eliminated_step
    solve(matrix, ordering.shape, step)
    back_substitute(system, ordering, step, inverse, eliminated_step)
    return True, step, eliminated_step


@kernel
def _longest(kept_step: FloatArray, eliminated_step: FloatArray) -> float:
    """Return the largest coordinate of all steps."""
    longest = 0.0
    for k in range(len(kept_step)):
        longest = max(longest, abs(kept_step[k]))
    for step in eliminated_step.flat:
        longest = max(longest, abs(step))
    return longest


@kernel
def _stepped_rows(rows: FloatArray, slots: IndexArray, step: FloatArray) -> FloatArray:
    """Return positions or points after the steps (3n,) of their slots."""
    ahead = rows.copy()
    for i in range(len(rows)):
        if slots[i] >= 0:
            for axis in range(3):
                ahead[i, axis] += step[3 * slots[i] + axis]
    return ahead


@kernel
def _add_steps(rows: FloatArray, which: IndexArray, steps: FloatArray) -> None:
    """Add steps (e, 3) to some rows in place."""
    for k in range(len(which)):
        for axis in range(3):
            rows[which[k], axis] += steps[k, axis]
