"""Levenberg-Marquardt on an adjustment with dynamics, and the covariance at the minimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from estimators.slam.dynamics.problem import DynamicAdjustment, DynamicState
from estimators.slam.dynamics.system import DynamicEquations, Rows, dynamic_cost, dynamic_equations
from estimators.slam.levenberg import StoppingRule

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DynamicSolution:
    """The state at the minimum, what it costs, and the steps taken."""

    state: DynamicState
    cost: float
    iterations: int


def minimise_dynamic(problem: DynamicAdjustment, state: DynamicState, rule: StoppingRule) -> DynamicSolution:
    """Minimise `dynamic_cost` from ``state``; all unknowns are metres, and damping acts on all alike, eq. (4)."""
    rows = Rows.of(problem)
    value = dynamic_cost(problem, state)
    damping = 1e-6
    for iteration in range(1, rule.iterations + 1):
        if not np.isfinite(value):
            return DynamicSolution(state, value, iteration)
        trial, step, damping = _descend(problem, dynamic_equations(problem, state, rows), state, value, damping)
        if trial is None:
            return DynamicSolution(state, value, iteration)
        state, value = trial, dynamic_cost(problem, trial)
        if step <= rule.step_m:
            return DynamicSolution(state, value, iteration)
    return DynamicSolution(state, value, rule.iterations)


def covariance_of(problem: DynamicAdjustment, state: DynamicState, wanted: IndexArray, rows: Rows) -> FloatArray:
    """(k, k) covariance of the unknowns in the rows ``wanted``, all others taken for unknown; zero for rows of -1.

    Raises
    ------
    scipy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    matrix, _, _ = dynamic_equations(problem, state, rows).reduced()
    columns = np.zeros((rows.count + 1, len(wanted)))
    columns[wanted, np.arange(len(wanted))] = 1.0
    solved = np.zeros_like(columns)
    solved[:-1] = cho_solve(cho_factor(matrix), columns[:-1])
    covariance = solved[wanted]
    return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)


def _descend(
    problem: DynamicAdjustment, system: DynamicEquations, state: DynamicState, value: float, damping: float
) -> tuple[DynamicState | None, float, float]:
    """Raise the damping until the cost does not grow; nothing if it grows however small the step.

    Returns the new state, the longest step of an unknown (m), and the damping to begin with next time. Rounding may
    raise the cost by some parts in 1e10 at the minimum, where arcs are sharp.
    """
    step = 0.0
    for _ in range(25):
        try:
            matrix, right, inverse = system.reduced(damping)
            solved = cho_solve(cho_factor(matrix), right)
        except (LinAlgError, np.linalg.LinAlgError):
            damping *= 10.0
            continue
        trial, step = system.stepped(state, solved, inverse)
        if dynamic_cost(problem, trial) <= value + 1e-10 * abs(value) + 1e-12:
            return trial, step, 0.1 * damping
        damping *= 10.0
    return None, step, damping
