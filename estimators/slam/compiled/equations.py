"""Cost and normal equations of an adjustment: the same sums as `residuals` and `normal`, measurement by measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.envelope import Envelope, add_block, make_envelope
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class FlatLayout(NamedTuple):
    """Slots of the variables as in `Layout`, the envelope of the reduced matrix, and the links by eliminated landmark.

    Parameters
    ----------
    link_begin
        (e + 1,): where the links of each eliminated landmark begin.
    link
        (m,): the measurements that join a free view with an eliminated landmark; sightings first, then distances.
    link_slot
        (m,): the kept slots of their views.
    """

    view_slot: IndexArray
    point_slot: IndexArray
    gone_slot: IndexArray
    shape: Envelope
    link_begin: IndexArray
    link: IndexArray
    link_slot: IndexArray


class FlatEquations(NamedTuple):
    """Kept matrix and gradient (n, 3), eliminated (e, 3, 3) and (e, 3), A'A of measurements (m, 3, 3)."""

    kept: FloatArray
    kept_gradient: FloatArray
    gone: FloatArray
    gone_gradient: FloatArray
    blocks: FloatArray


@kernel
def make_layout(problem: FlatProblem) -> FlatLayout:
    """Give the variables their slots and find which eliminated landmark joins which views."""
    views, points = len(problem.free_views), len(problem.free_points)
    view, kept_point = np.full(views, -1), np.full(points, -1)
    gone_point = np.full(points, -1)
    joined = problem.kept_points.copy()
    for point in problem.prior_points:
        joined[point] = True
    kept = gone = 0
    for i in range(views):
        if problem.free_views[i]:
            view[i] = kept
            kept += 1
    for j in range(points):
        if problem.free_points[j] and joined[j]:
            kept_point[j] = kept
            kept += 1
        elif problem.free_points[j]:
            gone_point[j] = gone
            gone += 1
    begin, link, slot = _links(problem, view, gone_point, gone)
    shape = make_envelope(_reach(problem, view, kept_point, kept, begin, slot))
    return FlatLayout(view, kept_point, gone_point, shape, begin, link, slot)


