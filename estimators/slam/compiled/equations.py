"""Normal equations of an adjustment: the sums of `estimators.slam.normal`, measurement by measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from boresight.estimators.slam.compiled import kernel
from boresight.estimators.slam.compiled.envelope import Envelope, add_entry, add_symmetric
from boresight.estimators.slam.compiled.problem import FlatOrdering, FlatProblem, prior_slots
from boresight.estimators.slam.compiled.residuals import (
    RESIDUAL_ROWS,
    evaluate_residuals,
    line_of_sight,
    motion_residual,
    prior_offset,
    prior_pull,
    to_camera_axes,
)

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class FlatEquations(NamedTuple):
    """Kept matrix and gradient (n, 3), sums by landmark (L, 9), and the terms of each measurement (m, 9).

    Nine numbers are a symmetric (3, 3) block as xx, xy, xz, yy, yz, zz and a gradient (3,).
    """

    kept: FloatArray
    kept_gradient: FloatArray
    eliminated: FloatArray
    terms: FloatArray


@kernel
def linearise(
    problem: FlatProblem, ordering: FlatOrdering, positions: FloatArray, points: FloatArray, residuals: FloatArray
) -> FlatEquations:
    """Return J' W J and J' W f of equation (3) by blocks, given the ``residuals`` at the same state."""
    shape, seen = ordering.shape, len(problem.seen_view)
    n = len(shape.reach)
    kept, kept_gradient = np.zeros(shape.begin[n]), np.zeros((n, 3))
    by_view, by_point = np.zeros((len(positions), 9)), np.zeros((len(points), 9))
    terms = measured_terms(problem, positions, points, residuals)
    sum_terms(terms, problem.seen_view, problem.seen_point, 0, by_view, by_point)
    sum_terms(terms, problem.ranged_view, problem.ranged_point, seen, by_view, by_point)
    # A depends on landmark minus camera position alone: A'A is the same for both ends of a measurement, and the
    # gradient by the view has the opposite sign.
    _scatter(by_view, ordering.view_slot, -1.0, shape, kept, kept_gradient)
    _scatter(by_point, ordering.point_slot, 1.0, shape, kept, kept_gradient)
    # Kept landmarks have slots after the views; without them the coupling is all with eliminated landmarks.
    if len(shape.reach) > ordering.views:
        _couple_kept_points(problem, ordering, terms, kept)
    _add_motions(problem, ordering, positions, kept, kept_gradient)
    if len(problem.prior_gradient) > 0:
        _add_prior(problem, ordering, positions, points, kept, kept_gradient)
    return FlatEquations(kept, kept_gradient, by_point, terms)


@kernel
def measured_terms(
    problem: FlatProblem, positions: FloatArray, points: FloatArray, residuals: FloatArray
) -> FloatArray:
    """(m, 9) A'A and A'r of each measurement, A by the landmark, given the ``residuals`` at the same state."""
    terms = np.empty((len(problem.seen_view) + len(problem.ranged_view), 9))
    frozen_positions = _merged(problem.frozen_positions_m, positions)
    frozen_points = _merged(problem.frozen_points_m, points)
    # First-estimates Jacobians: derivatives at the merged point, residuals at the present state.
    rows = _scaled(problem, residuals, frozen_positions, frozen_points)
    _pixel_terms(problem.attitudes, problem.seen_view, rows, terms)
    _distance_terms(problem, (positions, points, frozen_positions, frozen_points), terms)
    return terms


@kernel
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


@kernel
def _scaled(
    problem: FlatProblem, residuals: FloatArray, frozen_positions: FloatArray, frozen_points: FloatArray
) -> FloatArray:
    """(6, k) f_x / (z sigma), f_y / (z sigma), x / z, y / z at the linearisation point, and residuals u, v in sigma."""
    rows = np.empty_like(residuals)
    fx, fy, _, _ = problem.pinhole
    sigma_px, at = problem.seen_sigma_px, residuals
    # The residuals hold the landmarks in camera axes at the present state: they serve for the derivatives too unless
    # some variable is frozen.
    if len(problem.frozen_points_m) > 0 or len(problem.frozen_positions_m) > 0:
        at = np.empty((3, len(sigma_px)))
        to_camera_axes(problem.attitudes, problem.seen_view, problem.seen_point, frozen_positions, frozen_points, at)
    # All divisions of a pixel here, in rows, which vectorise; what remains in `_pixel_terms` are products.
    for k in range(len(sigma_px)):
        x, y, z, sigma = at[0, k], at[1, k], at[2, k], sigma_px[k]
        rows[0, k], rows[1, k], rows[2, k], rows[3, k] = fx / (z * sigma), fy / (z * sigma), x / z, y / z
        rows[4, k], rows[5, k] = residuals[3, k] / sigma, residuals[4, k] / sigma
    return rows


@kernel
def _pixel_terms(R: FloatArray, view: IndexArray, rows: FloatArray, terms: FloatArray) -> None:
    """Write A'A and A'r of all pixels, A by the landmark: du (R_0 - x/z R_2), dv (R_1 - y/z R_2), rows R_i of R."""
    for k in range(len(view)):
        i = view[k]
        du, dv, p, q, u, v = rows[0, k], rows[1, k], rows[2, k], rows[3, k], rows[4, k], rows[5, k]
        # d(x/z) by the landmark in body axes is (R_0 - (x/z) R_2) / z, since x = R_0 . line and z = R_2 . line.
        u0, v0 = du * (R[i, 0, 0] - p * R[i, 2, 0]), dv * (R[i, 1, 0] - q * R[i, 2, 0])
        u1, v1 = du * (R[i, 0, 1] - p * R[i, 2, 1]), dv * (R[i, 1, 1] - q * R[i, 2, 1])
        u2, v2 = du * (R[i, 0, 2] - p * R[i, 2, 2]), dv * (R[i, 1, 2] - q * R[i, 2, 2])
        terms[k, 0], terms[k, 1], terms[k, 2] = u0 * u0 + v0 * v0, u0 * u1 + v0 * v1, u0 * u2 + v0 * v2
        terms[k, 3], terms[k, 4], terms[k, 5] = u1 * u1 + v1 * v1, u1 * u2 + v1 * v2, u2 * u2 + v2 * v2
        terms[k, 6], terms[k, 7], terms[k, 8] = u0 * u + v0 * v, u1 * u + v1 * v, u2 * u + v2 * v


@kernel
def _distance_terms(
    problem: FlatProblem, at: tuple[FloatArray, FloatArray, FloatArray, FloatArray], terms: FloatArray
) -> None:
    """Write A'A and A'r of all distances, A by the landmark: the last row of equation (5).

    ``at`` are positions and landmarks, and those of the linearisation point.
    """
    positions, points, frozen_positions, frozen_points = at
    for own in range(len(problem.ranged_view)):
        i, j, sigma = problem.ranged_view[own], problem.ranged_point[own], problem.range_sigma_m[own]
        x, y, z = line_of_sight(positions, i, points, j)
        residual = (np.sqrt(x * x + y * y + z * z) - problem.range_m[own]) / sigma
        x, y, z = line_of_sight(frozen_positions, i, frozen_points, j)
        length = np.sqrt(x * x + y * y + z * z) * sigma
        # The derivative of a distance by the landmark is the unit line of sight.
        x, y, z = x / length, y / length, z / length
        k = len(problem.seen_view) + own
        terms[k, 0], terms[k, 1], terms[k, 2] = x * x, x * y, x * z
        terms[k, 3], terms[k, 4], terms[k, 5] = y * y, y * z, z * z
        terms[k, 6], terms[k, 7], terms[k, 8] = x * residual, y * residual, z * residual


@kernel
def sum_terms(
    terms: FloatArray, view: IndexArray, point: IndexArray, first: int, by_view: FloatArray, by_point: FloatArray
) -> None:
    """Add the terms of measurements, from row ``first`` on, to the sums of their views and landmarks."""
    # One pass in the order of the measurements: the order of addition, and so the rounding, is fixed.
    for k in range(len(view)):
        i, j = view[k], point[k]
        for entry in range(9):
            by_view[i, entry] += terms[first + k, entry]
            by_point[j, entry] += terms[first + k, entry]


@kernel
def _scatter(
    sums: FloatArray, slots: IndexArray, sign: float, shape: Envelope, kept: FloatArray, gradient: FloatArray
) -> None:
    """Add the sums of views or landmarks to the kept system; ``sign`` is that of the derivative."""
    for i in range(len(slots)):
        slot = slots[i]
        if slot >= 0:
            add_symmetric(kept, shape, slot, slot, sums, i, 1.0)
            for axis in range(3):
                gradient[slot, axis] += sign * sums[i, 6 + axis]


@kernel
def _couple_kept_points(problem: FlatProblem, ordering: FlatOrdering, terms: FloatArray, kept: FloatArray) -> None:
    """Add the coupling blocks between free views and kept landmarks."""
    seen = len(problem.seen_view)
    for k in range(len(terms)):
        i = problem.seen_view[k] if k < seen else problem.ranged_view[k - seen]
        j = problem.seen_point[k] if k < seen else problem.ranged_point[k - seen]
        a, b = ordering.view_slot[i], ordering.point_slot[j]
        if a >= 0 and b >= 0:
            # Opposite signs of the two derivatives; a view's slot is before that of any landmark, so a < b.
            add_symmetric(kept, ordering.shape, a, b, terms, k, -1.0)


@kernel
def _add_motions(
    problem: FlatProblem, ordering: FlatOrdering, positions: FloatArray, kept: FloatArray, gradient: FloatArray
) -> None:
    """Add the predicted motions to the kept system."""
    for k in range(len(problem.motion_start)):
        a, b = ordering.view_slot[problem.motion_start[k]], ordering.view_slot[problem.motion_end[k]]
        for row in range(3):
            pull = 0.0
            for column in range(3):
                information = problem.motion_information[k, row, column]
                # Weighted by the information matrix as it is: no square root of it is needed for J' W J and J' W f.
                pull += information * motion_residual(problem, k, column, positions)
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


@kernel
def _add_prior(
    problem: FlatProblem,
    ordering: FlatOrdering,
    positions: FloatArray,
    points: FloatArray,
    kept: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add the prior to the kept system."""
    slots, shape = prior_slots(problem, ordering.view_slot, ordering.point_slot), ordering.shape
    # Gradient of (x - x0)' H (x - x0) / 2 + g' (x - x0): H (x - x0) + g.
    pull = prior_pull(problem.prior_information, prior_offset(problem, positions, points), problem.prior_gradient)
    for i in range(len(slots)):
        a = slots[i]
        for row in range(3):
            gradient[a, row] += pull[3 * i + row]
            information = problem.prior_information[3 * i + row]
            begin = shape.begin[a] + row * shape.width[a] - 3 * a
            for j in range(len(slots)):
                if slots[j] >= a:
                    for column in range(3):
                        kept[begin + 3 * slots[j] + column] += information[3 * j + column]


