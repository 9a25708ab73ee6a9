"""Whitened residuals of sightings and distances, and their derivatives by the landmark.

Both depend on the landmark less the camera position alone, since the attitude is known: the derivative by the position
is that by the landmark with the opposite sign. A residual is what is predicted less what was measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.state import Adjustment, State

FloatArray = NDArray[np.float64]


def bearing_residuals(problem: Adjustment, state: State) -> FloatArray:
    """(k, 2) in standard deviations; NaN where a landmark is behind its camera."""
    seen = problem.sightings
    pixels = problem.camera.project(_in_camera(problem, state))
    return np.asarray((pixels - seen.uv_px) / seen.sigma_px[:, None], dtype=np.float64)


def bearing_jacobians(problem: Adjustment, state: State) -> FloatArray:
    """(k, 2, 3) of `bearing_residuals` by the landmark, 1/m."""
    seen = problem.sightings
    by_camera = problem.camera.jacobian(_in_camera(problem, state))
    return np.asarray(by_camera @ problem.R_cam_body[seen.view] / seen.sigma_px[:, None, None], dtype=np.float64)


def distance_residuals(problem: Adjustment, state: State) -> FloatArray:
    """(k,) in standard deviations: the last row of equation (5)."""
    measured = problem.distances
    lines = state.points_m[measured.point] - state.positions_m[measured.view]
    return np.asarray((np.linalg.norm(lines, axis=1) - measured.range_m) / measured.sigma_m, dtype=np.float64)


def distance_jacobians(problem: Adjustment, state: State) -> FloatArray:
    """(k, 1, 3) of `distance_residuals` by the landmark, 1/m."""
    measured = problem.distances
    lines = state.points_m[measured.point] - state.positions_m[measured.view]
    rows = lines / (np.linalg.norm(lines, axis=1) * measured.sigma_m)[:, None]
    return np.asarray(rows[:, None, :], dtype=np.float64)


def motion_residuals(problem: Adjustment, state: State) -> FloatArray:
    """(k, 3), m, not whitened: the information matrices do that."""
    moved = problem.motions
    steps = state.positions_m[moved.end] - state.positions_m[moved.start]
    return np.asarray(steps - moved.displacement_m, dtype=np.float64)


def cost(problem: Adjustment, state: State) -> float:
    """Half the sum of squares, equation (2), with the prior's quadratic; inf with a landmark behind its camera."""
    bearings = bearing_residuals(problem, state)
    distances = distance_residuals(problem, state)
    motions = motion_residuals(problem, state)
    total = np.sum(bearings**2) + np.sum(distances**2)
    total += np.einsum("ki,kij,kj->", motions, problem.motions.information, motions)
    half = 0.5 * float(total)
    if problem.prior is not None:
        offset = problem.prior.offset(state)
        half += float(0.5 * offset @ problem.prior.information @ offset + problem.prior.gradient @ offset)
    return half if np.isfinite(half) else float("inf")


def _in_camera(problem: Adjustment, state: State) -> FloatArray:
    """(k, 3) the landmarks of all sightings in the axes of their cameras."""
    seen = problem.sightings
    lines = state.points_m[seen.point] - state.positions_m[seen.view]
    return np.asarray(np.einsum("kij,kj->ki", problem.R_cam_body[seen.view], lines), dtype=np.float64)
