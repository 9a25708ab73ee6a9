"""The detector's noise has a stream of its own: that of the truth would let an image foretell itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.campaign.cli import main
from boresight.campaign.imaging.world import open_world
from boresight.campaign.store import RunFolder
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.draw import Stream, generator
from boresight.scenarios.geometry import Pose, View
from boresight.scenarios.load import load_scenario

SCENE = """
camera: {width_px: 48, height_px: 48, fov_deg: 18}
viewpoint: {range_m: 2000}
lighting: {phase_deg: {uniform: [0, 50]}}
"""
SEED, TRIAL = 7, 3


@pytest.fixture
def sources(tmp_path):
    """The same scenario without and with a detector."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    found = []
    for more in ((), ("detector.read_noise_e=20",)):
        found.append(open_world(load_scenario(str(tmp_path / "scene.yaml"), more), choose_variant().name))
    return found


def test_an_image_is_exposed_with_the_noise_of_the_detectors_stream(sources):
    """The radiance of the scene without a detector, exposed here."""
    plain, exposed = (world.source.trial_image(SEED, TRIAL) for world in sources)
    np.testing.assert_array_equal(plain.view.T_cam_body.translation_m, exposed.view.T_cam_body.translation_m)
    detector = Detector(sources[1].scenario.spec.detector)
    by_stream = {
        stream: detector.expose(plain.image, generator(SEED, stream, TRIAL))
        for stream in (Stream.DETECTOR, Stream.TRUTH)
    }
    np.testing.assert_array_equal(exposed.image, by_stream[Stream.DETECTOR])
    assert not np.array_equal(exposed.image, by_stream[Stream.TRUTH])


@pytest.mark.parametrize(
    ("rate_deg_s", "velocity_m_s", "row_delay_s", "most"),
    [
        ((0.5, -0.8, 2.0), (0.0, 0.0, 0.0), 0.0, 0.1),
        ((0.5, -0.8, 2.0), (0.0, 0.0, 0.0), 0.01, 0.1),
        ((0.0, 0.0, 0.0), (12.0, 16.0, 5.0), 0.0, 0.25),  # parallax: the body is a quarter as deep as it is far
    ],
)
def test_a_smeared_image_is_the_mean_of_renderings(tmp_path, rate_deg_s, velocity_m_s, row_delay_s, most):
    """Mitsuba renders poses along a way of 3 to 5 px; `Motion` moves one rendering.

    ``most`` is their RMS difference over that of sharp and smeared images.
    """
    state = ",".join(f"{number:g}" for number in (-1500.0, 1200.0, 300.0, *velocity_m_s))
    (tmp_path / "states.csv").write_text(f"time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n0,{state}\n9,{state}\n")
    (tmp_path / "scene.yaml").write_text(
        SCENE.replace("range_m: 2000", "trajectory: {table: states.csv}")
        + "detector: {exposure_s: 2, white_e_per_s: 1.0e+5, read_noise_e: 0, shot_noise: false, gain_e_per_dn: 4,"
        " bits: 16, offset_dn: 0, dark_e_per_s: 0, full_well_e: 1.0e+6}\n"
        "rendering: {samples_per_pixel: 16}\n"
    )
    motion = "trajectory: true" if any(velocity_m_s) else f"rate_deg_s: {{choice: [{list(rate_deg_s)}]}}"
    motion += f", row_delay_s: {row_delay_s}" if row_delay_s else ""
    still, moved = (
        open_world(load_scenario(str(tmp_path / "scene.yaml"), more), choose_variant().name).source
        for more in ((), (f"detector.motion={{{motion}}}",))
    )
    sharp, smeared = still.trial_image(SEED, TRIAL), moved.trial_image(SEED, TRIAL)
    detector, view, expected = Detector(still.scenario.spec.detector), sharp.view, np.zeros((48, 48))
    blocks = np.arange(48).reshape(-1, 3 if row_delay_s else 48)  # rows that are rendered at the time of their middle
    for share in (np.arange(16) + 0.5) / 16 - 0.5:
        for rows in blocks:
            t_s = share * 2.0 + (rows.mean() - 23.5) * row_delay_s
            position_m = view.T_cam_body.camera_position_m + t_s * np.array(velocity_m_s)
            turned = Rotation.from_rotvec(-t_s * np.radians(rate_deg_s)).as_matrix() @ view.T_cam_body.rotation
            then = View(view.camera, Pose(turned, -turned @ position_m), view.sun_dir_body)
            image = detector.expose(still.imager.renderer.render(then), np.random.default_rng(0))
            expected[rows] += image[rows] / 16
    apart, blur = (np.sqrt(np.mean((one.image - expected) ** 2)) for one in (smeared, sharp))
    assert apart < most * blur
    u, v = np.meshgrid(np.arange(48) + 0.5, np.arange(48) + 0.5)
    found, true = (np.array([(one * u).sum(), (one * v).sum()]) / one.sum() for one in (smeared.image, expected))
    assert np.abs(found - true).max() < 0.02
    assert smeared.image.sum() == pytest.approx(expected.sum(), rel=1e-3)


SEQUENCE = """
body: {shape: sphere}
camera: {width_px: 64, height_px: 64, fov_deg: 18}
sequence:
  orbit: {radius_m: 2000, revolutions: 0.05, step_deg: 6}
  images: {guided: true, carry: feature, starts: 1}
"""


@pytest.mark.parametrize(
    ("scene", "experiment", "method"),
    [(SCENE, "single-image", "prior"), (SEQUENCE, "sequence", "dead-reckoning")],
)
def test_a_trial_whose_image_moves_too_far_is_a_failure_and_the_campaign_goes_on(tmp_path, scene, experiment, method):
    """Of five rates, equally probable, one turns the camera by 25 revolutions in an exposure."""
    law = f"{{rate_deg_s: {{choice: [[0, 0, 90000], {', '.join(4 * ['[0, 0, 0.1]'])}]}}}}"
    (tmp_path / "scene.yaml").write_text(scene + f"detector: {{exposure_s: 0.1, motion: {law}}}\n")
    text = f"experiment: {experiment}\nscenarios: [scene]\nestimators: [{method}]\ntrials: 8\nseed: 1\n"
    (tmp_path / "c.yaml").write_text(text)
    assert main(["run", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "run"), "--jobs", "1"]) == 0
    rows = RunFolder(tmp_path / "run").table("rows")
    lost = rows["status"] == "failed"
    assert 0 < lost.sum() < len(rows) == 8
    assert rows["reason"][lost].str.match("there is no such trial: detector.motion: the image moves by").all()
    assert set(rows["status"][~lost]) == {"ok"}


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("detector.motion={trajectory: true}", "detector.motion.trajectory needs a viewpoint.trajectory"),
        ("detector.stray_light={veil_share: 0}", "detector.stray_light: both are 0"),
        ("detector.jpeg_quality=80", "detector: jpeg_quality: JPEG has 8 bits and the detector 12"),
        ("detector.row_shift_s=0", "detector.row_shift_s"),
    ],
)
def test_an_artefact_that_would_do_nothing_is_refused_in_one_line(tmp_path, capsys, override, told):
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "c.yaml").write_text("scenarios: [scene]\nestimators: [prior]\ntrials: 2\nseed: 1\n")
    assert main(["validate", str(tmp_path / "c.yaml"), "--set", override]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
