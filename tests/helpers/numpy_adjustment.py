"""The adjustment of sequences in plain numpy: the reference of its compiled kernels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.linalg import LinAlgError as NumpyLinAlgError
from numpy_equations import VariableOrdering, bearing_jacobians, cost, distance_jacobians, normal_equations
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from boresight.estimators.slam.adjustment.problem import Adjustment, Motions, PixelMeasurements, QuadraticPrior, State
from boresight.estimators.slam.adjustment.solver import RANK_TOLERANCE, AdjustmentSolution


def minimise(problem, state, rule):
    """`estimators.slam.adjustment.solver.minimise`."""
    ordering = VariableOrdering.of(problem)
    value = cost(problem, state)
    if not np.isfinite(value):
        return AdjustmentSolution(state, value, 0, converged=False)
    damping = -1.0
    for iteration in range(1, rule.iterations + 1):
        system = normal_equations(problem, state, ordering)
        damping = _first_damping(system) if damping < 0.0 else damping
        trial, step, damping = _descend(problem, system, state, value, damping)
        if trial is None:
            return AdjustmentSolution(state, value, iteration, converged=step <= 1e3 * rule.step_m)
        state, value = trial, cost(problem, trial)
        if step <= rule.step_m:
            return AdjustmentSolution(state, value, iteration, converged=True)
    return AdjustmentSolution(state, value, rule.iterations, converged=False)


def reduced_rank_deficiency(problem, state):
    """`estimators.slam.adjustment.solver.reduced_rank_deficiency`."""
    ordering = VariableOrdering.of(problem)
    try:
        matrix = normal_equations(problem, state, ordering).reduced()[0]
    except NumpyLinAlgError:
        return 3 * ordering.kept
    values = np.linalg.eigvalsh(matrix) if len(matrix) else np.zeros(1)
    return int(np.count_nonzero(values < RANK_TOLERANCE * values[-1]))


def view_covariance(problem, state, view):
    """`estimators.slam.adjustment.solver.view_covariance`."""
    ordering = VariableOrdering.of(problem)
    matrix, _, _ = normal_equations(problem, state, ordering).reduced()
    slot = 3 * int(ordering.view[view])
    columns = np.eye(len(matrix))[:, slot : slot + 3]
    covariance = cho_solve(cho_factor(matrix), columns)[slot : slot + 3]
    return 0.5 * (covariance + covariance.T)


def place_view(camera, frame, rows, points_m, before, rule):
    """`estimators.slam.adjustment.solver.place_view`, by an adjustment of two views, the first of them fixed."""
    before_m, information = before
    pixels = PixelMeasurements(
        np.ones(len(rows), dtype=np.int64), np.arange(len(rows)), frame.uv_px[rows], np.full(len(rows), frame.sigma_px)
    )
    motions = Motions(np.array([0]), np.array([1]), frame.motion_m[None], information[None])
    views = np.stack([frame.R_cam_body, frame.R_cam_body])
    fixed = np.zeros(len(rows), dtype=bool)
    problem = Adjustment(camera, views, pixels, np.array([False, True]), fixed, motions=motions)
    start = State(np.stack([before_m, before_m + frame.motion_m]), points_m)
    return minimise(problem, start, rule).state.positions_m[1]


def marginalise_view(problem, state, view, lost):
    """`estimators.slam.adjustment.solver.marginalise_view`, by `marginalise_outside`'s way and a Cholesky factor."""
    seen, measured, moved = problem.pixels, problem.distances, problem.motions
    gone = (moved.start == view) | (moved.end == view)
    part = replace(
        problem,
        pixels=seen.subset((seen.view == view) | lost[seen.point]),
        distances=measured.subset((measured.view == view) | lost[measured.point]),
        motions=Motions(moved.start[gone], moved.end[gone], moved.displacement_m[gone], moved.information[gone]),
    )
    prior = np.zeros(0, dtype=np.int64) if problem.prior is None else problem.prior.points
    measured = np.concatenate([part.pixels.point, part.distances.point, prior])
    free = problem.free_points & np.isin(np.arange(len(lost)), measured)
    part = replace(part, free_points=free, kept_points=~lost)
    ordering = VariableOrdering.of(part)
    matrix, right, _ = normal_equations(part, state, ordering).reduced()
    views = np.flatnonzero(problem.free_views & (np.arange(len(problem.free_views)) != view))
    points = np.flatnonzero(free & ~lost)
    stays = np.zeros(ordering.kept, dtype=bool)
    stays[ordering.view[views]] = stays[ordering.kept_point[points]] = True
    out = np.repeat(~stays, 3)
    cross = matrix[np.ix_(out, ~out)]
    solved = cho_solve(cho_factor(matrix[np.ix_(out, out)]), np.column_stack([cross, -right[out]]))
    information = matrix[np.ix_(~out, ~out)] - cross.T @ solved[:, :-1]
    origin = np.concatenate([state.positions_m[views], state.points_m[points]])
    gradient = -right[~out] - cross.T @ solved[:, -1]
    told = (information.reshape(len(origin), 3, -1) != 0.0).any(axis=(1, 2))
    rows, information = np.repeat(told, 3), 0.5 * (information + information.T)
    views, points = views[told[: len(views)]], points[told[len(views) :]]
    return QuadraticPrior(views, points, origin[told], information[np.ix_(rows, rows)], gradient[rows])


def landmark_information(problem, state):
    """(L, 3, 3) information of pixels and distances about each landmark with all views fixed."""
    problem = replace(problem, frozen=None, prior=None)
    told = np.zeros((len(state.points_m), 3, 3))
    for point, rows in (
        (problem.pixels.point, bearing_jacobians(problem, state)),
        (problem.distances.point, distance_jacobians(problem, state)),
    ):
        np.add.at(told, point, np.swapaxes(rows, 1, 2) @ rows)
    return told


def undamped_step(problem, state):
    """Steps (n, 3) of the kept and (e, 3) of the eliminated variables that would set the gradient to zero."""
    return _solve(normal_equations(problem, state, VariableOrdering.of(problem)), 0.0)


def _first_damping(system):
    """Return a millionth of the mean diagonal."""
    diagonal = np.concatenate([np.diag(system.kept), np.diagonal(system.eliminated, axis1=1, axis2=2).ravel()])
    return 1e-6 * float(diagonal.mean()) if len(diagonal) else 1.0


def _descend(problem, system, state, value, damping):
    """Increase the damping until the cost does not increase; None if it increases for every step.

    Returns the new state, the longest step of a variable (m), and the damping to begin with next time. Rounding may
    raise the cost by some parts in 1e12 at the minimum, first-estimates Jacobians by some in 1e6.
    """
    step, slack = 0.0, 1e-12 if problem.frozen is None else 1e-6
    for _ in range(25):
        try:
            kept_step, eliminated_step = _solve(system, damping)
        except (LinAlgError, NumpyLinAlgError):
            damping *= 10.0
            continue
        step = float(max(np.abs(kept_step).max(initial=0.0), np.abs(eliminated_step).max(initial=0.0)))
        trial = system.stepped(state, kept_step, eliminated_step)
        if cost(problem, trial) <= value + slack * abs(value) + 1e-18:
            return trial, step, 0.1 * damping
        damping *= 10.0
    return None, step, damping


def _solve(system, damping):
    """Solve equation (4) for the steps (n, 3) of the kept and (e, 3) of the eliminated variables."""
    matrix, right, inverse = system.reduced(damping)
    kept = cho_solve(cho_factor(matrix), right).reshape(-1, 3) if len(right) else np.zeros((0, 3))
    return kept, system.back_substituted(kept, inverse)
