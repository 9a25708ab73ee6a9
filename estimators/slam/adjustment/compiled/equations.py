"""Cost and normal equations of an adjustment at a state, in one pass over its landmarks."""

from __future__ import annotations

import numpy as np

from boresight.estimators.slam.adjustment.compiled import inner, kernel
from boresight.estimators.slam.adjustment.compiled.correlated import (
    add_correlated_pixels,
    add_symmetric_terms,
    couple_kept_points,
)
from boresight.estimators.slam.adjustment.compiled.envelope import add_entry, add_symmetric
from boresight.estimators.slam.adjustment.compiled.problem import (
    LANES,
    FlatEquations,
    FlatOrdering,
    FlatProblem,
    Places,
    prior_slots,
)
from boresight.scenarios.arrays import FloatArray, IndexArray

Block = tuple[float, float, float, float, float, float]


@kernel
def linearise(
    problem: FlatProblem, ordering: FlatOrdering, positions: FloatArray, points: FloatArray
) -> tuple[float, FlatEquations]:
    """Return the cost, and J' W J and J' W f of equation (3) by blocks.

    The cost is half the sum of squares, equation (2), plus the prior; inf with a landmark behind its camera.
    """
    shape = ordering.shape
    n = len(shape.reach)
    kept, kept_gradient = np.zeros(shape.begin[n]), np.zeros((n, 3))
    by_view, by_point = np.zeros((len(positions), 9 * LANES)), np.zeros((len(ordering.begin) - 1, 9 * LANES))
    system = FlatEquations(kept, kept_gradient, by_point, np.empty((len(ordering.pixels), 9 * LANES)))
    # First-estimates Jacobians: derivatives at the merged point, residuals at the present state.
    at = positions, points, _merged(problem.frozen_positions_m, positions), _merged(problem.frozen_points_m, points)
    terms = system.terms
    if ordering.correlated:
        total, terms = add_correlated_pixels(problem, ordering, at, system), np.zeros_like(system.terms)
    else:
        total = _add_pixels(problem, ordering, at, by_view, system)
    if len(problem.ranged_view) > 0:
        measured = problem.ranged_view, problem.ranged_point, problem.range_m, problem.range_sigma_m
        place = ordering.group, ordering.lane, ordering.offset
        total += _add_distances(measured, at, place, (terms, by_point, by_view))
    _add_sums(ordering, by_view, system)
    if ordering.correlated:
        add_symmetric_terms(system.terms, terms)
    # Kept landmarks have slots after the views; without them the coupling is all with eliminated landmarks.
    if n > ordering.views and ordering.correlated:
        couple_kept_points(ordering, system.kept, system.terms)
    elif n > ordering.views:
        _couple_kept_points(ordering, system)
    if len(problem.motion_start) > 0:
        total += _add_motions(problem, ordering, positions, kept, kept_gradient)
    # Half of equation (2), whose gradient is J' W f without a factor of 2.
    half = 0.5 * total
    if len(problem.prior_gradient) > 0:
        half += _add_prior(problem, ordering, positions, points, kept, kept_gradient)
    return (half if np.isfinite(half) else np.inf), system


@inner
def _merged(frozen: FloatArray, present: FloatArray) -> FloatArray:
    """Return the points of linearisation: the frozen values where there are any, else the present ones."""
    # No copy without frozen values: the usual case of BA-SLAM.
    if len(frozen) == 0:
        return present
    merged = np.empty_like(present)
    for i in range(len(present)):
        for axis in range(3):
            merged[i, axis] = present[i, axis] if np.isnan(frozen[i, axis]) else frozen[i, axis]
    return merged


