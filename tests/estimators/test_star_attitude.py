"""Wahba's problem against scipy, its covariance against the Cramer-Rao bound; focal length from stars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from boresight.estimators.stars.calibration import StarField, calibrate
from boresight.estimators.stars.navigator import rotation_update
from boresight.estimators.stars.wahba import robust_attitude, solve_wahba
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, OpenCVDistortion, Pose, RadialDistortion

FALSE_ALARM = 1e-4
CAMERA = Camera.from_fov(1024, 1024, np.radians(10.0))


def field(rng, count, sigma_px=0.0, camera=CAMERA):
    """Return pixels with noise, directions in inertial axes and the true attitude."""
    rotation = Rotation.random(random_state=rng).as_matrix()
    uv = rng.uniform(0.0, 1024.0, (count, 2))
    directions = camera.unproject(uv) @ rotation
    return uv + sigma_px * rng.normal(size=uv.shape), directions, rotation


def turn(R, true):
    return Rotation.from_matrix(R @ true.T).as_rotvec()


@pytest.mark.parametrize("count", [2, 3, 30])
def test_the_attitude_is_that_of_scipy(count):
    rng = np.random.default_rng(count)
    for _ in range(20):
        uv, inertial, _ = field(rng, count, 5.0)
        cam, sigma = CAMERA.unproject(uv), rng.uniform(1e-4, 1e-3, count)
        found, covariance = solve_wahba(cam, inertial, sigma)
        theirs, _ = Rotation.align_vectors(cam, inertial, weights=1.0 / sigma**2)
        np.testing.assert_allclose(found, theirs.as_matrix(), atol=1e-8)
        assert np.linalg.det(found) == pytest.approx(1.0)
        assert (np.linalg.eigvalsh(covariance) > 0.0).all()


def test_errors_are_at_the_cramer_rao_bound_and_as_large_as_their_covariance():
    """The bound of pixels: inverse of sum J^T J / s^2, J the derivative of a pixel by a turn, here by differences."""
    rng = np.random.default_rng(2)
    uv, inertial, true = field(rng, 12)
    step = 1e-7

    def pixels(turned):
        return CAMERA.project(inertial @ (Rotation.from_rotvec(turned).as_matrix() @ true).T).ravel()

    jacobian = np.stack([(pixels(step * e) - pixels(-step * e)) / (2 * step) for e in np.eye(3)], axis=1)
    sigma_px = 0.1
    bound = np.linalg.inv(jacobian.T @ jacobian) * sigma_px**2
    errors = []
    for _ in range(400):
        cam = CAMERA.unproject(uv + sigma_px * rng.normal(size=uv.shape))
        found, covariance = solve_wahba(cam, inertial, np.full(12, sigma_px * CAMERA.pixel_angle_rad))
        errors.append(turn(found, true))
    scatter = np.mean(np.square(errors), axis=0)
    low, high = stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], 400) / 400
    # Wahba's weights leave out that a pixel at the edge of the field is a smaller angle: 0.8 % at 5 degrees.
    assert (scatter < 1.02 * high * np.diag(bound)).all()
    assert (scatter > low * np.diag(bound)).all()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(bound)), rtol=0.01)


def test_wrong_stars_are_left_out():
    rng = np.random.default_rng(3)
    uv, inertial, true = field(rng, 15, 0.1)
    uv[[4, 9]] += [[3.0, 0.0], [-1.0, 1.0]]
    attitude = robust_attitude(CAMERA.unproject(uv), inertial, np.full(15, 0.1 * CAMERA.pixel_angle_rad))
    np.testing.assert_array_equal(np.flatnonzero(~attitude.used), [4, 9])
    pull = turn(attitude.R_cam_inertial, true)
    assert pull @ np.linalg.solve(attitude.covariance, pull) < stats.chi2.ppf(1 - FALSE_ALARM, 3)
    assert stats.chi2.ppf(FALSE_ALARM, 23) < attitude.chi2 < stats.chi2.ppf(1 - FALSE_ALARM, 23)


@pytest.mark.parametrize("rows", [[0], [0, 0], [0, 0, 0]])
def test_directions_that_leave_a_rotation_free_are_refused(rows):
    _, inertial, true = field(np.random.default_rng(4), 1)
    towards = inertial[rows]
    with pytest.raises(BoresightError, match="leave a rotation free"):
        solve_wahba(towards @ true.T, towards, np.full(len(rows), 1e-5))


def test_a_rotation_updates_a_prior_as_the_gaussian_posterior_says():
    """The posterior of joint normal variables by their information matrix."""
    rng = np.random.default_rng(5)
    square = rng.normal(size=(6, 6)) * np.array([1e-3] * 3 + [2.0] * 3)[:, None]
    covariance, measured = square @ square.T, np.diag([4e-8, 1e-8, 9e-8])
    prior = Pose(Rotation.random(random_state=rng).as_matrix(), np.array([3.0, -2.0, 500.0]))
    innovation = np.array([1e-4, -2e-4, 1e-4])
    pose, after = rotation_update((prior, covariance), prior.perturbed(innovation, np.zeros(3)).rotation, measured)
    information = np.linalg.inv(covariance)
    information[:3, :3] += np.linalg.inv(measured)
    expected = np.linalg.inv(information)
    np.testing.assert_allclose(after, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).min())
    step = expected[:, :3] @ np.linalg.solve(measured, innovation)
    np.testing.assert_allclose(turn(pose.rotation, prior.rotation), step[:3], rtol=1e-4)
    np.testing.assert_allclose(pose.translation_m - prior.translation_m, step[3:], rtol=1e-4)


def fields_through(camera, rng, count, sigma_px):
    fields = []
    for _ in range(count):
        uv, directions, _ = field(rng, 25, sigma_px, camera)
        fields.append(StarField(uv, directions, np.full(25, sigma_px or 0.1)))
    return fields


def test_focal_length_and_distortion_are_found_again_and_err_as_much_as_they_say():
    true = Camera(1024, 1024, 4000.0, 4400.0, 512.0, 500.0, RadialDistortion(-0.8, 3.0))
    start = Camera(1024, 1024, 4040.0, 4444.0, 512.0, 500.0, RadialDistortion(0.0, 3.0))
    exact = calibrate(start, fields_through(true, np.random.default_rng(6), 4, 0.0)).camera
    assert exact.fx_px == pytest.approx(4000.0, rel=1e-9) and exact.fy_px == pytest.approx(4400.0, rel=1e-9)
    assert exact.distortion.k1 == pytest.approx(-0.8, rel=1e-6)
    pulls = []
    for seed in range(40):
        found = calibrate(start, fields_through(true, np.random.default_rng(100 + seed), 5, 0.1))
        error = np.array([found.camera.fx_px / 4000.0 - 1.0, found.camera.distortion.k1 + 0.8])
        pulls.append(error @ np.linalg.solve(found.covariance, error))
    low, high = stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], 80)
    assert low < sum(pulls) < high


def test_a_calibration_is_the_least_squares_solution_of_scipy():
    """All attitudes among the parameters, derivatives by differences."""
    camera = Camera(1024, 1024, 1500.0, 1500.0, 512.0, 512.0, RadialDistortion(-0.15, 0.05))
    fields = fields_through(camera, np.random.default_rng(7), 2, 2.0)
    found = calibrate(camera, fields)
    turns = [solve_wahba(found.camera.unproject(one.uv_px), one.directions, one.sigma_px * 1e-3)[0] for one in fields]

    def residuals(parameters):
        focal_px, lens = 1500.0 * (1.0 + parameters[0]), RadialDistortion(parameters[1], 0.05)
        ideal = replace(camera, fx_px=focal_px, fy_px=focal_px, distortion=lens)
        for one, turned, small in zip(fields, turns, parameters[2:].reshape(-1, 3), strict=True):
            towards = one.directions @ (Rotation.from_rotvec(small).as_matrix() @ turned).T
            yield (ideal.undistorted(one.uv_px) - ideal.pinhole.project(towards)) / one.sigma_px[:, None]

    start = np.array([found.camera.fx_px / 1500.0 - 1.0, found.camera.distortion.k1, *np.zeros(6)])
    theirs = least_squares(lambda at: np.concatenate(list(residuals(at))).ravel(), start, x_scale="jac", xtol=1e-15)
    covariance = np.linalg.inv(theirs.jac.T @ theirs.jac)[:2, :2]
    # Their attitudes minimise pixels, ours angles across the line of sight: the same to a part of the noise.
    np.testing.assert_allclose(start[:2], theirs.x[:2], atol=0.05 * np.sqrt(np.diag(covariance)).min())
    np.testing.assert_allclose(found.covariance, covariance, rtol=0.02)


def test_a_calibration_that_is_not_determined_is_refused():
    with pytest.raises(BoresightError, match="do not determine"):
        calibrate(CAMERA, [])
    lens = Camera(100, 100, 100.0, 100.0, 50.0, 50.0, OpenCVDistortion(0.1, 0.0, 0.0, 0.0))
    with pytest.raises(BoresightError, match="not a radial polynomial"):
        calibrate(lens, [])
