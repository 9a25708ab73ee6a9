"""Levenberg-Marquardt, equation (4), the rank of the reduced system and a view's covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import add_block, add_diagonal, dense, factorise, solve
from estimators.slam.compiled.equations import FlatEquations, FlatLayout, cost, linearise, make_layout
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel

FloatArray = NDArray[np.float64]


@kernel
def minimise(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, step_m: float, iterations: int
) -> tuple[FloatArray, FloatArray, float, int, bool]:
    """Minimise from a state: what `levenberg.minimise` does, step by step."""
    value = cost(problem, positions, points)
    if not np.isfinite(value):
        return positions, points, value, 0, False
    layout = make_layout(problem)
    damping = -1.0
    for iteration in range(1, iterations + 1):
        system = linearise(problem, layout, positions, points)
        if damping < 0.0:
            damping = _first_damping(system, layout)
        accepted, longest, best = False, 0.0, value
        for _ in range(25):
            solved, kept_step, gone_step = _step(system, layout, damping)
            if solved:
                longest = _longest(kept_step, gone_step)
                ahead, points_ahead = _moved(layout, positions, points, kept_step, gone_step)
                best = cost(problem, ahead, points_ahead)
                if best <= value + 1e-12 * abs(value) + 1e-18:
                    positions, points, value = ahead, points_ahead, best
                    accepted = True
                    break
            damping *= 10.0
        damping *= 0.1
        if not accepted:
            return positions, points, value, iteration, longest <= 1e3 * step_m
        if longest <= step_m:
            return positions, points, value, iteration, True
    return positions, points, value, iterations, False


@kernel
def reduced(
    system: FlatEquations, layout: FlatLayout, damping: float
) -> tuple[bool, FloatArray, FloatArray, FloatArray]:
    """Reduced matrix in its envelope, right side (3n,), inverted blocks (e, 3, 3) of the eliminated landmarks.

    The first is False if a landmark is not determined.
    """
    matrix, right = system.kept.copy(), -system.kept_gradient
    add_diagonal(matrix, layout.shape, damping)
    inverse = np.empty_like(system.gone)
    weighted, product = np.empty((3, 3)), np.empty((3, 3))
    for g in range(len(system.gone)):
        if not _invert(system.gone[g], damping, inverse[g]):
            return False, matrix, right.ravel(), inverse
        for a in range(layout.link_begin[g], layout.link_begin[g + 1]):
            _multiply(system.blocks[layout.link[a]], inverse[g], weighted)
            slot = layout.link_slot[a]
            for row in range(3):
                for column in range(3):  # the coupling is less the block
                    right[slot, row] -= weighted[row, column] * system.gone_gradient[g, column]
            for b in range(layout.link_begin[g], layout.link_begin[g + 1]):
                if layout.link_slot[b] >= slot:
                    _multiply(weighted, system.blocks[layout.link[b]], product)
                    add_block(matrix, layout.shape, slot, layout.link_slot[b], product, -1.0)
    return True, matrix, right.ravel(), inverse


@kernel
def rank_deficiency(problem: FlatProblem, positions: FloatArray, points: FloatArray, tolerance: float) -> int:
    """Count the eigenvalues of the reduced matrix below ``tolerance`` of the largest.

    The eigenvalues are worked out only where bounds of the smallest, 1 / trace of the inverse, and of the largest, the
    trace, leave room for doubt.
    """
    layout = make_layout(problem)
    n = 3 * len(layout.shape.reach)
    if n == 0:
        return 0
    system = linearise(problem, layout, positions, points)
    determined, matrix, _, _ = reduced(system, layout, 0.0)
    if not determined:
        return n
    full = dense(matrix, layout.shape)
    if factorise(matrix, layout.shape):
        inverse_trace = 0.0
        for i in range(n):
            column = np.zeros(n)
            column[i] = 1.0
            solve(matrix, layout.shape, column)
            inverse_trace += column[i]
        if np.trace(full) * inverse_trace * tolerance < 1.0:
            return 0
    values = np.linalg.eigvalsh(full)
    return int(np.sum(values < tolerance * values[-1]))


@kernel
def view_covariance(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, view: int
) -> tuple[bool, FloatArray]:
    """(3, 3) covariance of a free view's position; False if the reduced matrix is not positive definite."""
    layout = make_layout(problem)
    n = len(layout.shape.reach)
    covariance = np.zeros((3, 3))
    system = linearise(problem, layout, positions, points)
    determined, matrix, _, _ = reduced(system, layout, 0.0)
    if not determined or not factorise(matrix, layout.shape):
        return False, covariance
    slot = 3 * layout.view_slot[view]
    for axis in range(3):
        column = np.zeros(3 * n)
        column[slot + axis] = 1.0
        solve(matrix, layout.shape, column)
        covariance[:, axis] = column[slot : slot + 3]
    return True, 0.5 * (covariance + covariance.T)


