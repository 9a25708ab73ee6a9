"""Covariances tuned by rehearsals."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.estimators.contract import NoProductError
from boresight.estimators.prior import floor_variances
from boresight.estimators.tuned import CovarianceTuning, Rehearsed, check_solved, fit_factor, tuned_covariance
from boresight.scenarios.errors import BoresightError

rng = np.random.default_rng(8)
SCALES = np.array([1e-3, 2e-3, 1e-3, 2.0, 3.0, 20.0])


def drawn(scales: np.ndarray) -> np.ndarray:
    root = rng.standard_normal((6, 6)) + 2.0 * np.eye(6)
    return scales[:, None] * (root @ root.T) * scales


def test_the_image_loses_information_and_the_prior_none():
    prior, image = drawn(10.0 * SCALES), drawn(SCALES)
    known = np.linalg.inv(prior)
    covariance = np.linalg.inv(np.linalg.inv(image) + known)
    for factor in (0.3, 1.0, 7.0):
        expected = np.linalg.inv(np.linalg.inv(image) / factor + known)
        np.testing.assert_allclose(tuned_covariance(covariance, prior, factor), expected, rtol=1e-8)


def test_what_the_image_does_not_tell_stays_as_the_prior_has_it():
    prior = np.diag(SCALES**2)
    np.testing.assert_allclose(tuned_covariance(prior, prior, 9.0), prior, rtol=1e-9)
    # A method without the prior states more than the prior has: that is not made smaller.
    np.testing.assert_allclose(tuned_covariance(4.0 * prior, prior, 9.0), 4.0 * prior, rtol=1e-9)


@pytest.mark.parametrize("true_factor", [0.2, 5.0])
def test_the_factor_is_found_again(true_factor):
    rehearsed = []
    for _ in range(1500):
        prior, image = drawn(10.0 * SCALES), drawn(SCALES)
        stated = np.linalg.inv(np.linalg.inv(image) + np.linalg.inv(prior))
        true = np.linalg.inv(np.linalg.inv(image) / true_factor + np.linalg.inv(prior))
        rehearsed.append(Rehearsed(np.linalg.cholesky(true) @ rng.standard_normal(6), stated, prior))
    # The mean of 1,500 chi-squares of 6 degrees of freedom is known to 1.5 % (1 sigma).
    assert fit_factor(rehearsed) == pytest.approx(true_factor, rel=0.06)


def test_directions_without_error_do_not_count():
    """With an attitude that is known, a true covariance keeps its factor of 1."""
    prior = np.diag([0.0, 0.0, 0.0, 400.0, 400.0, 900.0])
    image = np.diag([1.0, 1.0, 1.0, 4.0, 9.0, 25.0])
    stated = np.linalg.inv(np.linalg.inv(image) + np.linalg.inv(floor_variances(prior)))
    errors = rng.standard_normal((1500, 6)) * np.sqrt(np.diag(stated)) * [0, 0, 0, 1, 1, 1]
    assert fit_factor([Rehearsed(error, stated, prior) for error in errors]) == pytest.approx(1.0, rel=0.06)


def test_an_answer_beyond_all_bounds_has_the_largest_factor():
    prior = np.diag(SCALES**2)
    assert fit_factor([Rehearsed(1e3 * SCALES, 1e-4 * prior, prior)]) == 1e8


def test_few_answers_are_refused():
    check_solved(20, 60, "lmaps")
    with pytest.raises(NoProductError, match="lmaps solved 19 of 60 rehearsed images, and 20 are needed"):
        check_solved(19, 60, "lmaps")


def test_a_tuning_is_read_as_written(tmp_path):
    tuning = CovarianceTuning(2.5, 57, 60)
    tuning.save(tmp_path)
    assert CovarianceTuning.load(tmp_path) == tuning
    (tmp_path / "tuning.json").write_text("{")
    with pytest.raises(BoresightError, match=r"tuning\.json: cannot be read as a tuning"):
        CovarianceTuning.load(tmp_path)
