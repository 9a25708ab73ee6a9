"""Covariances predicted from geometry, against closed forms and the errors of the estimators themselves."""

from dataclasses import replace

import numpy as np
import pytest
from orbit_worlds import orbit_world
from scipy.stats import chi2
from slam_orbits import make_orbit_sequence
from slam_sequences import CAMERA, Recipe, make_sequence

from boresight.estimators.approach import limb
from boresight.estimators.approach.limb_errors import limb_covariance
from boresight.estimators.orbit.batch_filter import BatchFilter
from boresight.estimators.slam.filters.ekf import ConsistentEkfSlam, EkfSlam, IteratedEkfSlam
from boresight.estimators.slam.following import DeadReckoning
from boresight.estimators.slam.smoothing.dynamic_smoother import DynamicSmoother
from boresight.estimators.slam.smoothing.loop_smoother import LoopSmoother
from boresight.estimators.slam.smoothing.smoother import BatchAdjustment, FixedLagSmoother
from boresight.scenarios.bodies.embedded import icosphere
from boresight.scenarios.geometry import Camera, look_at
from boresight.scenarios.observation import Frame, Observation, TrackFrame, TrackRange, TrackSequence
from boresight.scenarios.orbits.draw import draw_orbit


def ball(sun):
    """Plan a sphere of 100 m, 200 px across on the boresight, with a prior of the position that is far wider."""
    camera, pose = Camera(400, 400, 2000.0, 2000.0, 200.0, 200.0), look_at(np.array([0.0, -2000.0, 0.0]))
    wide = np.diag([0.0, 0.0, 0.0, 1e8, 1e8, 1e8])
    return Observation(camera, Frame(np.zeros((0, 0), np.float32), np.array(sun), pose, wide))


@pytest.mark.parametrize(("sun", "half_deg"), [((0.0, 0.0, -1.0), 180.0), ((1.0, 0.0, 0.0), 90.0)])
def test_the_limb_of_a_sphere_is_the_closed_form_of_its_arc(sun, half_deg):
    found = limb.LimbEstimator(icosphere(5, 100.0), limb.LimbOptions(bias_px=0.0, shift=0.0)).predict(ball(sun))
    assert found is not None
    count = round(256 * half_deg / 180.0)  # of the most rays about a whole turn
    stated = limb_covariance(count, limb._POINT_PX, np.radians(half_deg), 100.0, 2000.0, 2000.0)
    np.testing.assert_allclose(np.sqrt(np.diag(found)[3:]), np.sqrt(np.diag(stated)), rtol=0.1)
    scale = np.sqrt(stated[0, 0] * stated[2, 2])
    assert found[3, 5] / scale == pytest.approx(stated[0, 2] / scale, abs=0.15)


def test_a_body_in_the_dark_has_no_prediction():
    estimator = limb.LimbEstimator(icosphere(5, 100.0), limb.LimbOptions())
    assert estimator.predict(ball((0.0, 0.0, 1.0))) is None


@pytest.mark.parametrize(("across_m", "cut"), [(98.0, False), (102.0, True)])
def test_a_body_that_the_frame_cuts_has_no_prediction(across_m, cut):
    """The sphere has a radius of 100 px in a frame that reaches 200 px from the boresight: 2,000 m are 2,000 px."""
    planned = ball((0.0, 0.0, -1.0))
    pose = planned.frame.prior_T_cam_body
    aside = replace(pose, translation_m=pose.translation_m + np.array([across_m, 0.0, 0.0]))
    planned = replace(planned, frame=replace(planned.frame, prior_T_cam_body=aside))
    found = limb.LimbEstimator(icosphere(5, 100.0), limb.LimbOptions()).predict(planned)
    assert (found is None) is cut


def two_rays(sigma_px, range_sigma_m, motion_m2):
    """Two views with a baseline of 40 m of one landmark 100 m below the first, which measures its range."""
    camera, point = Camera(1000, 1000, 1000.0, 1000.0, 500.0, 500.0), np.array([[0.0, 0.0, 100.0]])
    positions = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    ranges = (TrackRange(0, 100.0, range_sigma_m),), ()
    track, pixel, motion = np.array([0]), np.full((1, 2), 17.0), motion_m2 * np.eye(3)
    frames = tuple(
        TrackFrame(float(i), np.eye(3), track, pixel, sigma_px, positions[i], motion, one)
        for i, one in enumerate(ranges)
    )
    return TrackSequence(camera, frames, np.zeros(3), np.zeros((3, 3))), positions, point


def test_two_rays_by_hand():
    """Pixels fix the landmark across, its range along: by hand, for a pixel u = f (X - x) / (Z - z)."""
    sigma, range_m, motion = 0.5, 0.2, 9.0
    across2 = 2.0 * (sigma * 100.0 / 1000.0) ** 2
    h = np.array([1.0, 0.4])  # by x and z of the second view, over f / Z
    plane = np.linalg.inv(np.eye(2) / motion + np.outer(h, h) / (across2 + (0.4 * range_m) ** 2))
    y2 = 1.0 / (1.0 / motion + 1.0 / across2)
    expected = np.array([[plane[0, 0], 0.0, plane[0, 1]], [0.0, y2, 0.0], [plane[0, 1], 0.0, plane[1, 1]]])
    for estimator in (BatchAdjustment(), FixedLagSmoother(), LoopSmoother(), EkfSlam(), ConsistentEkfSlam()):
        np.testing.assert_allclose(estimator.predict(*two_rays(sigma, range_m, motion)), expected, rtol=1e-6, atol=1e-9)
    walked = DeadReckoning().predict(*two_rays(sigma, range_m, motion))
    np.testing.assert_allclose(walked, 2.0 * motion * np.eye(3))


