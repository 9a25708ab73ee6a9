"""What all measurements outside a window say about what is in it, and how well landmarks are known together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from estimators.slam.marginal import restricted, schur, touched
from estimators.slam.normal import Layout, normal_equations
from estimators.slam.state import Adjustment, Distances, Motions, Prior, Sightings, State

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Staying:
    """What a window goes on with: views (V,), landmarks (L,), and of its sightings (k,) and distances (m,) which."""

    views: BoolArray
    points: BoolArray
    sightings: BoolArray
    distances: BoolArray


def told_from_outside(problem: Adjustment, state: State, staying: Staying) -> Prior:
    """Marginalise all views, landmarks and measurements that do not stay, at once.

    All is linearised at ``state``. Motions stay between views that stay. The quadratic is in the views and landmarks
    that stay, by their numbers in ``problem``, as far as something that goes speaks of them.

    Raises
    ------
    numpy.linalg.LinAlgError
        If what goes is not determined.
    """
    part = _outside(problem, staying)
    layout = Layout.of(part)
    matrix, right, _ = normal_equations(part, state, layout).reduced()
    views = np.flatnonzero(part.free_views & staying.views)
    points = np.flatnonzero(layout.kept_point >= 0)
    stays = np.zeros(layout.kept, dtype=np.bool_)
    stays[layout.view[views]] = True
    stays[layout.kept_point[points]] = True
    information, gradient = schur(matrix, -right, np.repeat(~stays, 3))
    origin = np.concatenate([state.positions_m[views], state.points_m[points]])
    return restricted(Prior(views, points, origin, information, gradient))


def landmark_covariance(problem: Adjustment, state: State, points: IndexArray) -> FloatArray:
    """(3 n, 3 n) covariance of landmarks that the reduced system of ``problem`` keeps.

    Raises
    ------
    scipy.linalg.LinAlgError
        If the reduced matrix is not positive definite.
    """
    layout = Layout.of(problem)
    matrix, _, _ = normal_equations(problem, state, layout).reduced()
    rows = (3 * layout.kept_point[points][:, None] + np.arange(3)).ravel()
    solved = cho_solve(cho_factor(matrix), np.eye(len(matrix))[:, rows])[rows]
    return np.asarray(0.5 * (solved + solved.T), dtype=np.float64)


def _outside(problem: Adjustment, staying: Staying) -> Adjustment:
    """Return the part of ``problem`` that goes; of its landmarks only those that it speaks of are free."""
    seen, measured, moved = problem.sightings, problem.distances, problem.motions
    goes, ranged = ~staying.sightings, ~staying.distances
    motion = ~(staying.views[moved.start] & staying.views[moved.end])
    part = replace(
        problem,
        sightings=Sightings(seen.view[goes], seen.point[goes], seen.uv_px[goes], seen.sigma_px[goes]),
        distances=Distances(
            measured.view[ranged], measured.point[ranged], measured.range_m[ranged], measured.sigma_m[ranged]
        ),
        motions=Motions(
            moved.start[motion], moved.end[motion], moved.displacement_m[motion], moved.information[motion]
        ),
    )
    told = touched(part)
    return replace(part, free_points=told, kept_points=told & staying.points)
