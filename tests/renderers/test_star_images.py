"""Stars as points of light: the point spread against integrals, and what the body hides."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import choose_variant
from boresight.renderers.stars import point_sources, star_pixels
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import load_scenario
from boresight.scenarios.stars import StarCatalog

CAMERA = Camera(40, 30, 100.0, 120.0, 20.0, 15.0)


def spot(u, v, sigma, rate=7.0):
    return point_sources(CAMERA, np.array([[u, v]]), np.array([rate]), sigma)


@pytest.mark.parametrize("sigma", [0.3, 1.0, 2.2])
def test_a_pixel_has_the_integral_of_the_gaussian(sigma):
    image = spot(18.3, 12.9, sigma)

    def bell(v, u):
        return 7.0 / (2 * np.pi * sigma**2) * np.exp(-0.5 * ((u - 18.3) ** 2 + (v - 12.9) ** 2) / sigma**2)

    for row, column in ((12, 18), (13, 17), (11, 19), (14, 20)):
        expected, _ = dblquad(bell, column, column + 1, row, row + 1)
        assert image[row, column] == pytest.approx(expected, rel=1e-8)
    assert image.sum() == pytest.approx(7.0, rel=1e-7)


def test_a_star_without_blur_is_one_pixel_and_one_at_the_edge_is_cut():
    image = spot(18.3, 12.9, 0.0)
    assert image[12, 18] == image.sum() == 7.0
    assert spot(0.0, 15.5, 1.0).sum() == pytest.approx(3.5)
    assert spot(-20.0, 15.5, 1.0).sum() == 0.0


def test_stars_are_projected_and_those_behind_the_camera_are_not():
    directions = np.array([[0.0, 0.0, 1.0], [0.1, -0.05, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 1.0]])
    catalog = StarCatalog(directions / np.linalg.norm(directions, axis=1, keepdims=True), np.array([0.0, 2.5, 1, 1]))
    uv, light = star_pixels(CAMERA, np.eye(3), catalog)
    np.testing.assert_allclose(uv, [[20.0, 15.0], [30.0, 9.0]])
    np.testing.assert_allclose(light, [1.0, 0.1])


SCENE = """
body: {shape: sphere.obj, unit: m}
camera: {width_px: 200, height_px: 200, fov_deg: 10}
viewpoint: {range_m: 3000}
lighting: {phase_deg: {uniform: [90, 90]}}
detector: {exposure_s: 1, white_e_per_s: 2.0e+8, psf_sigma_px: 0.5}
"""
SEED = 7


@pytest.fixture(scope="module")
def world_of(tmp_path_factory):
    """Worlds of a sphere with a radius of 100 m, which the shape has on its corners."""
    import trimesh

    folder = tmp_path_factory.mktemp("stars")
    trimesh.creation.icosphere(subdivisions=4, radius=100.0).export(folder / "sphere.obj")
    (folder / "scene.yaml").write_text(SCENE)

    def opened(*more):
        return open_world(load_scenario(str(folder / "scene.yaml"), more), choose_variant().name)

    return opened


QUIET = ("detector.shot_noise=false", "detector.read_noise_e=0", "detector.dark_e_per_s=0", "detector.offset_dn=0")


def test_stars_shine_beside_the_body_and_never_through_it(world_of):
    """The silhouette of a sphere at the distance d is a disk of f tan(asin(r / d)) about the image of its centre."""
    light = np.zeros((200, 200))
    dim = (*QUIET, "detector.white_e_per_s=1e4")  # the lit side is not saturated, which would hide light as well
    dark, starry = world_of(*dim), world_of(*dim, "stars={faintest_mag: 10, zero_point_e_per_s: 1.0e+7}")
    for trial in range(8):
        light += starry.source.trial_image(SEED, trial).image - dark.source.trial_image(SEED, trial).image
    radius_px = starry.camera.fx_px * np.tan(np.arcsin(100.0 / 3000.0))
    v, u = np.mgrid[0.5:200, 0.5:200]
    away_px = np.hypot(u - 100.0, v - 100.0)
    # The blur carries light 4 pixels inwards, 4 pixels outwards all stars are free.
    assert (light[away_px < radius_px - 4] == 0.0).all()
    outside = light[away_px > radius_px + 4]
    assert (outside >= 0.0).all() and np.count_nonzero(outside) > 1000


def test_an_image_without_stars_is_the_exposure_of_its_radiance_alone(world_of):
    without = world_of()
    image = without.source.trial_image(SEED, 2)
    assert image.R_body_inertial is None
    assert observe(without, image, SEED, 2).frame.sky is None
    bare = world_of("detector=null").source.trial_image(SEED, 2)
    exposed = Detector(without.scenario.spec.detector).expose(bare.image, generator(SEED, Stream.DETECTOR, 2))
    np.testing.assert_array_equal(image.image, exposed)


def test_a_star_is_where_the_attitudes_of_the_trial_project_it(world_of, tmp_path):
    """One star of a table, in the middle of the field: its direction is the boresight off the body's limb."""
    for distortion in ("null", "{k1: -3.0}"):
        base = world_of(*QUIET, "stars={}", f"camera.distortion={distortion}")
        truth = base.source.trial_image(SEED, 1)
        pinhole = base.camera.pinhole
        uv = np.array([160.3, 45.8])
        towards = truth.R_body_inertial.T @ truth.view.T_cam_body.rotation.T @ pinhole.unproject(uv)
        ra, dec = np.degrees([np.arctan2(towards[1], towards[0]) % (2 * np.pi), np.arcsin(towards[2])])
        (tmp_path / "one.csv").write_text(f"ra_deg,dec_deg,mag\n{ra:.12f},{dec:.12f},3\n")
        world = world_of(*QUIET, f"stars={{catalog: {tmp_path / 'one.csv'}}}", f"camera.distortion={distortion}")
        image = observe(world, world.source.trial_image(SEED, 1), SEED, 1).frame.image
        patch = image[40:52, 154:167].astype(float)
        v, u = np.mgrid[40.5:52, 154.5:167]
        found = np.array([(patch * u).sum(), (patch * v).sum()]) / patch.sum()
        # The lens is resampled by a cubic spline.
        np.testing.assert_allclose(found, uv, atol=0.02 if distortion == "null" else 0.06)


def test_a_star_tracker_tells_the_attitude_with_errors_of_its_sigma(world_of):
    world = world_of("stars={tracker_sigma_deg: [0.1, 0.2, 0.5]}", "onboard.rotation_error_deg={normal: 1.0}")
    pulls, turned = [], []
    for trial in range(60):
        truth = world.source.trial_image(SEED, trial)
        sky = observe(world, truth, SEED, trial).frame.sky
        true = truth.view.T_cam_body.rotation @ truth.R_body_inertial
        skew = sky.R_cam_inertial @ true.T
        error = 0.5 * np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
        pulls.append(error / sky.sigma_rad)
        prior = observe(world, truth, SEED, trial).frame.prior_T_cam_body
        # The believed axes of the body are the same in the prior and among the stars, up to the prior's own error.
        turned.append(np.linalg.norm(sky.R_body_inertial - truth.R_body_inertial))
        assert prior is not None
    assert np.std(pulls, axis=0) == pytest.approx(np.ones(3), abs=0.4)
    np.testing.assert_allclose(world.scenario.spec.stars.tracker_sigma_deg, np.degrees(sky.sigma_rad))
    # A turn of 1 degree about the pole changes two rows by 1 degree each, times sqrt 2.
    assert np.median(turned) == pytest.approx(0.6745 * np.sqrt(2) * np.radians(1.0), rel=0.4)
