from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from boresight.campaign.trial.score import consistency, pose_error
from boresight.scenarios.geometry import look_at

TRUE = look_at(np.array([1500.0, 800.0, 300.0]), 0.3)


def covariance() -> np.ndarray:
    root = np.diag([4e-3, 3e-3, 9e-3, 5.0, 4.0, 8.0]) @ np.linalg.cholesky(0.6 * np.eye(6) + 0.4)
    return root @ root.T


def test_nees_of_errors_drawn_from_the_covariance_is_chi_square():
    """The foreign yardstick is scipy's multivariate normal; 2000 draws, 6 degrees of freedom."""
    P = covariance()
    errors = multivariate_normal(np.zeros(6), P).rvs(2000, random_state=1)
    found = [consistency(TRUE.perturbed(e[:3], e[3:]), TRUE, P, None) for e in errors]
    for name, degrees in (("nees", 6), ("sight_nees", 2)):
        low, high = chi2.ppf([0.001, 0.999], degrees * 2000) / 2000
        assert low < np.mean([one[name] for one in found]) < high


def test_a_wrong_range_or_attitude_is_no_error_across_the_line_of_sight():
    along = 50.0 * TRUE.translation_m / np.linalg.norm(TRUE.translation_m)
    told = consistency(TRUE.perturbed(np.array([1e-3, 2e-3, 3e-3]), along), TRUE, np.eye(6), None)
    assert told["sight_nees"] == pytest.approx(0.0, abs=1e-6)
    assert told["nees"] == pytest.approx(2500.0, rel=1e-6)


def test_foretold_errors_are_the_rms_of_errors_drawn_from_the_covariance():
    P = covariance()
    errors = multivariate_normal(np.zeros(6), P).rvs(4000, random_state=2)
    scored = [pose_error(TRUE.perturbed(e[:3], e[3:]), TRUE) for e in errors]
    told = consistency(TRUE, TRUE, P, 0.25 * P)
    for name, error in (("position_sigma_m", "position_error_m"), ("attitude_sigma_deg", "attitude_error_deg")):
        assert told[name] == pytest.approx(np.sqrt(np.mean([s[error] ** 2 for s in scored])), rel=0.04)
        assert told[name.replace("sigma", "bound")] == pytest.approx(0.5 * told[name])


def test_a_pose_that_turns_about_the_camera_leaves_its_position_where_it_is():
    """The translation error w x t goes with the rotation error w: the camera's place in the body has no error."""
    by_rotation = np.vstack([np.eye(3), -np.cross(TRUE.translation_m, np.eye(3)).T])
    w = np.array([1e-6, -2e-6, 3e-6])
    np.testing.assert_allclose((by_rotation @ w)[3:], np.cross(w, TRUE.translation_m), rtol=1e-12)
    assert pose_error(TRUE.perturbed(w, (by_rotation @ w)[3:]), TRUE)["position_error_m"] < 1e-7
    told = consistency(TRUE, TRUE, by_rotation @ by_rotation.T, None)
    assert told["position_sigma_m"] < 1e-4
    alone = consistency(TRUE, TRUE, np.diag([1.0, 1, 1, 0, 0, 0]), None)
    assert alone["position_sigma_m"] == pytest.approx(np.sqrt(2.0) * np.linalg.norm(TRUE.translation_m))


def test_a_covariance_that_is_none_or_singular_has_no_nees():
    assert consistency(TRUE, TRUE, None, None)["nees"] is None
    assert consistency(TRUE, TRUE, np.diag([0.0, 1, 1, 1, 1, 1]), None)["nees"] is None


def test_nees_of_a_reference_that_errs_takes_both_covariances():
    """Errors of both are drawn; the estimator's covariance alone would give 6 times 1 + 9."""
    P = covariance()
    ours, theirs = (multivariate_normal(np.zeros(6), k * P).rvs(2000, random_state=k) for k in (1, 9))
    pairs = [(TRUE.perturbed(e[:3], e[3:]), TRUE.perturbed(r[:3], r[3:])) for e, r in zip(ours, theirs, strict=True)]
    low, high = chi2.ppf([0.001, 0.999], 6 * 2000) / 2000
    assert low < np.mean([consistency(*pair, P, None, 9 * P)["nees"] for pair in pairs]) < high
    assert consistency(*pairs[0], P, None, 9 * P)["position_sigma_m"] == pytest.approx(
        consistency(*pairs[0], P, None)["position_sigma_m"]
    )