@inner
def _add_pixels(
    problem: FlatProblem,
    ordering: FlatOrdering,
    at: Places,
    by_view: FloatArray,
    system: FlatEquations,
) -> float:
    """Write the terms of all cells, add them to the sums, and return the sum of squares; inf behind a camera.

    ``at`` are positions and landmarks, and those of the linearisation point.
    """
    frozen = len(problem.frozen_points_m) > 0 or len(problem.frozen_positions_m) > 0
    positions, points, frozen_positions, frozen_points = at
    R, pixels, terms, by_point = problem.attitudes, ordering.pixels, system.terms, system.by_point
    fx, fy, cx, cy = problem.pinhole
    lanes = pixels.shape[1] // 3
    here, there = np.empty(3 * LANES), np.empty(3 * LANES)
    # Rows: x / z, y / z in camera axes; 1 / (z sigma); residuals u, v in sigma; sum of squares, landmarks behind.
    seen = np.zeros((1, 7 * LANES))
    for g in range(len(ordering.begin) - 1):
        _gather(points, ordering.landmark, g, here)
        _gather(frozen_points, ordering.landmark, g, there)
        for cell in range(ordering.begin[g], ordering.begin[g + 1]):
            i = cell + ordering.offset[g]
            r00, r01, r02, r10, r11, r12 = R[i, 0, 0], R[i, 0, 1], R[i, 0, 2], R[i, 1, 0], R[i, 1, 1], R[i, 1, 2]
            r20, r21, r22 = R[i, 2, 0], R[i, 2, 1], R[i, 2, 2]
            ox, oy, oz = positions[i, 0], positions[i, 1], positions[i, 2]
            for k in range(lanes):
                x, y, z = here[k] - ox, here[LANES + k] - oy, here[2 * LANES + k] - oz
                weight = pixels[cell, 2 * LANES + k]
                # A lane without a pixel has depth 1.
                depth = r20 * x + r21 * y + r22 * z if weight != 0.0 else 1.0
                over = 1.0 / depth
                p, q = (r00 * x + r01 * y + r02 * z) * over, (r10 * x + r11 * y + r12 * z) * over
                # Predicted minus measured: f(x) of equations (3) and (4), where the paper's equation (2) has y - f(x).
                u = (fx * p + cx - pixels[cell, k]) * weight
                v = (fy * q + cy - pixels[cell, LANES + k]) * weight
                seen[0, k], seen[0, LANES + k], seen[0, 2 * LANES + k] = p, q, over * weight
                seen[0, 3 * LANES + k], seen[0, 4 * LANES + k] = u, v
                seen[0, 5 * LANES + k] += u * u + v * v
                # NaN is not positive.
                seen[0, 6 * LANES + k] += 0.0 if depth > 0.0 else 1.0
            if frozen:
                ox, oy, oz = frozen_positions[i, 0], frozen_positions[i, 1], frozen_positions[i, 2]
                for k in range(lanes):
                    x, y, z = there[k] - ox, there[LANES + k] - oy, there[2 * LANES + k] - oz
                    weight = pixels[cell, 2 * LANES + k]
                    over = 1.0 / (r20 * x + r21 * y + r22 * z if weight != 0.0 else 1.0)
                    seen[0, k], seen[0, LANES + k] = (
                        (r00 * x + r01 * y + r02 * z) * over,
                        (r10 * x + r11 * y + r12 * z) * over,
                    )
                    seen[0, 2 * LANES + k] = over * weight
            for k in range(lanes):
                # d(x/z) by the landmark in body axes is (R_0 - (x/z) R_2) / z, since x = R_0 . line and z = R_2 . line.
                p, q, u, v = seen[0, k], seen[0, LANES + k], seen[0, 3 * LANES + k], seen[0, 4 * LANES + k]
                du, dv = fx * seen[0, 2 * LANES + k], fy * seen[0, 2 * LANES + k]
                u0, v0 = du * (r00 - p * r20), dv * (r10 - q * r20)
                u1, v1 = du * (r01 - p * r21), dv * (r11 - q * r21)
                u2, v2 = du * (r02 - p * r22), dv * (r12 - q * r22)
                terms[cell, k], terms[cell, LANES + k] = u0 * u0 + v0 * v0, u0 * u1 + v0 * v1
                terms[cell, 2 * LANES + k], terms[cell, 3 * LANES + k] = u0 * u2 + v0 * v2, u1 * u1 + v1 * v1
                terms[cell, 4 * LANES + k], terms[cell, 5 * LANES + k] = u1 * u2 + v1 * v2, u2 * u2 + v2 * v2
                terms[cell, 6 * LANES + k], terms[cell, 7 * LANES + k] = u0 * u + v0 * v, u1 * u + v1 * v
                terms[cell, 8 * LANES + k] = u2 * u + v2 * v
            for k in range(9 * LANES):
                by_view[i, k] += terms[cell, k]
                by_point[g, k] += terms[cell, k]
    total = lane_sum(seen, 0, 5)
    # A landmark behind its camera may project to its pixel too: an infinite cost makes the solver reject the step.
    return total if lane_sum(seen, 0, 6) == 0.0 else np.inf


