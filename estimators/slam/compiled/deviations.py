"""How far pixels lie off, and what the measurements of an adjustment tell of each landmark."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.slam.compiled.equations import measured_terms, sum_terms
from estimators.slam.compiled.flat import FlatProblem
from estimators.slam.compiled.jit import kernel
from estimators.slam.compiled.sight import SIGHT_ROWS, look

FloatArray = NDArray[np.float64]


@kernel
def sighting_squares(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> FloatArray:
    """(k,) squared residuals of the sightings in sigma; NaN where a landmark is behind its camera."""
    sights = np.empty((SIGHT_ROWS, len(problem.seen_view)))
    look(problem, positions, points, sights)
    return np.where(sights[2] > 0.0, sights[5], np.nan)


@kernel
def landmark_information(problem: FlatProblem, positions: FloatArray, points: FloatArray) -> FloatArray:
    """(L, 3, 3) A'A of each landmark over its sightings and distances, 1/m^2."""
    sights = np.empty((SIGHT_ROWS, len(problem.seen_view)))
    look(problem, positions, points, sights)
    terms = measured_terms(problem, positions, points, sights)
    by_view, by_point = np.zeros((len(positions), 9)), np.zeros((len(points), 9))
    sum_terms(terms, problem.seen_view, problem.seen_point, 0, by_view, by_point)
    sum_terms(terms, problem.ranged_view, problem.ranged_point, len(problem.seen_view), by_view, by_point)
    told = np.empty((len(points), 3, 3))
    for j in range(len(points)):
        told[j, 0, 0], told[j, 1, 1], told[j, 2, 2] = by_point[j, 0], by_point[j, 3], by_point[j, 5]
        told[j, 0, 1] = told[j, 1, 0] = by_point[j, 1]
        told[j, 0, 2] = told[j, 2, 0] = by_point[j, 2]
        told[j, 1, 2] = told[j, 2, 1] = by_point[j, 4]
    return told


@kernel
def pixel_squares(
    pinhole: FloatArray, R: FloatArray, lines: FloatArray, uv_px: FloatArray, sigma_px: float, own: FloatArray
) -> FloatArray:
    """(n,) squared Mahalanobis distances of pixels from where landmarks are seen; NaN behind the camera.

    ``lines`` (n, 3) go from the camera to the landmarks, body frame, and have the covariances ``own`` (n, 3, 3), m^2.
    """
    fx, fy, cx, cy = pinhole
    squares = np.empty(len(lines))
    for k in range(len(lines)):
        line = lines[k]
        x = R[0, 0] * line[0] + R[0, 1] * line[1] + R[0, 2] * line[2]
        y = R[1, 0] * line[0] + R[1, 1] * line[1] + R[1, 2] * line[2]
        z = R[2, 0] * line[0] + R[2, 1] * line[1] + R[2, 2] * line[2]
        u, v = uv_px[k, 0] - fx * x / z - cx, uv_px[k, 1] - fy * y / z - cy
        a = c = sigma_px**2
        b = 0.0
        for i in range(3):
            by_u, by_v = fx / z * (R[0, i] - x / z * R[2, i]), fy / z * (R[1, i] - y / z * R[2, i])
            for j in range(3):
                other_u, other_v = fx / z * (R[0, j] - x / z * R[2, j]), fy / z * (R[1, j] - y / z * R[2, j])
                a += by_u * own[k, i, j] * other_u
                b += by_u * own[k, i, j] * other_v
                c += by_v * own[k, i, j] * other_v
        square = (c * u * u - 2.0 * b * u * v + a * v * v) / max(a * c - b * b, 1e-18)
        squares[k] = square if z > 0.0 else np.nan
    return squares
