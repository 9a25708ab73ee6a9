"""Stars in a campaign: the estimator keeps the contract, and its pose follows from the attitudes among the stars."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from scipy import stats
from tiny_campaign import SCENE

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.single_image import check
from boresight.campaign.products import BuiltAssets
from boresight.campaign.runs.manifest import RunRequest, make_manifest
from boresight.campaign.runs.resolve import resolve
from boresight.estimators.contract import NoProductError
from boresight.estimators.stars.calibration import StarField
from boresight.estimators.stars.detection import Detections
from boresight.estimators.stars.identification import Identified
from boresight.estimators.stars.navigator import StarNavigator
from boresight.estimators.stars.wahba import Attitude, solve_wahba
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import load_scenario
from boresight.scenarios.observation import CameraSigma
from boresight.scenarios.stars import PACKAGE, StarCatalog, hipparcos_credit

STARS = """
detector: {exposure_s: 1, white_e_per_s: 5.0e+8}
stars: {tracker_sigma_deg: [0.05, 0.05, 0.1]}
pose_error: {position_cam_m: {normal: [20, 20, 40]}, attitude: {rotation_vector_deg: {normal: [0.3, 0.3, 0.3]}}}
"""
SEED = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stars")
    (folder / "scene.yaml").write_text(SCENE.replace("128", "512") + STARS)
    (folder / "plain.yaml").write_text(SCENE)
    return folder


def opened(folder, *more):
    scenario, variant = load_scenario(str(folder / "scene.yaml"), more), choose_variant().name
    assets = BuiltAssets(scenario, folder / "products", 1, variant).for_estimator()
    return open_world(scenario, variant), StarNavigator.from_options({}, assets)


def answers(folder, count, *more):
    world, navigator = opened(folder, *more)
    for trial in range(count):
        truth = world.source.trial_image(SEED, trial)
        observation = observe(world, truth, SEED, trial)
        before = observation.frame.image.tobytes()
        estimate = navigator.estimate(observation, rng=np.random.default_rng(0))
        check(estimate)
        assert observation.frame.image.tobytes() == before
        yield truth, observation, estimate


@pytest.mark.parametrize("lost", [False, True])
def test_the_attitude_over_the_body_is_that_of_the_stars(folder, lost):
    """The squared errors of the rotation over their covariance are chi-square, of three degrees of freedom each."""
    more = ("stars.tracker_sigma_deg=null",) if lost else ()
    squares, position = [], []
    for truth, observation, estimate in answers(folder, 12, *more):
        assert estimate.status == "ok", estimate.reason
        true = truth.view.T_cam_body
        turn = estimate.pose.rotation @ true.rotation.T
        error = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        squares.append(error @ np.linalg.solve(estimate.covariance[:3, :3], error))
        assert np.abs(error).max() < 1e-4
        # Nothing of the image tells the position, whose error is independent of the attitude's here.
        prior = observation.frame
        np.testing.assert_allclose(estimate.pose.translation_m, prior.prior_T_cam_body.translation_m)
        np.testing.assert_allclose(estimate.covariance[3:, 3:], prior.prior_covariance[3:, 3:])
        position.append(estimate.details["stars"]["residual_u_px"])
        stars = StarField.of(estimate.details["stars"])
        seen = observation.camera.project(stars.directions @ (true.rotation @ truth.R_body_inertial).T)
        np.testing.assert_allclose(stars.uv_px, seen, atol=1.0)
    assert stats.chi2.ppf(1e-4, 36) < sum(squares) < stats.chi2.ppf(1 - 1e-4, 36)
    assert np.std(np.concatenate(position)) < 0.2


def test_errors_of_the_rotation_on_board_stay_in_the_pose(folder):
    for truth, observation, estimate in answers(folder, 3, "onboard.rotation_error_deg={normal: 0.5}"):
        believed = truth.R_body_inertial @ observation.frame.sky.R_body_inertial.T
        off = estimate.pose.rotation.T @ truth.view.T_cam_body.rotation @ believed
        np.testing.assert_allclose(off, np.eye(3), atol=2e-4)
        assert np.linalg.norm(believed - np.eye(3)) > 1e-3


def test_images_without_enough_stars_fail_with_a_reason(folder):
    for _, observation, estimate in answers(folder, 2, "stars.faintest_mag=2", "stars.tracker_sigma_deg=null"):
        assert estimate.status == "failed"
        assert "point sources" in estimate.reason or "enough stars" in estimate.reason
        world, navigator = opened(folder)
        del world
        black = replace(observation, frame=replace(observation.frame, image=np.full((512, 512), 7.0, np.float32)))
        assert "black" in navigator.estimate(black, rng=np.random.default_rng(0)).reason
        bare = replace(observation, frame=replace(observation.frame, sky=None))
        assert "no stars" in navigator.estimate(bare, rng=np.random.default_rng(0)).reason


def test_a_scenario_without_stars_is_refused_before_the_run(folder):
    with pytest.raises(NoProductError, match="stars: missing"):
        assets = BuiltAssets(load_scenario(str(folder / "plain.yaml")), folder, 1, choose_variant().name)
        StarNavigator.from_options({}, assets.for_estimator())
    (folder / "c.yaml").write_text("name: c\nscenarios: [plain.yaml]\nestimators: [stars]\ntrials: 2\nseed: 1\n")
    with pytest.raises(BoresightError, match=r"plain.yaml: stars: missing, but the estimator stars needs them"):
        resolve(str(folder / "c.yaml"))


@pytest.mark.skipif(find_spec(PACKAGE) is None, reason="needs the extra stars")
def test_a_run_names_the_package_of_its_stars(folder):
    (folder / "h.yaml").write_text("name: h\nscenarios: [scene.yaml]\nestimators: [prior]\ntrials: 1\nseed: 1\n")
    for catalog, credits_ in (("hipparcos", [hipparcos_credit()]), ("artificial", [])):
        campaign = resolve(str(folder / "h.yaml"), [f"stars.catalog={catalog}"])
        assert make_manifest(campaign, RunRequest(folder / "run", 1, 1), (), None)["credits"] == credits_


def test_a_declared_error_of_the_principal_point_is_one_of_the_attitude(folder):
    """A principal point that is wrong by du, dv turns the attitude by du / f about y and by -dv / f about x."""
    told = "onboard={principal_point_error_px: [1.5, -1.0], camera_sigma: {principal_point_px: 1.5}}"
    # A prior so wide that the stars alone decide.
    wide = "pose_error.attitude={rotation_vector_deg: {normal: [6, 6, 6]}}"
    for truth, observation, estimate in answers(folder, 2, told, wide):
        focal_px = observation.camera.fx_px
        turn = estimate.pose.rotation @ truth.view.T_cam_body.rotation.T
        error = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0]])
        np.testing.assert_allclose(np.abs(error), np.array([1.0, 1.5]) / focal_px, rtol=0.1)
        np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)[:2]), 1.5 / focal_px, rtol=0.05)


def test_stars_are_identified_with_a_focal_length_that_is_wrong_as_declared(folder):
    wrong = "onboard={focal_error: 0.002, camera_sigma: {focal: 0.002}}"
    for _, _, estimate in answers(folder, 2, wrong):
        assert estimate.status == "ok"
        assert estimate.diagnostics["stars_identified"] > 0.8 * estimate.diagnostics["point_sources"]
        assert estimate.diagnostics["stars_chi2_per_degree"] < 1.0
    for _, _, estimate in answers(folder, 2, "onboard={focal_error: 0.002}"):  # not declared
        assert estimate.diagnostics["stars_identified"] < 0.6 * estimate.diagnostics["point_sources"]
        assert estimate.diagnostics["stars_chi2_per_degree"] > 2.0


def test_one_error_of_the_focal_length_turns_stars_on_one_side(folder):
    """Its covariance is that of drawn errors of the focal length, with noise: the stars are left of the middle."""
    world, navigator = opened(folder)
    camera, rng = world.camera.pinhole, np.random.default_rng(5)
    uv = np.column_stack([rng.uniform(10, 0.4 * camera.width_px, 30), rng.uniform(10, camera.height_px - 10, 30)])
    cam, sigma = camera.unproject(uv), CameraSigma(1e-3)
    attitude = Attitude(np.eye(3), np.eye(3), np.ones(30, dtype=bool), 0.0)
    noise_px = np.full(30, 0.05)
    wide_px = np.hypot(noise_px, 1e-3 * np.linalg.norm(uv - [camera.cx_px, camera.cy_px], axis=1))
    navigator._sky = replace(navigator._sky, catalog=StarCatalog(cam, np.zeros(30)), camera=camera)
    seen = Detections(uv, np.ones(30), wide_px, 1.0, 1.0)
    found = Identified(attitude, np.arange(30), np.arange(30), 0.0)
    stated = navigator._covariance(found, seen, noise_px, sigma)
    turns = []
    for _ in range(3000):
        moved = uv + 1e-3 * rng.normal() * (uv - [camera.cx_px, camera.cy_px])
        moved = moved + np.hypot(0.05, navigator._options.position_sigma_px) * rng.normal(size=uv.shape)
        R, _ = solve_wahba(camera.unproject(moved), cam, wide_px * camera.pixel_angle_rad)
        turns.append(0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]))
    sigmas = np.sqrt(np.diag(stated))
    np.testing.assert_allclose((np.cov(np.array(turns).T) - stated) / np.outer(sigmas, sigmas), 0.0, atol=0.1)
    assert sigmas[1] > 2.0 * np.sqrt(navigator._covariance(found, seen, noise_px, CameraSigma())[1, 1])