@inner
def _gather(points: FloatArray, landmark: IndexArray, g: int, lanes: FloatArray) -> None:
    """Write the coordinates of a group's landmarks to its lanes; zeros to the empty ones."""
    for lane in range(LANES):
        j = landmark[g, lane]
        for axis in range(3):
            lanes[axis * LANES + lane] = points[j, axis] if j >= 0 else 0.0


@inner
def lane_sum(values: FloatArray, g: int, row: int) -> float:
    """Return the sum of the lanes of one number, in a fixed order."""
    total = 0.0
    for k in range(row * LANES, (row + 1) * LANES):
        total += values[g, k]
    return total


@inner
def six(values: FloatArray, g: int, lane: int) -> Block:
    """Return the symmetric block xx, xy, xz, yy, yz, zz of a lane."""
    return (
        values[g, lane],
        values[g, LANES + lane],
        values[g, 2 * LANES + lane],
        values[g, 3 * LANES + lane],
        values[g, 4 * LANES + lane],
        values[g, 5 * LANES + lane],
    )


@inner
def _add_distances(
    measured: tuple[IndexArray, IndexArray, FloatArray, FloatArray],
    at: Places,
    place: tuple[IndexArray, IndexArray, IndexArray],
    sums: tuple[FloatArray, FloatArray, FloatArray],
) -> float:
    """Add A'A and A'r of all distances to their cells and sums; return the sum of squares: the last row of eq. (5).

    ``measured`` are views, landmarks, distances and sigmas, ``at`` as in `_add_pixels`, ``place`` group, lane and
    offset of a `FlatOrdering`, ``sums`` by cell, by landmark and by view.
    """
    positions, points, frozen_positions, frozen_points = at
    (view, point, range_m, sigma_m), (group, lane, offset), (terms, by_point, by_view) = measured, place, sums
    total = 0.0
    for k in range(len(view)):
        i, j = view[k], point[k]
        x, y, z = _line_of_sight(positions, i, points, j)
        residual = (np.sqrt(x * x + y * y + z * z) - range_m[k]) / sigma_m[k]
        total += residual * residual
        x, y, z = _line_of_sight(frozen_positions, i, frozen_points, j)
        length = np.sqrt(x * x + y * y + z * z) * sigma_m[k]
        # The derivative of a distance by the landmark is the unit line of sight.
        x, y, z = x / length, y / length, z / length
        added = x * x, x * y, x * z, y * y, y * z, z * z, x * residual, y * residual, z * residual
        for entry in range(9):
            own = entry * LANES + lane[j]
            terms[i - offset[group[j]], own] += added[entry]
            by_point[group[j], own] += added[entry]
            by_view[i, own] += added[entry]
    return total


@inner
def _line_of_sight(positions: FloatArray, i: int, points: FloatArray, j: int) -> tuple[float, float, float]:
    """Return landmark minus camera position, body axes, m."""
    return points[j, 0] - positions[i, 0], points[j, 1] - positions[i, 1], points[j, 2] - positions[i, 2]


@inner
def _add_sums(ordering: FlatOrdering, by_view: FloatArray, system: FlatEquations) -> None:
    """Add the sums of the free views and the kept landmarks to the kept system."""
    # A depends on landmark minus camera position alone: A'A is the same for both ends of a measurement, and the
    # gradient by the view has the opposite sign.
    for i in range(len(by_view)):
        slot = ordering.view_slot[i]
        if slot >= 0:
            for entry in range(9):
                by_view[i, entry * LANES] = lane_sum(by_view, i, entry)
            add_symmetric(system.kept, ordering.shape, slot, slot, six(by_view, i, 0), 1.0)
            for axis in range(3):
                system.kept_gradient[slot, axis] -= by_view[i, (6 + axis) * LANES]
    for j in range(len(ordering.point_slot)):
        slot = ordering.point_slot[j]
        if slot >= 0:
            g, lane = ordering.group[j], ordering.lane[j]
            add_symmetric(system.kept, ordering.shape, slot, slot, six(system.by_point, g, lane), 1.0)
            for axis in range(3):
                system.kept_gradient[slot, axis] += system.by_point[g, (6 + axis) * LANES + lane]