@kernel
def residual_squares(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> FloatArray:
    """(k,) squared pixel residuals in standard deviations; NaN where a landmark is behind its camera."""
    residuals = np.empty((RESIDUAL_ROWS, len(problem.seen_view)))
    # Fills all rows, even where the cost is infinite because a landmark is behind its camera.
    evaluate_residuals(problem, positions, points, residuals)
    return np.where(residuals[2] > 0.0, residuals[5], np.nan)


@kernel
def landmark_information(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> FloatArray:
    """(L, 3, 3) sum of A'A of each landmark over its pixels and distances, 1/m^2."""
    residuals = np.empty((RESIDUAL_ROWS, len(problem.seen_view)))
    evaluate_residuals(problem, positions, points, residuals)
    # The sums by view are not needed here.
    terms = measured_terms(problem, positions, points, residuals)
    by_view, by_point = np.zeros((len(positions), 9)), np.zeros((len(points), 9))
    sum_terms(terms, problem.seen_view, problem.seen_point, 0, by_view, by_point)
    sum_terms(terms, problem.ranged_view, problem.ranged_point, len(problem.seen_view), by_view, by_point)
    information = np.empty((len(points), 3, 3))
    for j in range(len(points)):
        for row, entry in ((0, 0), (1, 3), (2, 5)):
            information[j, row, row] = by_point[j, entry]
        information[j, 0, 1] = information[j, 1, 0] = by_point[j, 1]
        information[j, 0, 2] = information[j, 2, 0] = by_point[j, 2]
        information[j, 1, 2] = information[j, 2, 1] = by_point[j, 4]
    return information


@kernel
def pixel_squares(
    pinhole: FloatArray, R: FloatArray, lines: FloatArray, uv_px: FloatArray, sigma_px: float, own: FloatArray
) -> FloatArray:
    """(n,) squared Mahalanobis distances of measured from predicted pixels; NaN behind the camera.

    ``lines`` (n, 3) are landmark minus camera, body frame, with covariances ``own`` (n, 3, 3), m^2.
    """
    fx, fy, cx, cy = pinhole
    squares = np.empty(len(lines))
    for k in range(len(lines)):
        line_of_sight = lines[k]
        # For behind-camera landmarks the values have no meaning and are replaced by NaN at the end.
        x = R[0, 0] * line_of_sight[0] + R[0, 1] * line_of_sight[1] + R[0, 2] * line_of_sight[2]
        y = R[1, 0] * line_of_sight[0] + R[1, 1] * line_of_sight[1] + R[1, 2] * line_of_sight[2]
        z = R[2, 0] * line_of_sight[0] + R[2, 1] * line_of_sight[1] + R[2, 2] * line_of_sight[2]
        u, v = uv_px[k, 0] - fx * x / z - cx, uv_px[k, 1] - fy * y / z - cy
        # Innovation covariance [[a, b], [b, c]] = H P H' + sigma^2 I.
        a = c = sigma_px**2
        b = 0.0
        for i in range(3):
            by_u, by_v = fx / z * (R[0, i] - x / z * R[2, i]), fy / z * (R[1, i] - y / z * R[2, i])
            for j in range(3):
                other_u, other_v = fx / z * (R[0, j] - x / z * R[2, j]), fy / z * (R[1, j] - y / z * R[2, j])
                a += by_u * own[k, i, j] * other_u
                b += by_u * own[k, i, j] * other_v
                c += by_v * own[k, i, j] * other_v
        # Inverse of a 2 x 2 matrix in closed form; the floor guards against a determinant of zero by rounding.
        square = (c * u * u - 2.0 * b * u * v + a * v * v) / max(a * c - b * b, 1e-18)
        squares[k] = square if z > 0.0 else np.nan
    return squares
