"""The heat map of craters: its layers against scipy's, its turned images against closed forms, its finds in scenes."""

from __future__ import annotations

import numpy as np
import pytest
from crater_scenes import CAMERA, crests, frame_of, image_of, scattered
from cv2 import dilate
from scipy.ndimage import gaussian_filter
from scipy.signal import correlate2d

from boresight.estimators.craters.detection.classic import ClassicOptions
from boresight.estimators.craters.detection.preparation import lit_ground, prepare_image
from boresight.estimators.craters.learned.detector import steepest_walls
from boresight.estimators.craters.learned.heat_map import (
    SHAPES,
    HeatMapNetwork,
    Turn,
    contrast_channels,
    estimate_sun,
    search,
)
from boresight.estimators.craters.learned.heat_map_detector import CraterHeatMap, log_odds, packaged_heat_map
from boresight.scenarios.geometry import Ellipses

AZIMUTH, INCIDENCE = np.radians(200.0), np.radians(55.0)


def reference(weights, channels):
    """The U-Net by scipy's correlations."""

    def layer(name, x, stride=1):
        kernel, bias = (weights[f"{name}_{part}"].astype(float) for part in ("kernel", "bias"))
        full = [sum(correlate2d(plane, k, "same") for plane, k in zip(x, one, strict=True)) for one in kernel]
        return np.stack(full)[:, ::stride, ::stride] + bias[:, None, None]

    def relu(name, x, stride=1):
        return np.maximum(layer(name, x, stride), 0.0)

    unshuffled = np.stack([plane[i::2, j::2] for plane in channels for i in (0, 1) for j in (0, 1)])
    two = relu("second", relu("stem", unshuffled))
    four = relu("quarter", relu("down4", two, 2))
    eight = relu("eighth", relu("down8", four, 2))
    x = relu("deep2", relu("deep1", relu("down16", eight, 2)))
    for skip, side, up in ((eight, "side8", "up8"), (four, "side4", "up4"), (two, "side2", "up2")):
        x = relu(up, skip + np.kron(layer(side, x), np.ones((2, 2))))
    return layer("head", x)


def random_network(rng):
    """Draw weights that keep the spread of the layers."""
    return {
        name: (rng.normal(size=shape) / np.sqrt(max(np.prod(shape[1:]), 4.0))).astype(np.float32)
        for name, shape in SHAPES.items()
    }


def test_the_network_is_scipys_correlations():
    rng = np.random.default_rng(2)
    weights = random_network(rng)
    channels = rng.normal(size=(2, 32, 48)).astype(np.float32)
    expected = reference(weights, channels)
    found = HeatMapNetwork(weights).forward(channels, np.ones((32, 48)))
    assert np.std(expected) > 0.1
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=2e-5)


def test_the_network_on_the_ground_is_that_of_the_whole_image():
    """The ground is a disc, with a hole, in an image that is wider than the pieces in which layers are computed."""
    rng = np.random.default_rng(6)
    network, shape = HeatMapNetwork(random_network(rng)), (352, 800)
    channels = rng.normal(size=(2, *shape)).astype(np.float32)
    v, u = np.indices(shape)
    apart = np.hypot(u - 330.0, v - 170.0)
    ground = (apart < 60.0) & (apart > 30.0) | (abs(u - 710) < 8) & (abs(v - 200) < 8)
    whole, found = (network.forward(channels, part) for part in (np.ones(shape), ground))
    near = dilate(ground.astype(np.uint8), np.ones((5, 5), np.uint8))[::2, ::2] > 0
    assert np.ptp(whole[:, :, near]) > 1.0
    np.testing.assert_allclose(found[:, :, near], whole[:, :, near], atol=1e-5)
    assert np.all(np.isneginf(found[:, 0, :, :80])) and np.all(np.isfinite(whole))


def test_channels_are_scipys_local_mean_and_deviation():
    image = np.random.default_rng(3).uniform(50, 90, (160, 170)).astype(np.float32)
    even, relief = contrast_channels(image, np.ones_like(image))
    mean = gaussian_filter(image.astype(float), 20.0, mode="mirror", truncate=3.0)
    square = gaussian_filter((image - mean) ** 2, 20.0, mode="mirror", truncate=3.0)
    np.testing.assert_allclose(even, (image - mean) / np.sqrt(square + (0.02 * mean) ** 2), atol=2e-4)
    np.testing.assert_allclose(relief, (image - mean) / mean, atol=2e-5)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0, 217.0])
def test_a_turned_image_shows_its_points_where_it_says(angle_deg):
    """A linear image is interpolated exactly: its value in the turned image is the coordinate itself."""
    angle = np.radians(angle_deg)
    sun = np.array([np.cos(angle), np.sin(angle)])
    turn = Turn.of(90, 70, sun)
    rows, columns = np.indices((70, 90)) + 0.5
    v, u = np.mgrid[: turn.size[1], : turn.size[0]]
    places = turn.back(np.stack([u.ravel(), v.ravel()], 1) + 0.5)
    well = np.all((places > 2.0) & (places < np.array([88.0, 68.0])), axis=1)
    assert well.sum() > 5000
    for k, stored in enumerate((columns, rows)):
        np.testing.assert_allclose(turn.apply(stored.astype(np.float32)).ravel()[well], places[well, k], atol=0.05)
    assert all(size % 16 == 0 for size in turn.size)
    np.testing.assert_allclose(turn.rotation @ sun, [1.0, 0.0], atol=1e-12)


