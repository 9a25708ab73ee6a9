"""Covariances tuned by rehearsals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr

from boresight.estimators.contract import NoProductError
from boresight.estimators.prior import floor_variances
from boresight.estimators.tuned import (
    CovarianceTuning,
    Rehearsed,
    check_solved,
    fit_tuning,
    phase_rad,
    tuned_covariance,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry.pose import Pose
from boresight.scenarios.observation import Frame

rng = np.random.default_rng(8)
SCALES = np.array([1e-3, 2e-3, 1e-3, 2.0, 3.0, 20.0])


PHASE = 0.7


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
        rehearsed.append(Rehearsed(np.linalg.cholesky(true) @ rng.standard_normal(6), stated, prior, PHASE))
    # The mean of 1,500 chi-squares of 6 degrees of freedom is known to 1.5 % (1 sigma).
    found = fit_tuning(rehearsed, 1600)
    assert found.factor(PHASE) == pytest.approx(true_factor, rel=0.06)
    assert (found.solved, found.trials) == (1500, 1600)
    assert found.wrong <= 6, "1.5 are expected"


def test_the_factor_follows_the_phase_angle():
    """It grows by e^2 from 0.3 to 1.3 rad; beyond what was rehearsed it stays."""
    prior, image = np.diag(1e4 * SCALES**2), np.diag(SCALES**2)
    stated = np.linalg.inv(np.linalg.inv(image) + np.linalg.inv(prior))
    rehearsed = [
        Rehearsed(np.exp(phase - 0.8) * rng.standard_normal(6) * SCALES, stated, prior, phase)
        for phase in rng.uniform(0.3, 1.3, 1500)
    ]
    found = fit_tuning(rehearsed, 1500)
    for phase in (0.35, 0.8, 1.25):
        assert found.factor(phase) == pytest.approx(np.exp(2.0 * phase - 1.6), rel=0.15)
    assert found.factor(0.0) == found.factor(found.phases_rad[0]) == pytest.approx(found.factors[0])
    assert found.factor(3.0) == pytest.approx(found.factors[1])
    nees = [
        one.error @ np.linalg.solve(tuned_covariance(stated, prior, found.factor(one.phase_rad)), one.error)
        for one in rehearsed
    ]
    assert abs(spearmanr([one.phase_rad for one in rehearsed], nees).statistic) < 0.08, "2.58 sigma are 0.067"


def test_the_phase_angle_is_that_of_the_prior():
    pose = Pose(np.eye(3), np.array([30.0, -40.0, 1200.0]))
    to_sun = np.array([1.0, 0.5, -1.0]) / 1.5
    frame = Frame(np.zeros((0, 0), np.float32), to_sun, pose, np.eye(6))
    towards_camera = -pose.translation_m
    expected = np.arctan2(np.linalg.norm(np.cross(towards_camera, to_sun)), towards_camera @ to_sun)
    assert phase_rad(frame) == pytest.approx(expected)


def test_directions_without_error_do_not_count():
    """With an attitude that is known, a true covariance keeps its factor of 1."""
    prior = np.diag([0.0, 0.0, 0.0, 400.0, 400.0, 900.0])
    image = np.diag([1.0, 1.0, 1.0, 4.0, 9.0, 25.0])
    stated = np.linalg.inv(np.linalg.inv(image) + np.linalg.inv(floor_variances(prior)))
    errors = rng.standard_normal((1500, 6)) * np.sqrt(np.diag(stated)) * [0, 0, 0, 1, 1, 1]
    found = fit_tuning([Rehearsed(error, stated, prior, PHASE) for error in errors], 1500)
    assert found.factor(PHASE) == pytest.approx(1.0, rel=0.06)


def test_wrong_answers_are_counted_and_do_not_make_the_factor():
    """Five of a hundred answers are a thousand sigma off: a mean of all would have a factor of 10,000 and more."""
    prior, stated = np.diag(1e8 * SCALES**2), np.diag(SCALES**2)
    errors = 2.0 * rng.standard_normal((100, 6)) * SCALES
    errors[::20] = 1e3 * SCALES
    found = fit_tuning([Rehearsed(error, stated, prior, PHASE) for error in errors], 100)
    right = fit_tuning([Rehearsed(error, stated, prior, PHASE) for i, error in enumerate(errors) if i % 20], 95)
    assert found.wrong == 5
    # Each counts as one at the 99 % ellipsoid, 16.8 in place of 6.
    assert right.factor(PHASE) < found.factor(PHASE) < 1.3 * right.factor(PHASE)
    assert right.factor(PHASE) == pytest.approx(4.0, rel=0.25)


def test_an_answer_beyond_all_bounds_has_the_largest_factor():
    prior = np.diag(SCALES**2)
    assert fit_tuning([Rehearsed(1e3 * SCALES, 1e-4 * prior, prior, PHASE)], 1).factor(PHASE) == pytest.approx(1e8)


def test_few_answers_are_refused():
    check_solved(20, 60, "lmaps")
    with pytest.raises(NoProductError, match="lmaps solved 19 of 60 rehearsed images, and 20 are needed"):
        check_solved(19, 60, "lmaps")


def test_a_tuning_is_read_as_written(tmp_path):
    tuning = CovarianceTuning((0.3, 1.2), (2.5, 4.1), 3, 57, 60)
    tuning.save(tmp_path)
    assert CovarianceTuning.load(tmp_path) == tuning
    for wrong in ("{", '{"phases_rad": [0.3], "factors": [2.5, 4.1], "wrong": 3, "solved": 57, "trials": 60}', "{}"):
        (tmp_path / "tuning.json").write_text(wrong)
        with pytest.raises(BoresightError, match=r"tuning\.json: cannot be read as a tuning"):
            CovarianceTuning.load(tmp_path)
