"""Priors with zero variances, in the solvers that weight them, and the calibration next to a prior."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from boresight.estimators.landmark.pose.posterior import GaussianPose, pose_offset, solve_map
from boresight.estimators.landmark.pose.problem import PoseProblem
from boresight.estimators.prior import calibration_in_posterior, floor_variances
from boresight.scenarios.draw import prior_covariance
from boresight.scenarios.geometry import Camera, Pose, look_at
from boresight.scenarios.observation import CameraSigma, Frame, Observation
from boresight.scenarios.spec.world import PoseErrorSpec

CAMERA = Camera.from_fov(512, 512, np.radians(18.3))
TRUE = look_at(np.array([1500.0, 900.0, 970.0]), 0.4)
SIGMAS = np.array([0.012, 0.012, 0.012, 29.0, 29.0, 3.0])


def test_a_covariance_with_an_inverse_is_left_alone():
    covariance = np.diag(SIGMAS**2)
    covariance[0, 3] = covariance[3, 0] = 0.01
    assert floor_variances(covariance) is covariance


@pytest.mark.parametrize(
    ("place", "turn_deg"),
    [
        ({"position_cam_m": {"covariance": [[900, 900, 0], [900, 900, 0], [0, 0, 25]]}}, 2.0),
        ({"position_body_m": {"normal": [30, 30, 0]}}, 2.0),
        ({"position_body_m": {"normal": [0, 0, 0]}}, 0.05),
        ({"position_body_m": {"normal": [30, 30, 30]}}, 0.0),
    ],
)
def test_combinations_without_an_error_have_an_inverse_too(place, turn_deg):
    spec = PoseErrorSpec.model_validate({**place, "attitude": {"angle_deg": {"normal": turn_deg}}})
    covariance = prior_covariance(spec, TRUE, CAMERA)
    floored = floor_variances(covariance)
    scale = np.sqrt(np.diag(floored))
    assert np.linalg.eigvalsh(np.linalg.inv(floored) * np.outer(scale, scale))[0] > 0.0
    np.testing.assert_allclose(np.diag(floored), np.diag(covariance), rtol=1e-8, atol=2e-12)


@pytest.mark.parametrize("sure_of", [[5], [0, 1, 2], [3, 4, 5]])
def test_what_is_known_without_error_stays_and_the_rest_is_as_if_it_were_no_unknown(sure_of):
    """Against the solution with a prior whose standard deviations of those unknowns are a million times smaller."""
    rng = np.random.default_rng(1)
    points = rng.normal(0.0, 100.0, (40, 3))
    seen = CAMERA.project(TRUE.transform(points)) + rng.normal(0.0, 0.3, (40, 2))
    problem = PoseProblem(points, seen, np.tile(np.eye(2) / 0.09, (40, 1, 1)), CAMERA)
    solutions = []
    for factor in (0.0, 1e-6):
        sigmas = SIGMAS.copy()
        sigmas[sure_of] *= factor
        error = np.where(np.isin(np.arange(6), sure_of), 0.0, 0.3 * SIGMAS)
        prior = GaussianPose(TRUE.perturbed(error[:3], error[3:]), np.diag(sigmas**2))
        solutions.append((prior, solve_map(problem, prior, prior.T_cam_body, np.eye(40))))
    (prior, exact), (_, nearly) = solutions
    np.testing.assert_allclose(prior.offset(exact.T_cam_body)[sure_of], 0.0, atol=1e-6)
    assert np.isfinite(exact.covariance).all()
    difference = GaussianPose(nearly.T_cam_body, nearly.covariance).offset(exact.T_cam_body)
    assert (np.abs(difference) < 1e-3 * SIGMAS).all()
    free = np.setdiff1d(np.arange(6), sure_of)
    np.testing.assert_allclose(np.diag(exact.covariance)[free], np.diag(nearly.covariance)[free], rtol=0.01)


def test_the_calibration_errs_as_far_as_the_image_decides():
    """Least squares of scipy with a prior, by a camera that is wrong: its focal length makes 6 m of range.

    The range is known to 2 m beforehand and to 5 m by the image, the place across the line of sight by the image alone.
    """
    camera, sigma = Camera.from_fov(512, 512, np.radians(18.3)), CameraSigma(focal=0.003, principal_point_px=0.5)
    truth, noise_px = Pose(np.eye(3), np.array([60.0, -90.0, 2000.0])), 0.3
    sigmas = np.array([0.01, 0.01, 0.01, 30.0, 30.0, 2.0])
    rng = np.random.default_rng(6)
    points_m = rng.uniform(-30.0, 30.0, (40, 3))

    def off(step, seen_px, seen_by, prior):
        pose = prior.perturbed(step[:3], step[3:])
        return np.concatenate(
            [((seen_by.project(pose.transform(points_m)) - seen_px) / noise_px).ravel(), step / sigmas]
        )

    errors = []
    for _ in range(400):
        focal, middle = camera.fx_px * (1.0 + sigma.focal * rng.standard_normal()), 0.5 * rng.standard_normal(2)
        true = Camera(512, 512, focal, focal, camera.cx_px + middle[0], camera.cy_px + middle[1])
        seen_px = true.project(truth.transform(points_m)) + noise_px * rng.standard_normal((40, 2))
        wrong = sigmas * rng.standard_normal(6)
        prior = truth.perturbed(wrong[:3], wrong[3:])
        found = least_squares(off, np.zeros(6), args=(seen_px, camera, prior), x_scale=sigmas)
        errors.append(pose_offset(truth, prior.perturbed(found.x[:3], found.x[3:])))
    fit = np.linalg.inv(found.jac.T @ found.jac)
    frame = Frame(np.zeros((512, 512), np.float32), np.array([0.0, 0.0, -1.0]), prior, np.diag(sigmas**2))
    observation = Observation(camera, frame, sigma)
    stated = fit + calibration_in_posterior(observation, truth, fit)
    # 400 draws give a standard deviation to 3.5 % (1 sigma).
    np.testing.assert_allclose(np.std(errors, axis=0), np.sqrt(np.diag(stated)), rtol=0.11)
    # An estimate by the image alone, whose range is worse than the prior's, has all of it.
    alone = np.diag([0.003, 0.003, 0.002, 0.1, 0.1, 4.0]) ** 2
    np.testing.assert_array_equal(
        calibration_in_posterior(observation, truth, alone), observation.calibration_covariance(truth)
    )
    assert np.sqrt(stated[5, 5]) < 0.5 * np.sqrt((fit + observation.calibration_covariance(truth))[5, 5])
