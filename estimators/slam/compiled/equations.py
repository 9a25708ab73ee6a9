"""Cost and normal equations of an adjustment: the same sums as `residuals` and `normal`, measurement by measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import add_entry, add_symmetric
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel
from estimators.slam.compiled.layout import FlatLayout, ends, prior_slots

FloatArray = NDArray[np.float64]


class FlatEquations(NamedTuple):
    """Kept matrix and gradient (n, 3), eliminated (e, 6) and (e, 3), and A'A of the measurements (m, 6).

    Of a symmetric (3, 3) block the six entries xx, xy, xz, yy, yz, zz are stored.
    """

    kept: FloatArray
    kept_gradient: FloatArray
    gone: FloatArray
    gone_gradient: FloatArray
    blocks: FloatArray


@kernel
def cost(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> float:
    """Half the sum of squares, equation (2), with the prior's quadratic; inf with a landmark behind its camera."""
    fx, fy, cx, cy = problem.pinhole
    total = 0.0
    for k in range(len(problem.seen_view)):
        x, y, z = _in_camera(problem, k, positions, points)
        if not z > 0.0:
            return np.inf
        u = fx * x / z + cx - problem.seen_px[k, 0]
        v = fy * y / z + cy - problem.seen_px[k, 1]
        total += (u * u + v * v) / problem.seen_sigma_px[k] ** 2
    for k in range(len(problem.ranged_view)):
        x, y, z = _line(positions, problem.ranged_view[k], points, problem.ranged_point[k])
        total += ((np.sqrt(x * x + y * y + z * z) - problem.range_m[k]) / problem.range_sigma_m[k]) ** 2
    for k in range(len(problem.motion_start)):
        for i in range(3):
            for j in range(3):
                information = problem.motion_information[k, i, j]
                total += _drift(problem, k, i, positions) * information * _drift(problem, k, j, positions)
    half = 0.5 * total + _prior_cost(problem, positions, points)
    return half if np.isfinite(half) else np.inf