@kernel
def _links(
    problem: FlatProblem, view: IndexArray, gone_point: IndexArray, gone: int
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Sort the measurements of eliminated landmarks by landmark."""
    seen = len(problem.seen_view)
    count = seen + len(problem.ranged_view)
    begin = np.zeros(gone + 2, np.int64)
    for k in range(count):
        i, j = _ends(problem, k, seen)
        if view[i] >= 0 and gone_point[j] >= 0:
            begin[gone_point[j] + 2] += 1
    begin = np.cumsum(begin)
    link, slot = np.empty(begin[-1], np.int64), np.empty(begin[-1], np.int64)
    for k in range(count):
        i, j = _ends(problem, k, seen)
        if view[i] >= 0 and gone_point[j] >= 0:
            place = begin[gone_point[j] + 1]
            link[place], slot[place] = k, view[i]
            begin[gone_point[j] + 1] += 1
    return begin[:-1].copy(), link, slot


@kernel
def _ends(problem: FlatProblem, k: int, seen: int) -> tuple[int, int]:
    """View and landmark of a measurement: sightings first, then distances."""
    if k < seen:
        return problem.seen_view[k], problem.seen_point[k]
    return problem.ranged_view[k - seen], problem.ranged_point[k - seen]


@kernel
def _reach(
    problem: FlatProblem, view: IndexArray, kept_point: IndexArray, kept: int, begin: IndexArray, slot: IndexArray
) -> IndexArray:
    """Last kept variable that each is coupled with, by a measurement, an eliminated landmark or the prior."""
    reach = np.arange(kept)
    for group in range(len(begin) - 1):
        slots = slot[begin[group] : begin[group + 1]]
        if len(slots) > 0:
            first = slots.min()
            reach[first] = max(reach[first], slots.max())
    seen = len(problem.seen_view)
    for k in range(seen + len(problem.ranged_view)):
        i, j = _ends(problem, k, seen)
        if view[i] >= 0:
            reach[view[i]] = max(reach[view[i]], kept_point[j])
    for k in range(len(problem.motion_start)):
        start, end = view[problem.motion_start[k]], view[problem.motion_end[k]]
        if start >= 0 and end >= 0:
            reach[min(start, end)] = max(reach[min(start, end)], start, end)
    slots = prior_slots(problem, view, kept_point)
    if len(slots) > 0:
        reach[slots.min()] = max(reach[slots.min()], slots.max())
    return reach


@kernel
def prior_slots(problem: FlatProblem, view: IndexArray, kept_point: IndexArray) -> IndexArray:
    """Return the slots (a + b,) of the variables of the prior."""
    return np.concatenate((view[problem.prior_views], kept_point[problem.prior_points]))


@kernel
def cost(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> float:
    """Half the sum of squares, equation (2), with the prior's quadratic; inf with a landmark behind its camera."""
    fx, fy, cx, cy = problem.pinhole
    total = 0.0
    for k in range(len(problem.seen_view)):
        x, y, z = _in_camera(problem.attitudes[problem.seen_view[k]], positions[problem.seen_view[k]],
                             points[problem.seen_point[k]])  # fmt: skip
        if not z > 0.0:
            return np.inf
        u = fx * x / z + cx - problem.seen_px[k, 0]
        v = fy * y / z + cy - problem.seen_px[k, 1]
        total += (u * u + v * v) / problem.seen_sigma_px[k] ** 2
    for k in range(len(problem.ranged_view)):
        line = points[problem.ranged_point[k]] - positions[problem.ranged_view[k]]
        length = np.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2)
        total += ((length - problem.range_m[k]) / problem.range_sigma_m[k]) ** 2
    for k in range(len(problem.motion_start)):
        step = positions[problem.motion_end[k]] - positions[problem.motion_start[k]] - problem.motion_m[k]
        for i in range(3):
            for j in range(3):
                total += step[i] * problem.motion_information[k, i, j] * step[j]
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
def _in_camera(R: FloatArray, position: FloatArray, point: FloatArray) -> tuple[float, float, float]:
    """Return a landmark in the axes of a camera."""
    a, b, c = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    return (
        R[0, 0] * a + R[0, 1] * b + R[0, 2] * c,
        R[1, 0] * a + R[1, 1] * b + R[1, 2] * c,
        R[2, 0] * a + R[2, 1] * b + R[2, 2] * c,
    )


@kernel
def linearise(problem: FlatProblem, layout: FlatLayout, positions: FloatArray, points: FloatArray) -> FlatEquations:
    """Return J' W J and J' W f of equation (3) by blocks."""
    seen = len(problem.seen_view)
    count = seen + len(problem.ranged_view)
    n, e = len(layout.shape.reach), len(layout.link_begin) - 1
    kept, kept_gradient = np.zeros(layout.shape.begin[-1]), np.zeros((n, 3))
    gone, gone_gradient = np.zeros((e, 3, 3)), np.zeros((e, 3))
    blocks, pull = np.empty((count, 3, 3)), np.empty(3)
    for k in range(count):
        i, j = _ends(problem, k, seen)
        if k < seen:
            _sighting(problem, k, positions, points, blocks[k], pull)
        else:
            _distance(problem, k - seen, positions, points, blocks[k], pull)
        a, b, g = layout.view_slot[i], layout.point_slot[j], layout.gone_slot[j]
        if a >= 0:
            add_block(kept, layout.shape, a, a, blocks[k], 1.0)
            kept_gradient[a] -= pull
        if b >= 0:
            add_block(kept, layout.shape, b, b, blocks[k], 1.0)
            kept_gradient[b] += pull
        if a >= 0 and b >= 0:
            add_block(kept, layout.shape, a, b, blocks[k], -1.0)
        if g >= 0:
            gone[g] += blocks[k]
            gone_gradient[g] += pull
    _add_motions(problem, layout, positions, kept, kept_gradient)
    _add_prior(problem, layout, positions, points, kept, kept_gradient)
    return FlatEquations(kept, kept_gradient, gone, gone_gradient, blocks)