def test_the_heat_map_finds_every_bowl():
    bowls = scattered(np.random.default_rng(3), 20)
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.02), AZIMUTH, INCIDENCE)
    picture = prepare_image(frame, CAMERA, 20.0)
    ground = picture.ground.astype(np.float32)
    rims, logit = search(packaged_heat_map(), frame.image, ground, picture.sun_px, -1.0, 2000)
    truth = crests(bowls)
    apart = np.linalg.norm(truth.centre_px[:, None] - rims.centre_px, axis=2) / truth.radius_px[:, None]
    ratio = np.abs(np.log(truth.radius_px[:, None] / rims.radius_px))
    found = np.any((apart < 0.3) & (ratio < 0.36), axis=1)
    assert found.mean() >= 0.95
    assert np.all(logit > -1.0)


def test_the_detector_finds_the_bowls_and_nothing_else():
    bowls = scattered(np.random.default_rng(3), 20)
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.02), AZIMUTH, INCIDENCE)
    found, truth = CraterHeatMap.from_options({}).detect(frame, CAMERA), crests(bowls)
    apart = np.linalg.norm(truth.centre_px[:, None] - found.ellipses.centre_px, axis=2) / truth.radius_px[:, None]
    assert np.mean(apart.min(axis=1) < 0.2) >= 0.95
    assert np.mean(apart.min(axis=0) < 0.2) >= 0.9
    assert np.all(np.diff(found.confidence) <= 0.0) and found.confidence[-1] >= 0.93


def test_rims_have_merit_where_bowls_are_and_none_beside_them():
    """Beside a rim one side of the circle has a gradient the wrong way, and counts."""
    bowls = scattered(np.random.default_rng(3), 20)
    picture = prepare_image(frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.02), AZIMUTH, INCIDENCE), CAMERA, 20.0)
    rims = crests(bowls)
    walls, merit = steepest_walls(rims, picture, 0, ClassicOptions())
    np.testing.assert_allclose(walls.radius_px * ClassicOptions().crest_scale, rims.radius_px)
    moved = Ellipses(rims.centre_px + rims.radius_px[:, None] * picture.sun_px, rims.semi_axes_px, rims.angle_rad)
    beside = steepest_walls(moved, picture, 0, ClassicOptions())[1]
    assert np.quantile(merit, 0.1) > 0.6
    assert np.quantile(beside, 0.9) < 0.2
    # Of two rims that the networks rate alike, that with the merit is the likelier by e^6 for the whole of it.
    assert log_odds(np.zeros(2), np.zeros(2), np.array([0.0, 1.0])) @ [-1.0, 1.0] == pytest.approx(6.0)


@pytest.mark.parametrize("options", [{"radius_min_px": 100.0}, {"logit_min": 5.0}])
def test_an_image_in_which_no_rim_is_left_has_no_craters(options):
    bowls = scattered(np.random.default_rng(3), 4)
    frame = frame_of(image_of(bowls, AZIMUTH, INCIDENCE, noise=0.02), AZIMUTH, INCIDENCE)
    assert len(CraterHeatMap.from_options(options).detect(frame, CAMERA).ellipses) == 0


@pytest.mark.parametrize("azimuth_deg", [-20.0, pytest.param(75.0, marks=pytest.mark.long)])
def test_black_sky_does_not_turn_the_sun(azimuth_deg):
    bowls = scattered(np.random.default_rng(4), 24)
    image = image_of(bowls, np.radians(azimuth_deg), INCIDENCE, noise=0.02)
    rows, columns = np.indices(image.shape)
    sky = columns + 0.4 * rows > 0.9 * image.shape[1]
    image[sky] = 0.0
    sun = estimate_sun(packaged_heat_map(), image, lit_ground(image).astype(np.float32))
    assert abs(np.degrees(np.angle(complex(*sun) * np.exp(-1j * np.radians(azimuth_deg))))) < 25.0


@pytest.mark.parametrize("azimuth_deg", [pytest.param(-20.0, marks=pytest.mark.long), 75.0, 200.0])
def test_the_sun_is_where_the_scene_was_lit_from(azimuth_deg):
    bowls = scattered(np.random.default_rng(4), 24)
    image = image_of(bowls, np.radians(azimuth_deg), INCIDENCE, noise=0.02)
    sun = estimate_sun(packaged_heat_map(), image, np.ones_like(image))
    error = np.angle(complex(*sun) * np.exp(-1j * np.radians(azimuth_deg)))
    assert abs(np.degrees(error)) < 25.0
