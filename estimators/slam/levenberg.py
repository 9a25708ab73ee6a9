"""Levenberg-Marquardt on an adjustment, equation (4), with the Schur complement and a check of the rank.

Each function has compiled kernels for it (`estimators.slam.compiled`), whose reference is the arithmetic in numpy here.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from estimators.slam.compiled.flat import flat, floats
from estimators.slam.kernels import compiled_kernels, kernel_variant
from estimators.slam.normal import Layout, NormalEquations, normal_equations
from estimators.slam.residuals import cost
from estimators.slam.state import Adjustment, State

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

RANK_TOLERANCE = 1e-11


@dataclass(frozen=True, slots=True)
class Solution:
    """The state at the minimum, what it costs, and whether the solver got there."""

    state: State
    cost: float
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True)
class StoppingRule:
    """When to stop: no variable moves by more than ``step_m``, or after ``iterations`` steps were taken."""

    step_m: float
    iterations: int = 50


def minimise(problem: Adjustment, state: State, rule: StoppingRule) -> Solution:
    """Minimise ``cost`` from ``state``; damping starts at 1e-6 of the mean diagonal."""
    kernels = _kernels(problem)
    if kernels is not None:
        start = floats(state.positions_m), floats(state.points_m)
        positions, points, *end = kernels.minimise(flat(problem), *start, rule.step_m, rule.iterations)
        return Solution(State(positions, points), *end)
    layout = Layout.of(problem)
    value = cost(problem, state)
    if not np.isfinite(value):
        return Solution(state, value, 0, converged=False)
    damping = -1.0
    for iteration in range(1, rule.iterations + 1):
        system = normal_equations(problem, state, layout)
        damping = _first_damping(system) if damping < 0.0 else damping
        trial, step, damping = _descend(problem, system, state, value, damping)
        if trial is None:
            return Solution(state, value, iteration, converged=step <= 1e3 * rule.step_m)
        state, value = trial, cost(problem, trial)
        if step <= rule.step_m:
            return Solution(state, value, iteration, converged=True)
    return Solution(state, value, rule.iterations, converged=False)


def reduced_rank_deficiency(problem: Adjustment, state: State) -> int:
    """Count the directions of the kept variables that nothing determines: a free scale counts as one.

    Levenberg-Marquardt comes to a stop on an undetermined scale as well, wherever that happens to be.
    """
    matrix = _reduced(problem, state)
    if matrix is None:
        return 3 * Layout.of(problem).kept
    if not len(matrix):
        return 0
    values = np.linalg.eigvalsh(matrix)
    return int(np.count_nonzero(values < RANK_TOLERANCE * values[-1]))


def view_covariance(problem: Adjustment, state: State, view: int) -> FloatArray:
    """(3, 3) covariance of a free view's position, all other variables taken for unknown, m^2.

    Raises
    ------
    scipy.linalg.LinAlgError
        If the reduced matrix is not positive definite.
    """
    kernels = _kernels(problem)
    if kernels is not None:
        known, matrix, _, layout = kernels.reduced_at(flat(problem), floats(state.positions_m), floats(state.points_m))
        if not known or not kernels.factorise(matrix, layout.shape):
            raise LinAlgError("the reduced matrix is not positive definite")
        return np.asarray(kernels.block_of_inverse(matrix, layout.shape, layout.view_slot[view]), dtype=np.float64)
    layout = Layout.of(problem)
    matrix, _, _ = normal_equations(problem, state, layout).reduced()
    slot = 3 * int(layout.view[view])
    columns = np.eye(len(matrix))[:, slot : slot + 3]
    covariance = cho_solve(cho_factor(matrix), columns)[slot : slot + 3]
    return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)


def _reduced(problem: Adjustment, state: State) -> FloatArray | None:
    """(3n, 3n) reduced matrix; nothing if a landmark is not determined."""
    kernels = _kernels(problem)
    if kernels is not None:
        known, values, _, found = kernels.reduced_at(flat(problem), floats(state.positions_m), floats(state.points_m))
        return np.asarray(kernels.dense(values, found.shape), dtype=np.float64) if known else None
    try:
        return normal_equations(problem, state, Layout.of(problem)).reduced()[0]
    except np.linalg.LinAlgError:
        return None


def reduced_system(problem: Adjustment, state: State) -> tuple[FloatArray, FloatArray, IndexArray, IndexArray]:
    """Reduced matrix (3n, 3n) and right side (3n,) at a state, and the slots of views (V,) and kept landmarks (L,).

    Raises
    ------
    numpy.linalg.LinAlgError
        If a landmark that is eliminated is not determined.
    """
    kernels = _kernels(problem)
    if kernels is None:
        layout = Layout.of(problem)
        matrix, right, _ = normal_equations(problem, state, layout).reduced()
        return matrix, right, layout.view, layout.kept_point
    at = floats(state.positions_m), floats(state.points_m)
    known, values, right, found = kernels.reduced_at(flat(problem), *at)
    if not known:
        raise LinAlgError("a landmark is not determined")
    return kernels.dense(values, found.shape), right, found.view_slot, found.point_slot


def _kernels(problem: Adjustment) -> ModuleType | None:
    """Return the compiled kernels; nothing where numpy is chosen, or where a lens distorts, which they do not know."""
    if kernel_variant() == "numpy" or problem.camera.distortion is not None:
        return None
    return compiled_kernels()


def _first_damping(system: NormalEquations) -> float:
    """Return a millionth of the mean diagonal."""
    diagonal = np.concatenate([np.diag(system.kept), np.diagonal(system.gone, axis1=1, axis2=2).ravel()])
    return 1e-6 * float(diagonal.mean()) if len(diagonal) else 1.0


def _descend(
    problem: Adjustment, system: NormalEquations, state: State, value: float, damping: float
) -> tuple[State | None, float, float]:
    """Raise the damping until the cost does not grow; nothing if it grows however small the step.

    Returns the new state, the longest step of a variable (m), and the damping to begin with next time. Rounding may
    raise the cost by some parts in 1e12 at the minimum.
    """
    step = 0.0
    for _ in range(25):
        try:
            kept_step, gone_step = _solve(system, damping)
        except (LinAlgError, np.linalg.LinAlgError):
            damping *= 10.0
            continue
        step = float(max(np.abs(kept_step).max(initial=0.0), np.abs(gone_step).max(initial=0.0)))
        trial = system.stepped(state, kept_step, gone_step)
        if cost(problem, trial) <= value + 1e-12 * abs(value) + 1e-18:
            return trial, step, 0.1 * damping
        damping *= 10.0
    return None, step, damping


def _solve(system: NormalEquations, damping: float) -> tuple[FloatArray, FloatArray]:
    """Solve equation (4) for the steps (n, 3) of the kept and (e, 3) of the eliminated variables."""
    matrix, right, inverse = system.reduced(damping)
    kept = cho_solve(cho_factor(matrix), right).reshape(-1, 3) if len(right) else np.zeros((0, 3))
    return kept, system.back_substituted(kept, inverse)
