"""Triangulation from lines of sight: exact points, scipy's least squares, and the covariance of drawn lines."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from boresight.scenarios.geometry.triangulation import LinesOfSight, triangulation_equations

NO_PRIOR = np.zeros((2, 3, 3)), np.zeros((2, 3))


def lines_to(points: np.ndarray, rows: np.ndarray, rng: np.random.Generator) -> LinesOfSight:
    """Aim a line from a random place at each point."""
    origins = rng.normal(0.0, 1000.0, (len(rows), 3))
    rays = points[rows] - origins
    return LinesOfSight(origins, rays / np.linalg.norm(rays, axis=1, keepdims=True))


def test_lines_that_meet_give_their_points_and_have_no_distance_from_them():
    rng = np.random.default_rng(1)
    points, rows = rng.normal(0.0, 100.0, (2, 3)), np.array([0, 1, 0, 1, 0])
    lines = lines_to(points, rows, rng)
    matrix, right = triangulation_equations(lines, rows, NO_PRIOR)
    np.testing.assert_allclose(np.linalg.solve(matrix, right[..., None])[..., 0], points, atol=1e-9)
    np.testing.assert_allclose(lines.distances(points[rows]), 0.0, atol=1e-9)


def test_weighted_lines_with_a_prior_give_the_least_squares_of_scipy():
    rng = np.random.default_rng(2)
    rows = np.zeros(6, dtype=np.int64)
    lines = lines_to(rng.normal(0.0, 100.0, (6, 3)), np.arange(6), rng)
    weight, prior_m, prior_sigma_m = rng.uniform(0.5, 2.0, 6), np.array([10.0, -20.0, 30.0]), 50.0

    def residuals(point: np.ndarray) -> np.ndarray:
        offsets = point - lines.origins_m
        across = offsets - np.sum(offsets * lines.directions, axis=1)[:, None] * lines.directions
        return np.concatenate([(np.sqrt(weight)[:, None] * across).ravel(), (point - prior_m) / prior_sigma_m])

    held = np.eye(3)[None] / prior_sigma_m**2
    matrix, right = triangulation_equations(lines, rows, (held, prior_m[None] / prior_sigma_m**2), [weight])
    found = np.linalg.solve(matrix[0], right[0])
    expected = least_squares(residuals, prior_m, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_inverse_matrix_is_the_covariance_of_points_from_noisy_lines():
    rng = np.random.default_rng(3)
    point, rows, sigma_m = np.zeros((1, 3)), np.zeros(4, dtype=np.int64), 2.0
    lines = lines_to(point, rows, rng)
    none = np.zeros((1, 3, 3)), np.zeros((1, 3))
    found = []
    for _ in range(4000):
        shifted = LinesOfSight(lines.origins_m + rng.normal(0.0, sigma_m, (4, 3)), lines.directions)
        matrix, right = triangulation_equations(shifted, rows, none, [np.full(4, sigma_m**-2.0)])
        found.append(np.linalg.solve(matrix[0], right[0]))
    np.testing.assert_allclose(np.cov(np.array(found).T), np.linalg.inv(matrix[0]), atol=0.4)
