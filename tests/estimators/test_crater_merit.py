"""The merit of a rim, equations (3) and (4): derivatives by central differences, closed forms, refinement."""

from __future__ import annotations

import numpy as np
import pytest
from numpy_climb import merit, numpy_climb
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import minimize

from boresight.estimators.craters.detection.preparation import Gradient
from boresight.estimators.craters.detection.refinement import (
    GradientScales,
    confidence,
    from_parameters,
    parameters,
    refine,
    side_merits,
    softened,
    suppress_duplicates,
)
from boresight.estimators.craters.kernels import climb, side_weights
from boresight.scenarios.geometry import Ellipses

GAP = 0.5
SUN = np.array([0.6, -0.8])


def rough_field(seed=1, shape=(90, 110)):
    rng = np.random.default_rng(seed)
    u, v = (gaussian_filter(rng.normal(size=shape), 4.0) for _ in range(2))
    return softened(Gradient(u.astype(np.float32), v.astype(np.float32)), 0.02)


def ideal(shape=(120, 140), centre=(70.3, 58.1), axes=(30.0, 22.0), angle=0.4, width=2.0):
    """Return the gradient field of an ideal rim: along the outward normal towards the Sun, inward away from it."""
    v, u = np.mgrid[: shape[0], : shape[1]] + 0.5
    c, s = np.cos(angle), np.sin(angle)
    x = ((u - centre[0]) * c + (v - centre[1]) * s) / axes[0]
    y = ((v - centre[1]) * c - (u - centre[0]) * s) / axes[1]
    n = np.stack([x / axes[0] * c - y / axes[1] * s, x / axes[0] * s + y / axes[1] * c], axis=-1)
    slope = np.linalg.norm(n, axis=-1, keepdims=True)
    far = (np.hypot(x, y) - 1.0) * np.hypot(x, y) / np.maximum(slope[..., 0], 1e-12)
    n = n / np.maximum(slope, 1e-12)
    strength = np.exp(-0.5 * (far / width) ** 2) * np.sign(n @ SUN)
    truth = from_parameters(np.array([[*centre, *axes, angle]]))
    return n * strength[..., None], truth


def test_the_merits_derivatives_are_central_differences():
    rng = np.random.default_rng(2)
    field = rough_field()
    rows = np.column_stack(
        [
            rng.uniform(35, 75, 12),
            rng.uniform(35, 55, 12),
            rng.uniform(12, 25, 12),
            rng.uniform(6, 11, 12),
            rng.uniform(0, 3, 12),
        ]
    )
    _, by = merit(from_parameters(rows), field, SUN, GAP)
    h = 1e-6
    for j in range(5):
        ahead, behind = rows.copy(), rows.copy()
        ahead[:, j] += h
        behind[:, j] -= h
        values = [merit(from_parameters(r), field, SUN, GAP)[0] for r in (ahead, behind)]
        np.testing.assert_allclose(by[:, j], (values[0] - values[1]) / (2 * h), rtol=2e-4, atol=2e-6)


def test_the_merit_is_scipys_interpolation_along_the_rim_weighted_by_side():
    """Of rims within the field and across its border, beyond which it is constant."""
    field = rough_field()
    centre = np.array([[40.0, 50.0], [55.2, 44.1], [4.0, 30.0], [104.0, 80.0]])
    rims = Ellipses(
        centre, np.array([[20.0, 15.0], [9.0, 5.0], [12.0, 9.0], [14.0, 14.0]]), np.array([0.3, 2.0, 1.0, 0.0])
    )
    points, normals = rims.points(72)
    g = [map_coordinates(field[..., i], points[..., ::-1].T - 0.5, order=1, mode="nearest").T for i in (0, 1)]
    along = np.einsum("ink,nki->nk", g, normals)
    weight, _ = side_weights(normals @ SUN, GAP)
    for side, chosen in enumerate((np.maximum(weight, 0.0), np.minimum(weight, 0.0))):
        expected = (chosen * along).sum(axis=1) / np.abs(chosen).sum(axis=1)
        np.testing.assert_allclose(side_merits(rims, field, SUN, GAP)[0][:, side], expected, atol=1e-12)


def test_the_merit_of_a_perfect_rim_is_one_and_turns_its_sign_with_the_sun():
    field, truth = ideal(width=1e6)
    np.testing.assert_allclose(merit(truth, field, SUN, GAP)[0], 1.0, atol=1e-3)
    np.testing.assert_allclose(merit(truth, field, -SUN, GAP)[0], -1.0, atol=1e-3)