@kernel
def _sighting(
    problem: FlatProblem, k: int, positions: FloatArray, points: FloatArray, block: FloatArray, pull: FloatArray
) -> None:
    """A'A and A'r of a sighting, A by the landmark."""
    fx, fy, cx, cy = problem.pinhole
    i, j = problem.seen_view[k], problem.seen_point[k]
    R, sigma = problem.attitudes[i], problem.seen_sigma_px[k]
    x, y, z = _in_camera(R, positions[i], points[j])
    u = (fx * x / z + cx - problem.seen_px[k, 0]) / sigma
    v = (fy * y / z + cy - problem.seen_px[k, 1]) / sigma
    x, y, z = _in_camera(R, _position_of_derivative(problem, positions, i), _point_of_derivative(problem, points, j))
    du, dv = fx / (z * sigma), fy / (z * sigma)
    row_u, row_v = np.empty(3), np.empty(3)
    for axis in range(3):
        row_u[axis] = du * (R[0, axis] - x / z * R[2, axis])
        row_v[axis] = dv * (R[1, axis] - y / z * R[2, axis])
    for row in range(3):
        pull[row] = row_u[row] * u + row_v[row] * v
        for column in range(3):
            block[row, column] = row_u[row] * row_u[column] + row_v[row] * row_v[column]


@kernel
def _distance(
    problem: FlatProblem, k: int, positions: FloatArray, points: FloatArray, block: FloatArray, pull: FloatArray
) -> None:
    """A'A and A'r of a distance, A by the landmark: the last row of equation (5)."""
    i, j, sigma = problem.ranged_view[k], problem.ranged_point[k], problem.range_sigma_m[k]
    line = points[j] - positions[i]
    residual = (np.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2) - problem.range_m[k]) / sigma
    line = _point_of_derivative(problem, points, j) - _position_of_derivative(problem, positions, i)
    line /= np.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2) * sigma
    for row in range(3):
        pull[row] = line[row] * residual
        for column in range(3):
            block[row, column] = line[row] * line[column]


@kernel
def _position_of_derivative(problem: FlatProblem, positions: FloatArray, i: int) -> FloatArray:
    """Return where derivatives by a view are taken."""
    frozen = problem.frozen_positions_m
    where: FloatArray = frozen[i] if len(frozen) > 0 and not np.isnan(frozen[i, 0]) else positions[i]
    return where


@kernel
def _point_of_derivative(problem: FlatProblem, points: FloatArray, j: int) -> FloatArray:
    """Return where derivatives by a landmark are taken."""
    frozen = problem.frozen_points_m
    where: FloatArray = frozen[j] if len(frozen) > 0 and not np.isnan(frozen[j, 0]) else points[j]
    return where


@kernel
def _add_motions(
    problem: FlatProblem, layout: FlatLayout, positions: FloatArray, kept: FloatArray, gradient: FloatArray
) -> None:
    """Add predicted motions."""
    for k in range(len(problem.motion_start)):
        information = problem.motion_information[k]
        start, end = problem.motion_start[k], problem.motion_end[k]
        step = positions[end] - positions[start] - problem.motion_m[k]
        a, b = layout.view_slot[start], layout.view_slot[end]
        for row in range(3):
            pull = 0.0
            for column in range(3):
                pull += information[row, column] * step[column]
            if a >= 0:
                gradient[a, row] -= pull
            if b >= 0:
                gradient[b, row] += pull
        if a >= 0:
            add_block(kept, layout.shape, a, a, information, 1.0)
        if b >= 0:
            add_block(kept, layout.shape, b, b, information, 1.0)
        if a >= 0 and b >= 0:
            add_block(kept, layout.shape, min(a, b), max(a, b), information, -1.0)


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
            for j in range(len(offset)):
                pull += problem.prior_information[3 * i + row, j] * offset[j]
            gradient[slots[i], row] += pull
        for j in range(len(slots)):
            if slots[j] >= slots[i]:
                block = problem.prior_information[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
                add_block(kept, layout.shape, slots[i], slots[j], block, 1.0)
