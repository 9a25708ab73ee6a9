"""The windowed adjustment: derivatives against differences, the minimum against scipy, rank, marginalisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy_equations import (
    VariableOrdering,
    bearing_jacobians,
    bearing_residuals,
    cost,
    distance_jacobians,
    distance_residuals,
    motion_residuals,
    normal_equations,
)
from scipy.optimize import least_squares
from slam_sequences import Recipe, make_sequence

from boresight.estimators.slam.adjustment.problem import Adjustment, Distances, Motions, QuadraticPrior, State
from boresight.estimators.slam.adjustment.slam_map import SlamMap
from boresight.estimators.slam.adjustment.solver import (
    StoppingRule,
    marginalise_view,
    minimise,
    reduced_rank_deficiency,
    view_covariance,
)

RULE = StoppingRule(1e-8)


@pytest.fixture(scope="module")
def small() -> tuple[Adjustment, State]:
    """Four views, the first fixed, their landmarks, one range and the motions, at a disturbed state."""
    rng = np.random.default_rng(5)
    sequence, truth = make_sequence(rng, Recipe(frames=4, landmarks=8))
    slam_map = SlamMap(sequence.camera)
    slam_map.frames = dict(enumerate(sequence.frames))
    slam_map.positions_m = dict(enumerate(truth.positions_m))
    slam_map.points_m = dict(truth.points_m)
    views = list(range(4))
    tracks = sorted(track for track, by in slam_map.seen_by(views).items() if len(by) >= 2)
    problem = Adjustment(
        camera=sequence.camera,
        R_cam_body=slam_map.attitudes(views),
        pixels=slam_map.pixels(views, tracks),
        free_views=np.array([False, True, True, True]),
        free_points=np.ones(len(tracks), dtype=bool),
        distances=slam_map.distances(views, tracks),
        motions=slam_map.motions(views),
    )
    true = slam_map.state(views, tracks)
    shift = 3.0 * rng.standard_normal(true.positions_m.shape) * problem.free_views[:, None]
    return problem, State(true.positions_m + shift, true.points_m + 5.0 * rng.standard_normal(true.points_m.shape))


def unpacked(problem: Adjustment, state: State, x: np.ndarray) -> State:
    count = 3 * int(problem.free_views.sum())
    positions, points = state.positions_m.copy(), state.points_m.copy()
    positions[problem.free_views] = x[:count].reshape(-1, 3)
    points[problem.free_points] = x[count:].reshape(-1, 3)
    return State(positions, points)


def packed(problem: Adjustment, state: State) -> np.ndarray:
    views, points = state.positions_m[problem.free_views], state.points_m[problem.free_points]
    return np.concatenate([views.ravel(), points.ravel()])


def all_residuals(problem: Adjustment, state: State) -> np.ndarray:
    roots = np.linalg.cholesky(problem.motions.information)
    motions = np.einsum("kji,kj->ki", roots, motion_residuals(problem, state))
    parts = [bearing_residuals(problem, state).ravel(), distance_residuals(problem, state), motions.ravel()]
    return np.concatenate(parts)


def dense_jacobian(problem: Adjustment, state: State) -> np.ndarray:
    x = packed(problem, state)
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-3
        ahead = all_residuals(problem, unpacked(problem, state, x + step))
        columns.append((ahead - all_residuals(problem, unpacked(problem, state, x - step))) / 2e-3)
    return np.stack(columns, axis=1)


def test_derivatives_are_those_of_central_differences(small: tuple[Adjustment, State]) -> None:
    problem, state = small
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-3
        ahead = State(state.positions_m, state.points_m + step)
        behind = State(state.positions_m, state.points_m - step)
        bearing = (bearing_residuals(problem, ahead) - bearing_residuals(problem, behind)) / 2e-3
        np.testing.assert_allclose(bearing_jacobians(problem, state)[:, :, axis], bearing, atol=1e-8)
        distance = (distance_residuals(problem, ahead) - distance_residuals(problem, behind)) / 2e-3
        np.testing.assert_allclose(distance_jacobians(problem, state)[:, 0, axis], distance, atol=1e-6)


@pytest.mark.parametrize("kept", [False, True])
def test_schur_step_solves_the_dense_equations(small: tuple[Adjustment, State], kept: bool) -> None:
    problem, state = small
    if kept:  # some landmarks stay in the reduced system
        problem = replace(problem, kept_points=np.arange(len(problem.free_points)) % 3 == 0)
    system = normal_equations(problem, state, VariableOrdering.of(problem))
    matrix, right, inverse = system.reduced(damping=0.7)
    step = np.linalg.solve(matrix, right).reshape(-1, 3)
    moved = system.stepped(state, step, system.back_substituted(step, inverse))
    J = dense_jacobian(problem, state)
    dense = np.linalg.solve(J.T @ J + 0.7 * np.eye(J.shape[1]), -J.T @ all_residuals(problem, state))
    np.testing.assert_allclose(packed(problem, moved) - packed(problem, state), dense, rtol=1e-5, atol=1e-6)


def test_minimum_is_that_of_scipy(small: tuple[Adjustment, State]) -> None:
    problem, state = small
    solution = minimise(problem, state, RULE)
    foreign = least_squares(
        lambda x: all_residuals(problem, unpacked(problem, state, x)),
        packed(problem, state), xtol=1e-15, ftol=1e-15, gtol=1e-12, x_scale="jac",
    )  # fmt: skip
    assert solution.converged
    assert solution.cost == pytest.approx(foreign.cost, rel=1e-9)
    np.testing.assert_allclose(packed(problem, solution.state), foreign.x, atol=1e-3)
    covariance = np.linalg.inv(foreign.jac.T @ foreign.jac)[6:9, 6:9]
    np.testing.assert_allclose(view_covariance(problem, solution.state, 3), covariance, rtol=1e-3, atol=1e-6)


def test_free_scale_is_one_missing_rank(small: tuple[Adjustment, State]) -> None:
    problem, state = small
    at = minimise(problem, state, RULE).state
    assert reduced_rank_deficiency(problem, at) == 0
    scaleless = replace(problem, distances=Distances(), motions=Motions())
    free = minimise(scaleless, at, RULE)
    assert np.isfinite(free.cost)  # it converges all the same
    assert reduced_rank_deficiency(scaleless, free.state) == 1
    adrift = replace(scaleless, free_views=np.ones(4, dtype=bool))
    assert reduced_rank_deficiency(adrift, free.state) == 4


def test_prior_of_the_departed_stands_for_them(small: tuple[Adjustment, State]) -> None:
    """Gradient and matrix of the remaining variables are those of the whole problem with the others eliminated."""
    problem, state = small
    problem = replace(problem, free_views=np.ones(4, dtype=bool), prior=_anchor(state))
    at = minimise(problem, state, RULE).state
    lost = np.zeros(len(problem.free_points), dtype=bool)
    lost[problem.pixels.point[problem.pixels.view == 0][:2]] = True
    prior = marginalise_view(problem, at, 0, lost)
    seen = problem.pixels
    stays = (seen.view != 0) & ~lost[seen.point]
    rest = replace(
        problem,
        pixels=type(seen)(seen.view[stays], seen.point[stays], seen.uv_px[stays], seen.sigma_px[stays]),
        free_views=np.array([False, True, True, True]),
        free_points=~lost,
        distances=Distances(),
        motions=Motions(*(part[1:] for part in _motion_parts(problem.motions))),
        prior=prior,
    )
    for view in (1, 2, 3):
        np.testing.assert_allclose(view_covariance(rest, at, view), view_covariance(problem, at, view), rtol=1e-6)
    again = minimise(rest, State(at.positions_m + 0.01 * np.arange(12).reshape(4, 3), at.points_m), RULE)
    np.testing.assert_allclose(again.state.positions_m[1:], at.positions_m[1:], atol=1e-3)


def _anchor(state: State) -> QuadraticPrior:
    none = np.zeros(0, dtype=np.int64)
    return QuadraticPrior(np.zeros(1, dtype=np.int64), none, state.positions_m[:1], 4.0 * np.eye(3), np.zeros(3))


def _motion_parts(motions: Motions) -> tuple[np.ndarray, ...]:
    return motions.start, motions.end, motions.displacement_m, motions.information


def test_cost_is_half_the_sum_of_squares(small: tuple[Adjustment, State]) -> None:
    problem, state = small
    assert cost(problem, state) == pytest.approx(0.5 * np.sum(all_residuals(problem, state) ** 2), rel=1e-12)