@kernel
def _prior_cost(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> float:
    """Quadratic of the prior at a state."""
    offset = _prior_offset(problem, positions, points)
    total = 0.0
    for i in range(len(offset)):
        pull = 0.0
        for j in range(len(offset)):
            pull += problem.prior_information[i, j] * offset[j]
        total += offset[i] * (0.5 * pull + problem.prior_gradient[i])
    return total


@kernel
def _prior_offset(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> FloatArray:
    """(3 (a + b),) how far a state is from where the prior was made, m."""
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
def _line(positions: FloatArray, i: int, points: FloatArray, j: int) -> tuple[float, float, float]:
    """From a view to a landmark, m."""
    return points[j, 0] - positions[i, 0], points[j, 1] - positions[i, 1], points[j, 2] - positions[i, 2]


@kernel
def _in_camera(problem: FlatProblem, k: int, positions: FloatArray, points: FloatArray) -> tuple[float, float, float]:
    """Return the landmark of a sighting in the axes of its camera."""
    R, i = problem.attitudes, problem.seen_view[k]
    a, b, c = _line(positions, i, points, problem.seen_point[k])
    return (
        R[i, 0, 0] * a + R[i, 0, 1] * b + R[i, 0, 2] * c,
        R[i, 1, 0] * a + R[i, 1, 1] * b + R[i, 1, 2] * c,
        R[i, 2, 0] * a + R[i, 2, 1] * b + R[i, 2, 2] * c,
    )


@kernel
def _drift(problem: FlatProblem, k: int, axis: int, positions: FloatArray) -> float:
    """One coordinate of a displacement less the predicted one, m."""
    step: float = positions[problem.motion_end[k], axis] - positions[problem.motion_start[k], axis]
    drift: float = step - problem.motion_m[k, axis]
    return drift


@kernel
def linearise(problem: FlatProblem, layout: FlatLayout, positions: FloatArray, points: FloatArray) -> FlatEquations:
    """Return J' W J and J' W f of equation (3) by blocks."""
    seen, shape = len(problem.seen_view), layout.shape
    count = seen + len(problem.ranged_view)
    n, e = len(shape.reach), len(layout.link_begin) - 1
    kept, kept_gradient = np.zeros(shape.begin[n]), np.zeros((n, 3))
    gone, gone_gradient = np.zeros((e, 6)), np.zeros((e, 3))
    blocks, pull = np.empty((count, 6)), np.empty(3)
    frozen_positions = _merged(problem.frozen_positions_m, positions)
    frozen_points = _merged(problem.frozen_points_m, points)
    for k in range(count):
        i, j = ends(problem, k, seen)
        if k < seen:
            _sighting(problem, k, positions, points, frozen_positions, frozen_points, blocks, pull)
        else:
            _distance(problem, k, positions, points, frozen_positions, frozen_points, blocks, pull)
        a, b, g = layout.view_slot[i], layout.point_slot[j], layout.gone_slot[j]
        if a >= 0:
            add_symmetric(kept, shape, a, a, blocks, k, 1.0)
            _add_row(kept_gradient, a, pull, -1.0)
        if b >= 0:
            add_symmetric(kept, shape, b, b, blocks, k, 1.0)
            _add_row(kept_gradient, b, pull, 1.0)
        if a >= 0 and b >= 0:
            add_symmetric(kept, shape, a, b, blocks, k, -1.0)
        if g >= 0:
            for entry in range(6):
                gone[g, entry] += blocks[k, entry]
            _add_row(gone_gradient, g, pull, 1.0)
    _add_motions(problem, layout, positions, kept, kept_gradient)
    _add_prior(problem, layout, positions, points, kept, kept_gradient)
    return FlatEquations(kept, kept_gradient, gone, gone_gradient, blocks)


@kernel
def _add_row(rows: FloatArray, i: int, added: FloatArray, sign: float) -> None:
    """Add a 3-vector to a row."""
    for axis in range(3):
        rows[i, axis] += sign * added[axis]


@kernel
def _merged(frozen: FloatArray, present: FloatArray) -> FloatArray:
    """Return where derivatives are taken: at the frozen values where there are any."""
    if len(frozen) == 0:
        return present
    merged = np.empty_like(present)
    for i in range(len(present)):
        for axis in range(3):
            merged[i, axis] = present[i, axis] if np.isnan(frozen[i, axis]) else frozen[i, axis]
    return merged


@kernel
def _sighting(
    problem: FlatProblem,
    k: int,
    positions: FloatArray,
    points: FloatArray,
    frozen_positions: FloatArray,
    frozen_points: FloatArray,
    blocks: FloatArray,
    pull: FloatArray,
) -> None:
    """A'A and A'r of a sighting, A by the landmark."""
    fx, fy, cx, cy = problem.pinhole
    R, i, sigma = problem.attitudes, problem.seen_view[k], problem.seen_sigma_px[k]
    x, y, z = _in_camera(problem, k, positions, points)
    u = (fx * x / z + cx - problem.seen_px[k, 0]) / sigma
    v = (fy * y / z + cy - problem.seen_px[k, 1]) / sigma
    x, y, z = _in_camera(problem, k, frozen_positions, frozen_points)
    du, dv, p, q = fx / (z * sigma), fy / (z * sigma), x / z, y / z
    u0, u1, u2 = (
        du * (R[i, 0, 0] - p * R[i, 2, 0]),
        du * (R[i, 0, 1] - p * R[i, 2, 1]),
        du * (R[i, 0, 2] - p * R[i, 2, 2]),
    )
    v0, v1, v2 = (
        dv * (R[i, 1, 0] - q * R[i, 2, 0]),
        dv * (R[i, 1, 1] - q * R[i, 2, 1]),
        dv * (R[i, 1, 2] - q * R[i, 2, 2]),
    )
    pull[0], pull[1], pull[2] = u0 * u + v0 * v, u1 * u + v1 * v, u2 * u + v2 * v
    blocks[k, 0], blocks[k, 1], blocks[k, 2] = u0 * u0 + v0 * v0, u0 * u1 + v0 * v1, u0 * u2 + v0 * v2
    blocks[k, 3], blocks[k, 4], blocks[k, 5] = u1 * u1 + v1 * v1, u1 * u2 + v1 * v2, u2 * u2 + v2 * v2


@kernel
def _distance(
    problem: FlatProblem,
    k: int,
    positions: FloatArray,
    points: FloatArray,
    frozen_positions: FloatArray,
    frozen_points: FloatArray,
    blocks: FloatArray,
    pull: FloatArray,
) -> None:
    """A'A and A'r of a distance, A by the landmark: the last row of equation (5)."""
    own = k - len(problem.seen_view)
    i, j, sigma = problem.ranged_view[own], problem.ranged_point[own], problem.range_sigma_m[own]
    x, y, z = _line(positions, i, points, j)
    residual = (np.sqrt(x * x + y * y + z * z) - problem.range_m[own]) / sigma
    x, y, z = _line(frozen_positions, i, frozen_points, j)
    length = np.sqrt(x * x + y * y + z * z) * sigma
    x, y, z = x / length, y / length, z / length
    pull[0], pull[1], pull[2] = x * residual, y * residual, z * residual
    blocks[k, 0], blocks[k, 1], blocks[k, 2] = x * x, x * y, x * z
    blocks[k, 3], blocks[k, 4], blocks[k, 5] = y * y, y * z, z * z


@kernel
def _add_motions(
    problem: FlatProblem, layout: FlatLayout, positions: FloatArray, kept: FloatArray, gradient: FloatArray
) -> None:
    """Add predicted motions."""
    for k in range(len(problem.motion_start)):
        a, b = layout.view_slot[problem.motion_start[k]], layout.view_slot[problem.motion_end[k]]
        for row in range(3):
            pull = 0.0
            for column in range(3):
                information = problem.motion_information[k, row, column]
                pull += information * _drift(problem, k, column, positions)
                if a >= 0:
                    add_entry(kept, layout.shape, a, row, a, column, information)
                if b >= 0:
                    add_entry(kept, layout.shape, b, row, b, column, information)
                if a >= 0 and b >= 0:
                    add_entry(kept, layout.shape, min(a, b), row, max(a, b), column, -information)
            if a >= 0:
                gradient[a, row] -= pull
            if b >= 0:
                gradient[b, row] += pull


@kernel
def _add_prior(
    problem: FlatProblem,
    layout: FlatLayout,
    positions: FloatArray,
    points: FloatArray,
    kept: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add the prior's quadratic."""
    slots = prior_slots(problem, layout.view_slot, layout.point_slot)
    offset = _prior_offset(problem, positions, points)
    for i in range(len(slots)):
        for row in range(3):
            pull = problem.prior_gradient[3 * i + row]
            for j in range(len(slots)):
                for column in range(3):
                    information = problem.prior_information[3 * i + row, 3 * j + column]
                    pull += information * offset[3 * j + column]
                    if slots[j] >= slots[i]:
                        add_entry(kept, layout.shape, slots[i], row, slots[j], column, information)
            gradient[slots[i], row] += pull