@pytest.mark.parametrize(
    "estimator", [BatchAdjustment(), FixedLagSmoother(), ConsistentEkfSlam()], ids=lambda estimator: estimator.name
)
def test_errors_of_a_sequence_are_as_predicted(estimator):
    """Whitened by the prediction, the last errors of 30 runs have a chi-square distribution of 90 degrees."""
    total = 0.0
    for seed in range(30):
        sequence, truth = make_sequence(np.random.default_rng(seed), Recipe(frames=8, noise_px=0.2, gauge_life=100))
        covariance = estimator.predict(sequence, truth.positions_m, truth.points_m)
        moved = replace(sequence, frames=tuple(replace(f, uv_px=f.uv_px + 3.0) for f in sequence.frames))
        again = estimator.predict(moved, truth.positions_m, truth.points_m)
        np.testing.assert_array_equal(covariance, again)  # no pixel is looked at
        result = estimator.follow(sequence)
        assert result.status == "ok"
        error = result.frames[-1].position_m - truth.positions_m[-1]
        total += error @ np.linalg.solve(covariance, error)
    assert chi2.ppf(0.001, 90) < total < chi2.ppf(0.999, 90)


@pytest.mark.parametrize("estimator", [IteratedEkfSlam, ConsistentEkfSlam])
def test_a_filter_that_starts_at_the_truth_has_the_predicted_covariance(estimator):
    """The recursion of Kalman, with hardly a prior of distances, against the normal matrix; without any noise."""
    sequence, truth = make_sequence(np.random.default_rng(3), Recipe(frames=12, noise_px=0.2))
    frames, moves = [], np.diff(truth.positions_m, axis=0, prepend=truth.positions_m[:1])
    for frame, position_m, moved_m in zip(sequence.frames, truth.positions_m, moves, strict=True):
        lines = np.array([truth.points_m[track] for track in frame.tracks.tolist()]) - position_m
        frames.append(replace(frame, uv_px=CAMERA.project(lines @ frame.R_cam_body.T), motion_m=moved_m))
    method = estimator.from_options({"depth_sigma": 2.0})
    stated = method.follow(replace(sequence, frames=tuple(frames))).frames[-1].covariance_m2
    np.testing.assert_allclose(
        method.predict(sequence, truth.positions_m, truth.points_m), stated, rtol=1e-4, atol=1e-7
    )


def test_a_filter_that_measures_the_attitude_has_no_prediction():
    sequence, truth = make_sequence(np.random.default_rng(3), Recipe(frames=4))
    at = truth.positions_m, truth.points_m
    assert EkfSlam().predict(sequence, *at) is not None
    assert EkfSlam.from_options({"camera": "pose"}).predict(sequence, *at) is None
    assert DynamicSmoother().predict(sequence, *at) is None  # no forces


def test_errors_by_known_forces_are_as_predicted():
    """Of ten orbits, whitened by the prediction: chi-square of 30 degrees; stated covariances agree within 2 %."""
    total, method = 0.0, DynamicSmoother()
    for seed in range(10):
        recipe = Recipe(frames=12, noise_px=0.2, gauge_life=100)
        sequence, truth = make_orbit_sequence(np.random.default_rng(seed), recipe)
        covariance = method.predict(sequence, truth.positions_m, truth.points_m)
        result = method.follow(sequence)
        assert result.status == "ok"
        last = result.frames[-1]
        error = last.position_m - truth.positions_m[-1]
        total += error @ np.linalg.solve(covariance, error)
        np.testing.assert_allclose(np.trace(last.covariance_m2), np.trace(covariance), rtol=0.02)
    assert chi2.ppf(0.001, 30) < total < chi2.ppf(0.999, 30)


def test_errors_of_an_orbit_are_as_predicted():
    """Of six orbits the whitened errors of the epoch state have a chi-square distribution of 36 degrees."""
    world, method, total, ratios = orbit_world(), BatchFilter(), 0.0, []
    for trial in range(6):
        truth, data = draw_orbit(world, 31, trial)
        covariance, estimate = method.predict(data), method.determine(data)
        blind = replace(data, pictures=replace(data.pictures, uv_px=data.pictures.uv_px + 5.0))
        # Pixels place the sightings about the boresight, where an error of the roll has its part; no residual is used.
        np.testing.assert_allclose(method.predict(blind), covariance, rtol=1e-3)
        assert estimate.orbit is not None
        error = estimate.orbit.state - truth.states[0]
        total += error @ np.linalg.solve(covariance, error)
        ratios.append(np.sqrt(np.trace(estimate.orbit.covariance[:3, :3]) / np.trace(covariance[:3, :3])))
    assert chi2.ppf(0.001, 36) < total < chi2.ppf(0.999, 36)
    assert 0.9 < np.median(ratios) < 1.1
    seen = data.pictures
    few = replace(seen, image=seen.image[:5], landmark=seen.landmark[:5], uv_px=seen.uv_px[:5])
    assert method.predict(replace(data, pictures=few)) is None
