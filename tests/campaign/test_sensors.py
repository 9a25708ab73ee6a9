"""The altimeter of a scenario: the truth by another ray tracer, its noise by statistics, nothing else disturbed."""

import numpy as np
import pytest
from scipy.stats import kstest
from tiny_campaign import SCENE

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.world import open_world
from boresight.campaign.kinds.single_image import SingleImage
from boresight.campaign.runs.resolve import resolve
from boresight.estimators.altimeter import boresight_range
from boresight.estimators.landmark.recognizer import LandmarkRecognizer
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View
from boresight.scenarios.load import load_scenario
from boresight.scenarios.sequences.ground import MeshGround

TRIALS = 200


def experiment(folder, sensors, scene=SCENE):
    (folder / "scene.yaml").write_text(scene + sensors)
    return SingleImage(
        world=open_world(load_scenario(str(folder / "scene.yaml")), choose_variant().name),
        scenario="scene",
        methods={},
        seed=5,
    )


def test_a_reading_is_the_true_range_with_its_noise(tmp_path):
    small = SCENE.replace("width_px: 128, height_px: 128", "width_px: 16, height_px: 16")
    ranging = experiment(tmp_path, "sensors: {altimeter: {sigma_m: 5}}\n", small)
    ground, errors_m = MeshGround(ranging.world.body.mesh), []
    for trial in range(TRIALS):
        trial_image = ranging.world.source.trial_image(5, trial)
        pose, reading = (
            trial_image.view.T_cam_body,
            observe(ranging.world, trial_image, ranging.seed, trial).frame.altimeter,
        )
        assert reading.sigma_m == 5.0
        errors_m.append(reading.range_m - boresight_range(ground, pose).range_m)
    assert kstest(errors_m, "norm", (0.0, 5.0)).pvalue > 1e-3
    assert np.unique(errors_m).size == TRIALS


def test_an_altimeter_changes_nothing_else(tmp_path):
    seen = []
    for sensors in ("", "sensors: {altimeter: {sigma_m: 5}}\n"):
        trials = experiment(tmp_path, sensors)
        trial_image = trials.world.source.trial_image(5, 3)
        frame = observe(trials.world, trial_image, trials.seed, 3).frame
        seen.append((trial_image.image, frame.prior_T_cam_body.rotation, frame.prior_T_cam_body.translation_m))
        # The Sun is seen from the true attitude, which the prior misses: the angles to the true camera axes say so.
        true, sun = trial_image.view.T_cam_body, trial_image.view.sun_dir_body
        axes_body = true.inverse().rotate(np.eye(3))
        assert np.degrees(frame.prior_T_cam_body.angle_to(true)) > 0.1
        np.testing.assert_allclose(frame.sun_dir_cam, axes_body @ sun, atol=1e-12)
        assert (frame.altimeter is None) == (sensors == "")
    for without, with_it in zip(*seen, strict=True):
        np.testing.assert_array_equal(without, with_it)


def test_an_estimator_is_told_the_camera_that_is_believed(tmp_path):
    trials = experiment(tmp_path, "onboard: {focal_error: 0.01}\n")
    trial_image = trials.world.source.trial_image(5, 0)
    told = observe(trials.world, trial_image, trials.seed, 0).camera
    assert told.fx_px == pytest.approx(1.01 * trial_image.view.camera.fx_px)


def test_a_boresight_past_the_body_gives_no_reading(tmp_path):
    trials = experiment(tmp_path, "sensors: {altimeter: {sigma_m: 5}}\n")
    trial_image = trials.world.source.trial_image(5, 0)
    aside = trial_image.view.T_cam_body.perturbed(np.zeros(3), np.array([900.0, 0.0, 0.0]))
    past = View(trial_image.view.camera, aside, trial_image.view.sun_dir_body)
    moved = type(trial_image)(trial_image.image, past, {})
    assert observe(trials.world, moved, trials.seed, 0).frame.altimeter is None


@pytest.mark.parametrize("options", ["{}", "{base: landmark-harris}"])
def test_a_new_version_of_the_base_is_another_run(tmp_path, monkeypatch, options):
    (tmp_path / "scene.yaml").write_text(SCENE + "sensors: {altimeter: {sigma_m: 5}}\n")
    (tmp_path / "tiny.yaml").write_text(
        f"scenarios: [scene.yaml]\nestimators: [landmark-altimeter: {options}]\ntrials: 1\nseed: 5\n"
    )
    before = resolve(str(tmp_path / "tiny.yaml")).digest
    monkeypatch.setattr(LandmarkRecognizer, "version", LandmarkRecognizer.version + 1)
    assert resolve(str(tmp_path / "tiny.yaml")).digest != before


def test_real_images_carry_no_altimeter(tmp_path):
    text = "body: {shape: sphere}\ncamera: {fov_deg: 5}\nimages: {folder: set}\nsensors: {altimeter: {sigma_m: 5}}\n"
    (tmp_path / "real.yaml").write_text(text)
    with pytest.raises(BoresightError, match="sensors has no part in a scenario with images"):
        load_scenario(str(tmp_path / "real.yaml"))
