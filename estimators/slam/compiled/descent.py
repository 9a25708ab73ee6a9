"""Levenberg-Marquardt, equation (4), and the reduced system."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import (
    Envelope,
    add_diagonal,
    block_of_inverse,
    dense,
    eliminate,
    factorise,
    solve,
)
from estimators.slam.compiled.equations import FlatEquations, cost, linearise
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel
from estimators.slam.compiled.layout import FlatLayout, make_layout

__all__ = ["block_of_inverse", "dense", "eliminate", "factorise", "minimise", "reduced_at"]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


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
                ahead = _moved(positions, layout.view_slot, kept_step, layout.view_slot, gone_step)
                points_ahead = _moved(points, layout.point_slot, kept_step, layout.gone_slot, gone_step)
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
    """Reduced matrix in its envelope, right side (3n,), inverted blocks (e, 6) of the eliminated landmarks.

    The first is False if a landmark is not determined.
    """
    matrix, right = np.empty_like(system.kept), np.empty(3 * len(system.kept_gradient))
    for k in range(len(matrix)):
        matrix[k] = system.kept[k]
    for i in range(len(system.kept_gradient)):
        for axis in range(3):
            right[3 * i + axis] = -system.kept_gradient[i, axis]
    add_diagonal(matrix, layout.shape, damping)
    inverse, weighted = np.empty_like(system.gone), np.empty((3, 3))
    for g in range(len(system.gone)):
        if not _invert(system.gone, g, damping, inverse):
            return False, matrix, right, inverse
        for a in range(layout.link_begin[g], layout.link_begin[g + 1]):
            slot = layout.link_slot[a]
            _multiply(system.blocks, layout.link[a], inverse, g, weighted)
            for row in range(3):  # the coupling is less the block
                taken = weighted[row, 0] * system.gone_gradient[g, 0] + weighted[row, 1] * system.gone_gradient[g, 1]
                right[3 * slot + row] -= taken + weighted[row, 2] * system.gone_gradient[g, 2]
            for b in range(layout.link_begin[g], layout.link_begin[g + 1]):
                if layout.link_slot[b] >= slot:
                    _take_product(
                        matrix, layout.shape, slot, layout.link_slot[b], weighted, system.blocks, layout.link[b]
                    )
    return True, matrix, right, inverse


@kernel
def reduced_at(
    problem: FlatProblem, positions: FloatArray, points: FloatArray
) -> tuple[bool, FloatArray, FloatArray, FlatLayout]:
    """Reduced matrix and right side at a state; the first is False if a landmark is not determined."""
    layout = make_layout(problem)
    determined, matrix, right, _ = reduced(linearise(problem, layout, positions, points), layout, 0.0)
    return determined, matrix, right, layout


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
        total += system.gone[g, 0] + system.gone[g, 3] + system.gone[g, 5]
    return 1e-6 * total / (3 * (n + e))


@kernel
def _step(system: FlatEquations, layout: FlatLayout, damping: float) -> tuple[bool, FloatArray, FloatArray]:
    """Solve equation (4) for the steps (3n,) of the kept and (3e,) of the eliminated variables."""
    gone_step = np.empty(3 * len(system.gone))
    solved, matrix, step, inverse = reduced(system, layout, damping)
    if not solved or not factorise(matrix, layout.shape):
        return False, step, gone_step
    solve(matrix, layout.shape, step)
    for g in range(len(system.gone)):
        x, y, z = -system.gone_gradient[g, 0], -system.gone_gradient[g, 1], -system.gone_gradient[g, 2]
        for a in range(layout.link_begin[g], layout.link_begin[g + 1]):
            at = 3 * layout.link_slot[a]
            i, j, k = _times(system.blocks, layout.link[a], step[at], step[at + 1], step[at + 2])
            x, y, z = x + i, y + j, z + k
        gone_step[3 * g], gone_step[3 * g + 1], gone_step[3 * g + 2] = _times(inverse, g, x, y, z)
    return True, step, gone_step


@kernel
def _longest(kept_step: FloatArray, gone_step: FloatArray) -> float:
    """Return the largest coordinate of all steps."""
    longest = 0.0
    for k in range(len(kept_step)):
        longest = max(longest, abs(kept_step[k]))
    for k in range(len(gone_step)):
        longest = max(longest, abs(gone_step[k]))
    return longest


@kernel
def _moved(
    rows: FloatArray, slots: IndexArray, step: FloatArray, rest: IndexArray, rest_step: FloatArray
) -> FloatArray:
    """Return positions or points after the steps of their slots, or of those in ``rest``."""
    ahead = np.empty_like(rows)
    for i in range(len(rows)):
        for axis in range(3):
            ahead[i, axis] = rows[i, axis]
            if slots[i] >= 0:
                ahead[i, axis] += step[3 * slots[i] + axis]
            elif rest[i] >= 0:
                ahead[i, axis] += rest_step[3 * rest[i] + axis]
    return ahead


@kernel
def _invert(blocks: FloatArray, k: int, damping: float, inverse: FloatArray) -> bool:
    """Invert a symmetric block plus a multiple of the identity; False unless it is positive definite."""
    a, b, c = blocks[k, 0] + damping, blocks[k, 1], blocks[k, 2]
    d, e, f = blocks[k, 3] + damping, blocks[k, 4], blocks[k, 5] + damping
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
    m = l1 * l3 - l2
    inverse[k, 0], inverse[k, 1] = 1.0 / a + l1 * l1 / d1 + m * m / d2, -l1 / d1 - l3 * m / d2
    inverse[k, 2], inverse[k, 3] = m / d2, 1.0 / d1 + l3 * l3 / d2
    inverse[k, 4], inverse[k, 5] = -l3 / d2, 1.0 / d2
    return True


@kernel
def _times(blocks: FloatArray, k: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Product of a symmetric block with a vector."""
    a, b, c, d, e, f = blocks[k, 0], blocks[k, 1], blocks[k, 2], blocks[k, 3], blocks[k, 4], blocks[k, 5]
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


@kernel
def _multiply(left: FloatArray, k: int, right: FloatArray, g: int, product: FloatArray) -> None:
    """(3, 3) product of two symmetric blocks."""
    product[0, 0], product[1, 0], product[2, 0] = _times(left, k, right[g, 0], right[g, 1], right[g, 2])
    product[0, 1], product[1, 1], product[2, 1] = _times(left, k, right[g, 1], right[g, 3], right[g, 4])
    product[0, 2], product[1, 2], product[2, 2] = _times(left, k, right[g, 2], right[g, 4], right[g, 5])


@kernel
def _take_product(
    matrix: FloatArray, shape: Envelope, i: int, j: int, left: FloatArray, blocks: FloatArray, k: int
) -> None:
    """Subtract the product of a (3, 3) matrix with a symmetric block at block row ``i`` and column ``j``."""
    for row in range(3):
        x, y, z = _times(blocks, k, left[row, 0], left[row, 1], left[row, 2])
        at = shape.begin[i] + row * shape.width[i] + 3 * (j - i)
        matrix[at] -= x
        matrix[at + 1] -= y
        matrix[at + 2] -= z
