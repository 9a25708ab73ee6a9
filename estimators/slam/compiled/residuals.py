"""Residuals and cost of an adjustment at a state: the sums of `estimators.slam.normal`, measurement by measurement.

The values of all pixel measurements are stored as rows (6, k), so that the compiler can vectorise the divisions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.slam.compiled import kernel
from boresight.estimators.slam.compiled.problem import FlatProblem

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

RESIDUAL_ROWS = 6
"""Rows of the pixel residuals: landmark x, y, z in camera axes, m; residual u, v, px; its square in sigma^2."""


@kernel
def evaluate_residuals(problem: FlatProblem, positions: FloatArray, points: FloatArray, residuals: FloatArray) -> float:
    """Return half the sum of squares, equation (2), plus the prior; inf with a landmark behind its camera.

    Fills ``residuals`` (6, k).
    """
    to_camera_axes(problem.attitudes, problem.seen_view, problem.seen_point, positions, points, residuals)
    _pixel_residuals(problem.pinhole, problem.seen_px, problem.seen_sigma_px, residuals)
    # A landmark behind its camera may project to its pixel too: an infinite cost makes the solver reject the step.
    if not _all_positive(residuals[2]):
        return np.inf
    total = 0.0
    squares = residuals[5]
    for k in range(len(squares)):
        total += squares[k]
    for k in range(len(problem.ranged_view)):
        x, y, z = line_of_sight(positions, problem.ranged_view[k], points, problem.ranged_point[k])
        total += ((np.sqrt(x * x + y * y + z * z) - problem.range_m[k]) / problem.range_sigma_m[k]) ** 2
    for k in range(len(problem.motion_start)):
        for i in range(3):
            for j in range(3):
                information = problem.motion_information[k, i, j]
                total += (
                    motion_residual(problem, k, i, positions) * information * motion_residual(problem, k, j, positions)
                )
    # Half of equation (2), whose gradient is J' W f without a factor of 2.
    half = 0.5 * total
    if len(problem.prior_gradient) > 0:
        half += _prior_cost(problem, positions, points)
    return half if np.isfinite(half) else np.inf


@kernel
def to_camera_axes(
    attitudes: FloatArray,
    view: IndexArray,
    point: IndexArray,
    positions: FloatArray,
    points: FloatArray,
    in_camera: FloatArray,
) -> None:
    """Write landmark minus camera position in camera axes to the first three rows of ``in_camera``."""
    for k in range(len(view)):
        i = view[k]
        a, b, c = line_of_sight(positions, i, points, point[k])
        in_camera[0, k] = attitudes[i, 0, 0] * a + attitudes[i, 0, 1] * b + attitudes[i, 0, 2] * c
        in_camera[1, k] = attitudes[i, 1, 0] * a + attitudes[i, 1, 1] * b + attitudes[i, 1, 2] * c
        in_camera[2, k] = attitudes[i, 2, 0] * a + attitudes[i, 2, 1] * b + attitudes[i, 2, 2] * c


@kernel
def _all_positive(values: FloatArray) -> bool:
    """Return whether all values are positive; NaN is not."""
    # No early exit: a loop that always runs to its end can be vectorised. NaN is not positive.
    wrong = 0
    for k in range(len(values)):
        wrong += int(not values[k] > 0.0)
    return wrong == 0


@kernel
def _pixel_residuals(pinhole: FloatArray, seen_px: FloatArray, sigma_px: FloatArray, residuals: FloatArray) -> None:
    """Fill the last three rows of the residuals, given the first three."""
    fx, fy, cx, cy = pinhole
    for k in range(len(sigma_px)):
        x, y, z = residuals[0, k], residuals[1, k], residuals[2, k]
        # Predicted minus measured: f(x) of equations (3) and (4), where the paper's equation (2) has y - f(x).
        u = fx * x / z + cx - seen_px[k, 0]
        v = fy * y / z + cy - seen_px[k, 1]
        residuals[3, k], residuals[4, k] = u, v
        residuals[5, k] = (u * u + v * v) / sigma_px[k] ** 2


@kernel
def _prior_cost(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> float:
    """Return the prior's cost at a state."""
    offset = prior_offset(problem, positions, points)
    zero = np.zeros(len(offset))
    pull = prior_pull(problem.prior_information, offset, zero)
    total = 0.0
    for i in range(len(offset)):
        # The cost may be negative: the constant of the eliminated measurements is left out.
        total += offset[i] * (0.5 * pull[i] + problem.prior_gradient[i])
    return total


@kernel
def prior_pull(information: FloatArray, offset: FloatArray, begin: FloatArray) -> FloatArray:
    """Return ``begin + information offset`` (3 n,), three rows at a time for speed."""
    pull = np.empty_like(begin)
    for i in range(len(begin) // 3):
        a, b, c = begin[3 * i], begin[3 * i + 1], begin[3 * i + 2]
        first, second, third = information[3 * i], information[3 * i + 1], information[3 * i + 2]
        for k in range(len(offset)):
            a += first[k] * offset[k]
            b += second[k] * offset[k]
            c += third[k] * offset[k]
        pull[3 * i], pull[3 * i + 1], pull[3 * i + 2] = a, b, c
    return pull


@kernel
def prior_offset(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> FloatArray:
    """(3 (a + b),) state minus the prior's origin, m."""
    views = len(problem.prior_views)
    offset = np.empty(3 * len(problem.prior_origin_m))
    for k in range(len(problem.prior_origin_m)):
        for axis in range(3):
            here = (
                positions[problem.prior_views[k], axis] if k < views else points[problem.prior_points[k - views], axis]
            )
            offset[3 * k + axis] = here - problem.prior_origin_m[k, axis]
    return offset


@kernel
def line_of_sight(positions: FloatArray, i: int, points: FloatArray, j: int) -> tuple[float, float, float]:
    """Return landmark minus camera position, body axes, m."""
    return points[j, 0] - positions[i, 0], points[j, 1] - positions[i, 1], points[j, 2] - positions[i, 2]


@kernel
def motion_residual(problem: FlatProblem, k: int, axis: int, positions: FloatArray) -> float:
    """One coordinate of a displacement minus the predicted one, m."""
    step: float = positions[problem.motion_end[k], axis] - positions[problem.motion_start[k], axis]
    residual: float = step - problem.motion_m[k, axis]
    return residual