def test_a_terminator_has_one_good_side():
    """Brightness that rises evenly towards the Sun agrees on both sides, a step on one only."""
    u = np.mgrid[:100, :100][1] + 0.5
    step = np.exp(-0.5 * ((u - 40.0) / 2.0) ** 2)
    field = np.stack([step, 0 * step], axis=-1)
    rim = Ellipses(np.array([[55.0, 50.0]]), np.array([[15.0, 15.0]]), np.zeros(1))
    shaded, lit = side_merits(rim, field, np.array([1.0, 0.0]), GAP)[0][0]
    assert lit > 0.2
    assert abs(shaded) < 0.01


def test_weights_leave_the_transition_arcs_out():
    cosine = np.array([-1.0, -0.5, -0.2, 0.0, 0.24, 0.5, 0.9])
    weight, _ = side_weights(cosine, GAP)
    np.testing.assert_allclose(weight, [-1, -1, 0, 0, 0, 1, 1], atol=1e-12)


def test_refinement_locks_on_the_rim_as_scipys_search_does():
    values, truth = ideal()
    scales = GradientScales((values,), (values,), (np.inf,))
    start = from_parameters(parameters(truth) + np.array([[1.5, -1.0, 1.0, -0.8, 0.05]]))
    found = refine(start, scales, SUN, GAP, 60)
    best = minimize(
        lambda p: -merit(from_parameters(p[None]), values, SUN, GAP)[0][0],
        parameters(truth)[0], method="Nelder-Mead",
        options={"xatol": 1e-4, "fatol": 1e-10, "maxiter": 4000},
    )  # fmt: skip
    reached = merit(found, values, SUN, GAP)[0][0]
    assert reached > -best.fun - 2e-3
    np.testing.assert_allclose(found.centre_px, truth.centre_px, atol=0.1)
    np.testing.assert_allclose(found.semi_axes_px, truth.semi_axes_px, atol=0.3)


@pytest.mark.parametrize("rounds", [0, 1, 2, 6])
def test_the_compiled_refinement_is_that_of_numpy(rounds):
    field = rough_field()
    rng = np.random.default_rng(4)
    longer = rng.uniform(8, 20, 30)
    rows = [
        *rng.uniform([20, 20], [90, 70], (30, 2)).T,
        longer,
        longer * rng.uniform(0.5, 0.99, 30),
        rng.uniform(0, 3, 30),
    ]
    start = np.stack(rows, axis=1)
    expected = numpy_climb(start, field, SUN, GAP, rounds)
    assert rounds < 2 or np.mean(np.abs(expected - start)[:, :2].max(axis=1) > 0.1) > 0.5
    np.testing.assert_allclose(climb(start, field, SUN, GAP, rounds), expected, atol=1e-7)


def test_confidence_is_that_of_the_worse_side():
    values, truth = ideal(width=1e6)
    v, u = np.mgrid[: values.shape[0], : values.shape[1]] + 0.5
    values[(np.stack([u, v], axis=-1) - truth.centre_px[0]) @ SUN < 0.0] *= 0.25
    scales = GradientScales((values,), (values,), (np.inf,))
    np.testing.assert_allclose(confidence(truth, scales, SUN, GAP), 0.25, atol=0.01)


def test_duplicates_go_and_nested_craters_stay():
    ellipses = Ellipses(
        np.array([[50.0, 50], [51, 50], [50, 50], [90, 50]]),
        np.array([[10.0, 9], [10.5, 9], [24, 20], [9, 9]]),
        np.zeros(4),
    )
    kept = suppress_duplicates(ellipses, np.array([0.8, 0.9, 0.7, 0.95]), 0.6, 1.6)
    assert kept.tolist() == [3, 1, 2]


def test_duplicates_are_those_of_all_pairs():
    rng = np.random.default_rng(5)
    axes = rng.uniform(5.0, 20.0, (300, 1)) * [1.0, 0.8]
    rims = Ellipses(rng.uniform(0.0, 150.0, (300, 2)), axes, np.zeros(300))
    score = rng.integers(0, 40, 300) / 40.0
    apart = np.linalg.norm(rims.centre_px[:, None] - rims.centre_px, axis=2)
    r = rims.radius_px
    same = (apart < 0.6 * np.minimum.outer(r, r)) & (np.maximum.outer(r, r) / np.minimum.outer(r, r) < 1.6)
    expected: list[int] = []
    for i in sorted(range(300), key=lambda k: -score[k]):
        if not same[i, expected].any():
            expected.append(i)
    assert 50 < len(expected) < 250
    assert suppress_duplicates(rims, score, 0.6, 1.6).tolist() == expected
    assert suppress_duplicates(Ellipses.none(), np.empty(0), 0.6, 1.6).tolist() == []
