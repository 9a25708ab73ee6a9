"""A lens with distortion, all the way through an experiment: estimators see the pinhole's image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.single_image import SingleImage
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.geometry import View
from boresight.scenarios.load import load_scenario

SCENE = """
camera: {width_px: 160, height_px: 120, fov_deg: 18.3, distortion: {k1: 4.0}}
viewpoint: {range_m: 2000}
brdf: {kind: lambert}
body: {shading: smooth}
"""


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> SingleImage:
    file = tmp_path_factory.mktemp("lens") / "lens.yaml"
    file.write_text(SCENE)
    return SingleImage(
        world=open_world(load_scenario(str(file)), choose_variant().name), scenario="scene", methods={}, seed=5
    )


def opencv_pixels(experiment: SingleImage, points_cam: np.ndarray) -> np.ndarray:
    matrix = experiment.world.camera.matrix
    return cv2.projectPoints(points_cam, np.zeros(3), np.zeros(3), matrix, None)[0][:, 0]


def test_an_estimator_sees_what_an_ideal_lens_would_have_seen(experiment):
    trial_image = experiment.world.source.trial_image(5, 0)
    observation = observe(experiment.world, trial_image, experiment.seed, 0)
    assert observation.camera.distortion is None
    assert trial_image.view.camera.distortion is not None
    ideal = experiment.world.renderer.render(
        View(observation.camera, trial_image.view.T_cam_body, trial_image.view.sun_dir_body)
    )
    inside = cv2.erode((ideal > 0).astype(np.uint8), np.ones((5, 5))) > 0
    seen = observation.frame.image
    assert np.median(np.abs(seen - ideal)[inside]) < 0.005 * ideal.max()
    assert np.abs(seen - ideal)[inside].mean() < 0.3 * np.abs(trial_image.image - ideal)[inside].mean()


def test_landmarks_in_rectified_pixels_are_scored_at_the_points_that_they_show(experiment):
    """Surface points projected by OpenCV's pinhole: the error of a landmark there is that of the ray tracer."""
    trial_image = experiment.world.source.trial_image(5, 1)
    uv = np.random.default_rng(0).uniform([40, 30], [120, 90], (60, 2))
    hits = experiment.world.renderer.surface(trial_image.view, uv)
    points = hits.points_body_m[hits.hit]
    pixels = opencv_pixels(experiment, trial_image.view.T_cam_body.transform(points))
    unit = np.ones(len(points))
    table = {"landmark": np.arange(len(points)), "u_px": pixels[:, 0], "v_px": pixels[:, 1]}
    table |= dict(zip(("x_m", "y_m", "z_m"), points.T, strict=True))
    table |= {f"s{axes}_m2": unit * (axes[0] == axes[1]) for axes in ("xx", "xy", "xz", "yy", "yz", "zz")}
    errors = [record["error_m"] for record in experiment._landmarks(table, trial_image)]
    assert len(errors) > 30
    assert np.median(errors) < 1e-3


def test_a_lens_that_the_spacecraft_does_not_know_of_displaces_what_it_sees(tmp_path: Path):
    file = tmp_path / "unknown.yaml"
    file.write_text(SCENE + "onboard: {distortion_error: -1}\n")
    experiment = SingleImage(
        world=open_world(load_scenario(str(file)), choose_variant().name), scenario="scene", methods={}, seed=5
    )
    trial_image = experiment.world.source.trial_image(5, 0)
    seen = observe(experiment.world, trial_image, experiment.seed, 0).frame.image
    np.testing.assert_allclose(seen, trial_image.image, atol=1e-5)
