"""Ellipse fit (1): against OpenCV, the truth of noisy arcs, and geometric distances minimised by search."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize

from boresight.estimators.craters.detection.ellipse_fit import fit_reweighted
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.geometry.ellipse import fit_conics, sampson_distances


def drawn(n, seed, ratio=(0.4, 0.95)):
    rng = np.random.default_rng(seed)
    longer = rng.uniform(8, 80, n)
    axes = np.stack([longer, longer * rng.uniform(*ratio, n)], 1)
    return Ellipses(rng.uniform(0, 500, (n, 2)), axes, rng.uniform(0, np.pi, n))


def two_arcs(ellipses, count=90):
    """Return points of two opposite arcs of 100 degrees, like the lit and the shaded side."""
    points, normals = ellipses.points(count)
    rows = np.r_[0 : count * 100 // 360, count // 2 : count // 2 + count * 100 // 360]
    return points[:, rows], normals[:, rows]


def test_exact_points_give_the_ellipse_back():
    truth = drawn(30, 1)
    points, _ = two_arcs(truth)
    found, good = Ellipses.among(fit_conics(points, np.ones(points.shape[:2])))
    assert good.all()
    np.testing.assert_allclose(found.centre_px, truth.centre_px, atol=1e-6)
    np.testing.assert_allclose(found.semi_axes_px, truth.semi_axes_px, rtol=1e-6)
    np.testing.assert_allclose(np.sin(found.angle_rad - truth.angle_rad), 0.0, atol=1e-5)


def test_the_direct_fit_is_opencvs():
    rng = np.random.default_rng(2)
    truth = drawn(30, 3)
    points, _ = truth.points(40)
    points = (points + rng.normal(size=points.shape)).astype(np.float32).astype(np.float64)
    found, _ = Ellipses.among(fit_conics(points, np.ones(points.shape[:2])))
    for i in range(30):
        centre, axes, _ = cv2.fitEllipseDirect(points[i].astype(np.float32))
        np.testing.assert_allclose(found.centre_px[i], centre, atol=0.02)
        np.testing.assert_allclose(found.semi_axes_px[i], 0.5 * np.sort(axes)[::-1], atol=0.05)


@pytest.mark.parametrize(("ratio", "most"), [((0.4, 0.95), 1.05), ((0.25, 0.4), 1.06)], ids=["round", "flat"])
def test_reweighting_comes_to_the_least_squares_of_distances(ratio, most):
    """Without outliers the fit minimises the sum of squared distances; the minimum is found by search."""
    rng = np.random.default_rng(4)
    truth = drawn(8, 5, ratio)
    points, _ = two_arcs(truth)
    points += 0.3 * rng.uniform(-1, 1, points.shape)  # bounded: the robust weights stay close to one
    found, _ = Ellipses.among(fit_reweighted(points, np.ones(points.shape[:2])))
    for i in range(8):

        def cost(p, i=i):
            one = Ellipses(p[None, :2], p[None, 2:4], p[4:5])
            return np.sum(sampson_distances(points[i][None], one.conics()) ** 2)

        start = np.r_[truth.centre_px[i], truth.semi_axes_px[i], truth.angle_rad[i]]
        least = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-9, "maxiter": 4000})
        np.testing.assert_allclose(found.centre_px[i], least.x[:2], atol=0.15)
        here = np.r_[found.centre_px[i], found.semi_axes_px[i], found.angle_rad[i]]
        assert cost(here) < most * least.fun


def test_outliers_move_the_reweighted_fit_less_than_the_direct_one():
    rng = np.random.default_rng(6)
    truth = drawn(60, 7, (0.6, 0.95))
    points, normals = two_arcs(truth)
    points = points + 0.2 * rng.normal(size=points.shape)
    points[:, 9:15] += 0.12 * truth.radius_px[:, None, None] * normals[:, 9:15]
    ones = np.ones(points.shape[:2])
    errors = []
    for conics in (fit_conics(points, ones), fit_reweighted(points, ones)):
        found, good = Ellipses.among(conics)
        assert good.all()
        errors.append(np.linalg.norm(found.centre_px - truth.centre_px, axis=1))
    assert np.median(errors[1]) < 0.5 * np.median(errors[0])


def test_points_of_no_weight_do_not_count():
    truth = drawn(5, 8)
    points, _ = two_arcs(truth)
    padded = np.concatenate([points, np.zeros((5, 7, 2))], axis=1)
    weights = np.concatenate([np.ones(points.shape[:2]), np.zeros((5, 7))], axis=1)
    found, _ = Ellipses.among(fit_reweighted(padded, weights))
    np.testing.assert_allclose(found.centre_px, truth.centre_px, atol=1e-5)


def test_a_line_is_no_ellipse_of_a_craters_shape():
    points = np.stack([np.arange(20.0), 3.0 * np.arange(20.0)], axis=1)[None]
    found, good = Ellipses.among(fit_conics(points, np.ones((1, 20))))
    assert not good.any() or found.semi_axes_px[0, 1] < 0.05 * found.semi_axes_px[0, 0]


def test_distances_are_those_to_a_circle():
    circle = Ellipses(np.array([[3.0, 4.0]]), np.array([[10.0, 10.0]]), np.zeros(1))
    near = np.array([[[13.1, 4.0], [3.0, -5.9], [3.0 + 7.2, 4.0 + 7.2]]])
    expected = np.hypot(near[0, :, 0] - 3.0, near[0, :, 1] - 4.0) - 10.0
    np.testing.assert_allclose(sampson_distances(near, circle.conics())[0], expected, atol=2e-3)
