"""Two estimators on one image: when they agree, and what follows from both."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, chi2

from boresight.estimators.consensus import ConsensusEstimator, agreement
from boresight.estimators.contract import Estimate
from boresight.estimators.landmark.pose.posterior import GaussianPose, pose_offset
from boresight.estimators.options import OptionsError
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Pose

rng = np.random.default_rng(21)
SCALES = np.array([1e-3, 2e-3, 1e-3, 2.0, 3.0, 20.0])
TRUTH = Pose(Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(), np.array([3.0, -8.0, 2000.0]))


def drawn_covariance() -> np.ndarray:
    root = rng.standard_normal((6, 6)) + 2.0 * np.eye(6)
    return SCALES[:, None] * (root @ root.T) * SCALES


def answer(error: np.ndarray, covariance: np.ndarray) -> GaussianPose:
    return GaussianPose(TRUTH.perturbed(error[:3], error[3:]), covariance)


def drawn(covariance: np.ndarray) -> np.ndarray:
    return np.linalg.cholesky(covariance) @ rng.standard_normal(6)


def test_independent_true_covariances_contradict_each_other_as_often_as_is_said():
    least, n = chi2.isf(0.05, 6), 600
    refused = 0
    for _ in range(n):
        one, two = drawn_covariance(), drawn_covariance()
        refused += agreement(answer(drawn(one), one), answer(drawn(two), two)).distance2 > least
    assert binomtest(refused, n, 0.05).pvalue > 0.001


@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.9, 1.0])
def test_the_fused_covariance_holds_for_any_correlation(correlation):
    """Both errors have a part in common: the mean of e^T P^-1 e is at most its six degrees of freedom."""
    one, two = drawn_covariance(), drawn_covariance()
    roots, squares = [np.linalg.cholesky(each) for each in (one, two)], []
    for _ in range(300):
        common, own = rng.standard_normal((2, 6))
        first, second = roots[0] @ common, roots[1] @ (correlation * common + np.sqrt(1.0 - correlation**2) * own)
        fused = agreement(answer(first, one), answer(second, two)).fused
        error = pose_offset(TRUTH, fused.T_cam_body)
        squares.append(error @ np.linalg.solve(fused.covariance, error))
    assert np.mean(squares) < 6.0 * 1.1


def test_the_weight_makes_the_ellipsoid_least():
    one, two = drawn_covariance(), drawn_covariance()
    found = agreement(answer(np.zeros(6), one), answer(np.zeros(6), two))
    weights = np.linspace(0.0, 1.0, 2001)
    mixed = [w * np.linalg.inv(one) + (1.0 - w) * np.linalg.inv(two) for w in weights]
    best = weights[np.argmax([np.linalg.slogdet(each)[1] for each in mixed])]
    assert found.weight == pytest.approx(best, abs=1e-3)
    np.testing.assert_allclose(
        found.fused.covariance, np.linalg.inv(mixed[int(np.argmin(abs(weights - best)))]), rtol=2e-2
    )


def test_the_better_of_two_decides():
    coarse, fine = drawn_covariance(), 1e-4 * drawn_covariance()
    far, near = answer(drawn(coarse), coarse), answer(drawn(fine), fine)
    for pair in ((far, near), (near, far)):
        fused = agreement(*pair).fused
        np.testing.assert_allclose(pose_offset(near.T_cam_body, fused.T_cam_body), 0.0, atol=1e-3 * SCALES.min())
        np.testing.assert_allclose(fused.covariance, fine, rtol=1e-6)


def test_a_pose_without_error_of_attitude_is_compared_by_its_position():
    fixed = np.diag([0.0, 0.0, 0.0, 4.0, 4.0, 9.0])
    apart = agreement(answer(np.zeros(6), fixed), answer(np.array([0, 0, 0, 2.0, 0, 0]), fixed))
    assert (apart.distance2, apart.freedom) == (pytest.approx(0.5, rel=1e-6), 3)
    # The quantile of a chi-square with 3 degrees of freedom at 0.1 % is 16.27.
    for offset_m, status in ((11.40, "ok"), (11.42, "failed")):
        answers = (
            Estimate("ok", pose=TRUTH.perturbed(np.zeros(3), np.array([d, 0, 0])), covariance=fixed)
            for d in (0, offset_m)
        )
        assert both(*answers).status == status, f"{offset_m**2 / 8.0:.2f}"


class Told:
    """An estimator that answers what it is told."""

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate

    def estimate(self, observation, *, rng):
        return self._estimate


def both(first: Estimate, second: Estimate) -> Estimate:
    method = ConsensusEstimator({"lmaps": Told(first), "photometric": Told(second)}, 0.001)
    return method.estimate(None, rng=np.random.default_rng(1))


def ok(error: np.ndarray) -> Estimate:
    return Estimate("ok", pose=TRUTH.perturbed(error[:3], error[3:]), covariance=np.diag(SCALES**2))


def test_answers_that_agree_are_fused_and_others_refused():
    sigma = SCALES * [0, 0, 0, 1, 0, 0]
    found = both(ok(0.0 * sigma), ok(2.0 * sigma))
    assert found.status == "ok" and found.diagnostics["disagreement"] == pytest.approx(2.0)
    assert [stage.name for stage in found.stages] == ["lmaps", "photometric", "fused"]
    # The quantile of a chi-square with 6 degrees of freedom at 0.1 % is 22.46: sqrt(2 * 22.46) = 6.70 sigma.
    assert both(ok(0.0 * sigma), ok(6.69 * sigma)).status == "ok"
    refused = both(ok(0.0 * sigma), ok(6.71 * sigma))
    assert (refused.status, refused.reason) == ("failed", "lmaps and photometric contradict each other")
    assert refused.diagnostics["disagreement"] == pytest.approx(6.71**2 / 2.0)


def test_both_must_answer():
    assert both(Estimate("failed", "dark"), ok(SCALES)).reason == "lmaps: dark"
    assert both(ok(SCALES), Estimate("ok", pose=TRUTH)).reason == "photometric gives no covariance to compare with"


def test_one_estimator_cannot_agree_with_itself():
    with pytest.raises(BoresightError, match="second: it is the first again"):
        ConsensusEstimator.from_options({"base": "prior", "second": "prior"}, assets=None)


def test_a_wrong_option_of_either_is_said_with_its_section():
    for key in ("options", "second_options"):
        with pytest.raises(OptionsError) as caught:
            ConsensusEstimator.from_options({"base": "prior", "second": "prior", key: {"weight": 1}}, assets=None)
        assert caught.value.sections == (key,)
