"""Levenberg-Marquardt, equation (4), and the reduced system."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import block_of_inverse, dense, eliminate, factorise, solve
from estimators.slam.compiled.equations import FlatEquations, linearise
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel
from estimators.slam.compiled.layout import FlatLayout, make_layout
from estimators.slam.compiled.reduction import back_substitute, reduced
from estimators.slam.compiled.sight import SIGHT_ROWS, look

__all__ = ["block_of_inverse", "dense", "eliminate", "factorise", "minimise", "reduced_at"]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@kernel
def minimise(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, step_m: float, iterations: int
) -> tuple[FloatArray, FloatArray, float, int, bool]:
    """Minimise from a state: what `levenberg.minimise` does, step by step."""
    sights = np.empty((SIGHT_ROWS, len(problem.seen_view)))
    value = look(problem, positions, points, sights)
    if not np.isfinite(value):
        return positions, points, value, 0, False
    layout = make_layout(problem)
    damping = -1.0
    for iteration in range(1, iterations + 1):
        system = linearise(problem, layout, positions, points, sights)
        if damping < 0.0:
            damping = _first_damping(system, layout)
        accepted, longest, best = False, 0.0, value
        for _ in range(25):
            solved, kept_step, gone_step = _step(system, layout, damping)
            if solved:
                longest = _longest(kept_step, gone_step)
                ahead = _moved(positions, layout.view_slot, kept_step)
                points_ahead = _moved(points, layout.point_slot, kept_step)
                _move(points_ahead, layout.gone, gone_step)
                best = look(problem, ahead, points_ahead, sights)
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
def reduced_at(
    problem: FlatProblem, positions: FloatArray, points: FloatArray
) -> tuple[bool, FloatArray, FloatArray, FlatLayout]:
    """Reduced matrix and right side at a state; the first is False if a landmark is not determined."""
    sights = np.empty((SIGHT_ROWS, len(problem.seen_view)))
    look(problem, positions, points, sights)
    layout = make_layout(problem)
    determined, matrix, right, _ = reduced(linearise(problem, layout, positions, points, sights), layout, 0.0)
    return determined, matrix, right, layout


@kernel
def _first_damping(system: FlatEquations, layout: FlatLayout) -> float:
    """Return a millionth of the mean diagonal."""
    total, shape = 0.0, layout.shape
    n, e = len(shape.reach), len(layout.gone)
    if n + e == 0:
        return 1.0
    for i in range(n):
        for row in range(3):
            total += system.kept[shape.begin[i] + row * (shape.width[i] + 1)]
    for j in layout.gone:
        total += system.gone[j, 0] + system.gone[j, 3] + system.gone[j, 5]
    return 1e-6 * total / (3 * (n + e))


@kernel
def _step(system: FlatEquations, layout: FlatLayout, damping: float) -> tuple[bool, FloatArray, FloatArray]:
    """Solve equation (4) for the steps (3n,) of the kept and (e, 3) of the eliminated variables."""
    gone_step = np.empty((len(layout.gone), 3))
    solved, matrix, step, inverse = reduced(system, layout, damping)
    if not solved or not factorise(matrix, layout.shape):
        return False, step, gone_step
    solve(matrix, layout.shape, step)
    back_substitute(system, layout, step, inverse, gone_step)
    return True, step, gone_step


@kernel
def _longest(kept_step: FloatArray, gone_step: FloatArray) -> float:
    """Return the largest coordinate of all steps."""
    longest = 0.0
    for k in range(len(kept_step)):
        longest = max(longest, abs(kept_step[k]))
    for step in gone_step.flat:
        longest = max(longest, abs(step))
    return longest


@kernel
def _moved(rows: FloatArray, slots: IndexArray, step: FloatArray) -> FloatArray:
    """Return positions or points after the steps (3n,) of their slots."""
    ahead = rows.copy()
    for i in range(len(rows)):
        if slots[i] >= 0:
            for axis in range(3):
                ahead[i, axis] += step[3 * slots[i] + axis]
    return ahead


@kernel
def _move(rows: FloatArray, which: IndexArray, steps: FloatArray) -> None:
    """Move some rows by steps of theirs."""
    for k in range(len(which)):
        for axis in range(3):
            rows[which[k], axis] += steps[k, axis]
