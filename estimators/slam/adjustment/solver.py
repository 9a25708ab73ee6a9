"""Solve an adjustment by compiled kernels: minimum, rank, covariance, and marginalisation.

The kernels are in `estimators.slam.adjustment.compiled`; their reference in numpy is in the tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from boresight.estimators.slam.adjustment.compiled import descent
from boresight.estimators.slam.adjustment.compiled.envelope import block_of_inverse, dense, factorise, marginal
from boresight.estimators.slam.adjustment.compiled.problem import FlatProblem, floats
from boresight.estimators.slam.adjustment.problem import Adjustment, QuadraticPrior, State, pinhole_of
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.geometry import Camera
from boresight.scenarios.observation import TrackFrame

_NO_ROWS, _NO_VALUES, _NO_VECTORS, _NO_MATRIX = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 0))
_NO_MOVES = np.zeros((0, 2, 3))
_VIEW_0, _VIEW_1 = np.array([0]), np.array([1])

RANK_TOLERANCE = 1e-11
"""Eigenvalues of the reduced matrix below this part of the largest one count as zero."""


@dataclass(frozen=True, slots=True)
class AdjustmentSolution:
    """State at the minimum, its cost, the steps taken, and whether the solver converged."""

    state: State
    cost: float
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True)
class StoppingRule:
    """Stop when no variable moves by more than ``step_m``, or after ``iterations`` steps."""

    step_m: float
    iterations: int = 50


def minimise(problem: Adjustment, state: State, rule: StoppingRule) -> AdjustmentSolution:
    """Minimise the cost from ``state`` by Levenberg-Marquardt, equation (4).

    The damping starts at 1e-6 of the mean diagonal of the normal matrix.
    """
    start = floats(state.positions_m), floats(state.points_m)
    positions, points, value, iterations, converged = descent.minimise(
        *start, rule.step_m, rule.iterations, *problem.flat
    )
    return AdjustmentSolution(State(positions, points), value, iterations, converged)


def place_view(
    camera: Camera,
    frame: TrackFrame,
    rows: list[int],
    points_m: FloatArray,
    before: tuple[FloatArray, FloatArray],
    rule: StoppingRule,
) -> FloatArray:
    """(3,) position of a frame by its pixels in ``rows``, of known landmarks (k, 3), and its predicted motion.

    ``before`` are the position of the frame before (3,) and the inverse covariance of the predicted motion (3, 3).
    """
    position_m, motion_information = before
    count = len(rows)
    # View 0 is the one before, without pixels and fixed as all landmarks are; view 1 is placed.
    placed = descent.minimise(
        np.array((position_m, position_m + frame.motion_m)),
        points_m,
        rule.step_m,
        rule.iterations,
        pinhole_of(camera),
        np.array((frame.R_cam_body, frame.R_cam_body)),
        np.ones(count, np.int64),
        np.arange(count),
        floats(frame.uv_px[rows]),
        np.full(count, float(frame.sigma_px)),
        _NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES,  # distances
        _VIEW_0, _VIEW_1, floats(frame.motion_m[None]), floats(motion_information[None]),
        _NO_ROWS, _NO_ROWS, _NO_VECTORS, _NO_MATRIX, _NO_VALUES,  # prior
        _NO_VECTORS, _NO_VECTORS,  # frozen
        np.array([False, True]),
        np.zeros(count, np.bool_),
        np.zeros(count, np.bool_),
        _NO_ROWS, _NO_VALUES, _NO_MOVES,  # errors that add up
    )[0]  # fmt: skip
    position: FloatArray = placed[1].copy()
    return position


def reduced_rank_deficiency(problem: Adjustment, state: State) -> int:
    """Count the undetermined directions of the kept variables: a free scale counts as one.

    With known attitudes, bearings leave four directions undetermined: a common translation, which a fixed view or a
    prior determines, and the scale, which needs a distance or a predicted motion. Levenberg-Marquardt converges with an
    undetermined scale too, so that its convergence does not show it. All directions count if a landmark that is
    eliminated is undetermined.
    """
    at = floats(state.positions_m), floats(state.points_m)
    known, values, _, shape, _, _ = descent.reduced_at(*at, *problem.flat)
    matrix = dense(values, shape)
    if not known or not len(matrix):
        return len(matrix)
    # Relative to the largest one: all variables are metres, and rounding errors scale with the largest eigenvalue.
    eigenvalues = np.linalg.eigvalsh(matrix)
    return int(np.count_nonzero(eigenvalues < RANK_TOLERANCE * eigenvalues[-1]))


def view_covariance(problem: Adjustment, state: State, view: int) -> FloatArray:
    """(3, 3) covariance of a free view's position, marginal over all other variables, m^2.

    Raise LinAlgError if the reduced matrix is not positive definite.
    """
    # The inverse of the Schur complement is the kept block of the inverse of the whole matrix: marginal over the
    # landmarks.
    at = floats(state.positions_m), floats(state.points_m)
    known, matrix, _, shape, slots, _ = descent.reduced_at(*at, *problem.flat)
    if not known or not factorise(matrix, shape):
        raise LinAlgError("the reduced matrix is not positive definite")
    return block_of_inverse(matrix, shape, int(slots[view]))


def kept_covariance(problem: Adjustment, state: State) -> tuple[FloatArray, IndexArray, IndexArray]:
    """(3n, 3n) joint covariance of the kept variables, m^2, and the slots of views (V,) and landmarks (L,).

    It is marginal over the landmarks that are eliminated. Slots of fixed or eliminated variables are -1. Raise
    LinAlgError if they are not determined.
    """
    at = floats(state.positions_m), floats(state.points_m)
    known, values, _, shape, views, points = descent.reduced_at(*at, *problem.flat)
    if not known:
        raise LinAlgError("a landmark is not determined")
    matrix = dense(values, shape)
    if not len(matrix):
        return matrix, views, points
    # Cholesky refuses a matrix that is not positive definite; an inverse would be returned with negative variances.
    inverse = np.asarray(cho_solve(cho_factor(matrix), np.eye(len(matrix))), dtype=np.float64)
    return 0.5 * (inverse + inverse.T), views, points


class Retained(NamedTuple):
    """Masks of the variables and measurements that remain in a window."""

    views: BoolArray
    points: BoolArray
    pixels: BoolArray
    distances: BoolArray

    @classmethod
    def without_view(cls, problem: Adjustment, view: int, lost: BoolArray) -> Retained:
        """Return what remains without a view and without the landmarks marked in ``lost`` (L,)."""
        seen, measured = problem.pixels, problem.distances
        # All pixels of a lost landmark go with it, also those in views that remain: its variable no longer exists.
        return cls(
            np.arange(len(problem.free_views)) != view,
            ~lost,
            (seen.view != view) & ~lost[seen.point],
            (measured.view != view) & ~lost[measured.point],
        )


def marginalise_view(problem: Adjustment, state: State, view: int, lost: BoolArray) -> QuadraticPrior:
    """Marginalise a view and the landmarks marked in ``lost`` (L,); see `marginalise_outside`."""
    return marginalise_outside(problem, state, Retained.without_view(problem, view, lost))


def marginalise_outside(problem: Adjustment, state: State, retained: Retained) -> QuadraticPrior:
    """Marginalise all views, landmarks and measurements outside a window at once.

    The prior is the Schur complement of the removed variables in the normal equations of the removed measurements, eq.
    (3), linearised at ``state``: exact for linear measurements. Motions between two remaining views remain. It covers
    the remaining views and landmarks that a removed measurement or the old prior constrains, by their numbers in
    ``problem``. Raise LinAlgError if the removed variables are not determined.
    """
    # Two steps: block-diagonal elimination of the landmarks that go, then dense elimination of the views that go and of
    # landmarks that an old prior couples.
    at = floats(state.positions_m), floats(state.points_m)
    determined, values, right, shape, view_slot, point_slot = descent.reduced_at(*at, *removed(problem.flat, retained))
    known, views, points, information, gradient = marginal(
        values, right, shape, view_slot, point_slot, retained.views, retained.points
    )
    if not determined or not known:
        raise LinAlgError("the eliminated variables are not determined")
    origin_m = np.concatenate([state.positions_m[views], state.points_m[points]])
    return QuadraticPrior(views, points, origin_m, information, gradient)


def removed(problem: FlatProblem, stays: Retained) -> FlatProblem:
    """Return what is removed: measurements that do not stay, and the prior; the landmarks that stay are kept.

    Landmarks that the problem keeps are kept for the dense elimination even if they go. Only removed measurements
    enter the new prior: each measurement is then either in it or in the window, never in both.
    """
    seen, ranged = ~stays.pixels, ~stays.distances
    # A motion goes with the first of its two views: the prior then couples the remaining one.
    moved = ~(stays.views[problem.motion_start] & stays.views[problem.motion_end])
    seen_point, ranged_point = problem.seen_point[seen], problem.ranged_point[ranged]
    # Landmarks that no removed measurement sees would be eliminated as zero blocks, which have no inverse.
    constrained = problem.kept_points.copy()
    for points in (seen_point, ranged_point, problem.prior_points):
        constrained[points] = True
    return problem._replace(
        seen_view=problem.seen_view[seen],
        seen_point=seen_point,
        seen_px=problem.seen_px[seen],
        seen_sigma_px=problem.seen_sigma_px[seen],
        seen_branch=problem.seen_branch[seen] if len(problem.seen_branch) else problem.seen_branch,
        seen_walk_px2=problem.seen_walk_px2[seen] if len(problem.seen_walk_px2) else problem.seen_walk_px2,
        seen_moved=problem.seen_moved[seen] if len(problem.seen_moved) else problem.seen_moved,
        ranged_view=problem.ranged_view[ranged],
        ranged_point=ranged_point,
        range_m=problem.range_m[ranged],
        range_sigma_m=problem.range_sigma_m[ranged],
        motion_start=problem.motion_start[moved],
        motion_end=problem.motion_end[moved],
        motion_m=problem.motion_m[moved],
        motion_information=problem.motion_information[moved],
        free_points=problem.free_points & constrained,
        kept_points=problem.free_points & (stays.points | problem.kept_points),
    )
