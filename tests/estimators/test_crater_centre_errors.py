"""Errors that the craters of an image share: recovery of a known law, and the covariance of a pose with them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from boresight.estimators.craters.database.centre_errors import measure_centre_errors
from boresight.estimators.craters.database.files import CraterDatabase
from boresight.estimators.craters.database.landmarks import Landmarks, SequencePicture
from boresight.estimators.craters.matching.association import (
    Association,
    CentreErrors,
    CraterAssociationOptions,
    ExpectedCraters,
    adjust_robustly,
    centre_noise,
)
from boresight.scenarios.geometry import Camera, Ellipses, Pose

CAMERA = Camera.from_fov(512, 512, np.radians(5.0))
OPTIONS = CraterAssociationOptions(centre_sigma_px=0.2, centre_sigma_radii=0.0)
LAW = CentreErrors(1.44, 0.2, 400.0)


def _points(count, rng):
    """Place craters on ground of 8 km seen from 100 km."""
    return np.column_stack([rng.uniform(-4000.0, 4000.0, (count, 2)), np.zeros(count)])


def _centre_errors(points, law, rng):
    """Draw (n, 2) errors, px, of the law by scipy's multivariate normal, one component after the other."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    covariance = law.variance * (
        law.correlation / (1.0 + apart / law.length_m) + (1.0 - law.correlation) * np.eye(len(points))
    )
    return 0.2 * multivariate_normal(np.zeros(len(points)), covariance).rvs(2, random_state=rng).T


def _database(law, rng, pictures=60, spread=()):
    points = _points(400, rng)
    n, away = len(points), Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1e5]))
    landmarks = Landmarks(
        np.arange(n),
        points,
        np.tile([0.0, 0.0, 1.0], (n, 1)),
        np.full(n, 100.0),
        1e-6 * np.tile(np.eye(3), (n, 1, 1)),
        np.full(n, 9),
    )
    shown = []
    for number in range(pictures):
        rows = np.sort(rng.choice(n, 50, replace=False))
        errors = _centre_errors(points[rows], law, rng) * (spread[number % len(spread)] if spread else 1.0)
        centres = CAMERA.project(away.transform(points[rows])) + errors
        rims = Ellipses(centres, np.full((50, 2), 6.0), np.zeros(50))
        shown.append(SequencePicture(number, float(number), CAMERA, away, np.array([0.0, 0.6, -0.8]), rows, rims))
    return CraterDatabase(tuple(shown), landmarks)


def test_the_law_of_shared_errors_is_found_in_the_sightings_of_a_database():
    found = measure_centre_errors(_database(LAW, np.random.default_rng(1)), OPTIONS)
    assert found.variance == pytest.approx(LAW.variance, rel=0.08)
    # What a pose suffers from is the mean correlation of all pairs, which length and height determine together.
    points = _points(100, np.random.default_rng(2))
    mean, expected = ((one.correlations(points).sum() - 100.0) / 9900.0 for one in (found, LAW))
    assert mean == pytest.approx(expected, rel=0.3)
    assert found.freedom > 100.0


def test_independent_errors_have_no_correlation():
    found = measure_centre_errors(_database(replace(LAW, correlation=0.0), np.random.default_rng(3)), OPTIONS)
    assert found.correlation < 0.05
    assert found.variance == pytest.approx(LAW.variance, rel=0.05)


def test_images_of_different_noise_give_few_degrees_of_freedom():
    """Deviations of 0.7 and 1.3 in turn: variances of 0.49 and 1.69, 0.55 of their mean apart from it."""
    found = measure_centre_errors(_database(CentreErrors(), np.random.default_rng(4), spread=(0.7, 1.3)), OPTIONS)
    assert found.freedom == pytest.approx(4.0 + 2.0 / 0.55**2, rel=0.3)


def test_few_sightings_leave_errors_as_they_are_stated():
    database = _database(LAW, np.random.default_rng(5), pictures=4)
    assert measure_centre_errors(database, OPTIONS) == CentreErrors()
    assert measure_centre_errors(replace(database, pictures=()), OPTIONS) == CentreErrors()


def _expected(points, rng):
    """Predict craters whose common error is a shift, a roll and a scale, of which the prior knows little."""
    n, centres = len(points), CAMERA.project(points + np.array([0.0, 0.0, 1e5]))
    x, y = (centres - 256.0).T / 256.0
    by_error = np.stack(
        [np.column_stack([np.ones(n), np.zeros(n), -y, x]), np.column_stack([np.zeros(n), np.ones(n), x, y])], 1
    )
    rims = Ellipses(centres, np.full((n, 2), 6.0), np.zeros(n))
    return ExpectedCraters(rims, by_error, 100.0 * np.eye(4), centre_noise(rims, OPTIONS), np.zeros(4))


def _adjusted(law, rng, points_known=True, scale=1.0, told=None):
    points = _points(60, rng)
    expected = _expected(points, rng)
    error = 10.0 * rng.normal(size=4)
    seen = expected.ellipses.centre_px + expected.by_error @ error + scale * _centre_errors(points, law, rng)
    rims, rows = replace(expected.ellipses, centre_px=seen), np.arange(60)
    start = Association(np.column_stack([rows, rows]), np.ones(60), error, expected.covariance)
    known = (points, told or law) if points_known else ()
    found = adjust_robustly(expected, rims, start, *known)
    off = found.error - error
    return float(off @ np.linalg.solve(found.covariance, off)), found.covariance


def test_a_covariance_with_shared_errors_foretells_them():
    """NEES of 4 components in 100 images, between the 0.1 and 99.9 % quantiles of their mean; without, far above."""
    rng = np.random.default_rng(6)
    squares = [_adjusted(LAW, rng)[0] for _ in range(100)]
    # Huber's loss widens a Gaussian's covariance by a few percent.
    low, high = chi2.ppf([0.001, 0.999], 400) / 100
    assert 0.9 * low < np.mean(squares) < high
    assert np.mean([_adjusted(LAW, rng, points_known=False)[0] for _ in range(25)]) > 2.0 * high


def test_an_image_noisier_than_the_average_has_a_larger_covariance():
    """Twice the deviation: the image's own residuals have 117 degrees of freedom, and the law 10."""
    told, rng = CentreErrors(freedom=10.0), np.random.default_rng(7)
    sizes = [
        np.mean([np.trace(_adjusted(CentreErrors(), rng, scale=s, told=told)[1]) for _ in range(20)])
        for s in (1.0, 2.0)
    ]
    assert sizes[1] / sizes[0] == pytest.approx((4.0 * 116.0 + 8.0) / 124.0, rel=0.1)
    assert CentreErrors(variance=2.0).image_variance(1e6, 10.0) == 2.0


def test_the_variance_of_an_image_is_that_of_draws_with_its_chi_square():
    """Images of six degrees of freedom, whose variances are drawn: the mean of those whose chi-square is about 20."""
    rng, law = np.random.default_rng(8), CentreErrors(variance=1.5, freedom=6.0)
    variances = 4.0 * 1.5 / rng.chisquare(6.0, 2_000_000)
    squares = variances * rng.chisquare(6.0, len(variances))
    near = np.abs(squares - 20.0) < 0.5
    assert law.image_variance(20.0, 6.0) == pytest.approx(variances[near].mean(), rel=0.01)