@inner
def _couple_kept_points(ordering: FlatOrdering, system: FlatEquations) -> None:
    """Add the coupling blocks between free views and kept landmarks."""
    for g in range(ordering.eliminated, len(ordering.begin) - 1):
        for cell in range(ordering.begin[g], ordering.begin[g + 1]):
            a = ordering.view_slot[cell + ordering.offset[g]]
            for lane in range(LANES):
                j = ordering.landmark[g, lane]
                if a >= 0 and j >= 0 and ordering.point_slot[j] >= 0:
                    # Opposite signs of the two derivatives; a view's slot is before that of any landmark.
                    block = six(system.terms, cell, lane)
                    add_symmetric(system.kept, ordering.shape, a, ordering.point_slot[j], block, -1.0)


@inner
def _add_motions(
    problem: FlatProblem, ordering: FlatOrdering, positions: FloatArray, kept: FloatArray, gradient: FloatArray
) -> float:
    """Add the predicted motions to the kept system; return their part of the sum of squares."""
    total = 0.0
    for k in range(len(problem.motion_start)):
        start, end = problem.motion_start[k], problem.motion_end[k]
        a, b = ordering.view_slot[start], ordering.view_slot[end]
        x = positions[end, 0] - positions[start, 0] - problem.motion_m[k, 0]
        y = positions[end, 1] - positions[start, 1] - problem.motion_m[k, 1]
        z = positions[end, 2] - positions[start, 2] - problem.motion_m[k, 2]
        residual = x, y, z
        for row in range(3):
            pull = 0.0
            for column in range(3):
                information = problem.motion_information[k, row, column]
                # Weighted by the information matrix as it is: no square root of it is needed for J' W J and J' W f.
                pull += information * residual[column]
                if a >= 0:
                    add_entry(kept, ordering.shape, a, row, a, column, information)
                if b >= 0:
                    add_entry(kept, ordering.shape, b, row, b, column, information)
                if a >= 0 and b >= 0:
                    # The matrix is symmetric, so that the block need not be transposed where b < a.
                    add_entry(kept, ordering.shape, min(a, b), row, max(a, b), column, -information)
            if a >= 0:
                gradient[a, row] -= pull
            if b >= 0:
                gradient[b, row] += pull
            total += residual[row] * pull
    return total


@inner
def _add_prior(
    problem: FlatProblem,
    ordering: FlatOrdering,
    positions: FloatArray,
    points: FloatArray,
    kept: FloatArray,
    gradient: FloatArray,
) -> float:
    """Add the prior to the kept system; return its cost, which may be negative."""
    slots, shape = prior_slots(problem, ordering.view_slot, ordering.point_slot), ordering.shape
    views, offset = len(problem.prior_views), np.empty(3 * len(slots))
    for k in range(len(slots)):
        present = positions[problem.prior_views[k]] if k < views else points[problem.prior_points[k - views]]
        for axis in range(3):
            offset[3 * k + axis] = present[axis] - problem.prior_origin_m[k, axis]
    # Gradient of (x - x0)' H (x - x0) / 2 + g' (x - x0): H (x - x0) + g.
    pull, total = np.zeros(len(offset)), 0.0
    for k in range(len(offset)):
        # H is symmetric: its rows serve as columns, which the compiler can vectorise.
        information, step = problem.prior_information[k], offset[k]
        for i in range(len(offset)):
            pull[i] += information[i] * step
    for i in range(len(slots)):
        a = slots[i]
        for row in range(3):
            own = 3 * i + row
            information = problem.prior_information[own]
            gradient[a, row] += pull[own] + problem.prior_gradient[own]
            total += offset[own] * (0.5 * pull[own] + problem.prior_gradient[own])
            begin = shape.begin[a] + row * shape.width[a] - 3 * a
            for j in range(len(slots)):
                if slots[j] >= a:
                    for column in range(3):
                        kept[begin + 3 * slots[j] + column] += information[3 * j + column]
    return total