@kernel
def _first_damping(system: FlatEquations, layout: FlatLayout) -> float:
    """Return a millionth of the mean diagonal."""
    total, shape = 0.0, layout.shape
    n, e = len(shape.reach), len(system.gone)
    if n + e == 0:
        return 1.0
    for i in range(n):
        for row in range(3):
            total += system.kept[shape.begin[i] + row * (shape.width[i] + 1)]
    for g in range(e):
        total += system.gone[g, 0, 0] + system.gone[g, 1, 1] + system.gone[g, 2, 2]
    return 1e-6 * total / (3 * (n + e))


@kernel
def _step(system: FlatEquations, layout: FlatLayout, damping: float) -> tuple[bool, FloatArray, FloatArray]:
    """Solve equation (4) for the steps (n, 3) of the kept and (e, 3) of the eliminated variables."""
    n, e = len(layout.shape.reach), len(system.gone)
    gone_step = np.empty((e, 3))
    solved, matrix, right, inverse = reduced(system, layout, damping)
    if not solved or not factorise(matrix, layout.shape):
        return False, right.reshape(n, 3), gone_step
    solve(matrix, layout.shape, right)
    kept_step = right.reshape(n, 3)
    pull = np.empty(3)
    for g in range(e):
        pull[:] = -system.gone_gradient[g]
        for a in range(layout.link_begin[g], layout.link_begin[g + 1]):
            block, moved = system.blocks[layout.link[a]], kept_step[layout.link_slot[a]]
            for row in range(3):
                pull[row] += block[row, 0] * moved[0] + block[row, 1] * moved[1] + block[row, 2] * moved[2]
        for row in range(3):
            gone_step[g, row] = (
                inverse[g, row, 0] * pull[0] + inverse[g, row, 1] * pull[1] + inverse[g, row, 2] * pull[2]
            )
    return True, kept_step, gone_step


@kernel
def _longest(kept_step: FloatArray, gone_step: FloatArray) -> float:
    """Return the largest coordinate of all steps."""
    longest = 0.0
    for value in kept_step.ravel():
        longest = max(longest, abs(value))
    for value in gone_step.ravel():
        longest = max(longest, abs(value))
    return longest


@kernel
def _moved(
    layout: FlatLayout, positions: FloatArray, points: FloatArray, kept_step: FloatArray, gone_step: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the state after the steps."""
    ahead, points_ahead = positions.copy(), points.copy()
    for i in range(len(ahead)):
        if layout.view_slot[i] >= 0:
            ahead[i] += kept_step[layout.view_slot[i]]
    for j in range(len(points_ahead)):
        if layout.point_slot[j] >= 0:
            points_ahead[j] += kept_step[layout.point_slot[j]]
        elif layout.gone_slot[j] >= 0:
            points_ahead[j] += gone_step[layout.gone_slot[j]]
    return ahead, points_ahead


@kernel
def _invert(block: FloatArray, damping: float, inverse: FloatArray) -> bool:
    """Invert a symmetric block plus a multiple of the identity; False unless it is positive definite."""
    a, b, c = block[0, 0] + damping, block[0, 1], block[0, 2]
    d, e, f = block[1, 1] + damping, block[1, 2], block[2, 2] + damping
    if not a > 0.0:
        return False
    l1, l2 = b / a, c / a  # LDL'
    d1 = d - l1 * b
    if not d1 > 0.0:
        return False
    l3 = (e - l1 * c) / d1
    d2 = f - l2 * c - l3 * l3 * d1
    if not d2 > 0.0:
        return False
    k2 = l1 * l3 - l2
    inverse[2, 2] = 1.0 / d2
    inverse[1, 2] = inverse[2, 1] = -l3 / d2
    inverse[0, 2] = inverse[2, 0] = k2 / d2
    inverse[1, 1] = 1.0 / d1 + l3 * l3 / d2
    inverse[0, 1] = inverse[1, 0] = -l1 / d1 - l3 * k2 / d2
    inverse[0, 0] = 1.0 / a + l1 * l1 / d1 + k2 * k2 / d2
    return True


@kernel
def _multiply(left: FloatArray, right: FloatArray, product: FloatArray) -> None:
    """(3, 3) product of two such matrices."""
    for row in range(3):
        for column in range(3):
            product[row, column] = (
                left[row, 0] * right[0, column] + left[row, 1] * right[1, column] + left[row, 2] * right[2, column]
            )
