"""Sequences along trajectories from the scenario to the report, and images of them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from boresight.campaign.cli.main import main
from boresight.campaign.kinds.sequence.images import OrbitImages, Watch
from boresight.campaign.kinds.sequence.score import track_axes
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.geometry import look_at
from boresight.scenarios.load import load_scenario

FLIGHTS = {
    "hover": "hover: {position_m: [790, 0, 0], duration_s: 1200, step_s: 150, box_m: 20, drift_m_s: 0.05}",
    "descent": "descent: {direction: [1, 0.2, 0], from_altitude_m: 310, to_altitude_m: 50, rate_m_s: 0.2, step_s: 100}",
    "flyby": "flyby: {periapsis_m: 600, v_infinity_m_s: 0.1, gm_m3_s2: 3.54, duration_s: 3000, step_s: 200},"
    " rotation: {pole_ra_deg: 30, pole_dec_deg: 60, rate_deg_day: 284}",
}
SCENE = """\
extends: apophis-sphere-sequence
sequence:
  trajectory: {{{flight}}}
  vision: {{landmarks_per_frame: 15, count: constant}}
  knowledge: {{ranges: 3}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flights")
    for name, flight in FLIGHTS.items():
        (folder / f"{name}.yaml").write_text(SCENE.format(flight=flight))
    (folder / "flights.yaml").write_text(
        f"experiment: sequence\nscenarios: [{', '.join(f'{name}.yaml' for name in FLIGHTS)}]\n"
        "estimators: [dead-reckoning]\ntrials: 2\nseed: 5\n"
    )
    out = folder / "out"
    assert main(["run", str(folder / "flights.yaml"), "--jobs", "1", "--worst", "0", "--out", str(out)]) == 0
    return out


def test_errors_along_a_trajectory_are_over_time(run):
    epochs, rows = (pd.read_parquet(run / name) for name in ("epochs", "rows"))
    assert epochs["anomaly_deg"].isna().all()
    assert rows[["error_after_1_m", "error_after_2_m"]].isna().all(axis=None)
    ways = rows[rows["estimator"] == "dead-reckoning"]
    assert (ways["status"] == "ok").all()
    assert (ways["position_error_m"] > 0.0).all()
    for name, frames, last_s in (("hover", 9, 1200.0), ("descent", 14, 1300.0), ("flyby", 17, 3000.0)):
        own = epochs[(epochs["scenario"] == name) & (epochs["estimator"] == "dead-reckoning")]
        assert (own.groupby("trial").size() == frames).all()
        assert own["time_s"].max() == last_s
        parts = np.linalg.norm(own[["radial_m", "along_m", "cross_m"]], axis=1)
        np.testing.assert_allclose(parts, own["position_error_m"], rtol=1e-9, atol=1e-12)


def test_the_report_draws_them(run):
    page = (run / "report" / "report.html").read_text()
    for name in FLIGHTS:
        assert f"Errors along the trajectory, {name}" in page
        assert (run / "report" / f"traces_{name}.svg").exists() or (run / "report" / f"traces_{name}.png").exists()


def test_a_hover_has_axes_of_its_camera():
    at, right = np.array([0.0, 0.0, 500.0]), np.array([0.6, 0.8, 0.0])
    np.testing.assert_allclose(track_axes(at, np.zeros(3), right), [[0, 0, 1], right, [-0.8, 0.6, 0]], atol=1e-12)
    rounding = np.array([2e-13, -1e-13, 3e-13])
    np.testing.assert_array_equal(track_axes(at, rounding, right), track_axes(at, np.zeros(3), right))
    fall = track_axes(at, np.array([1e-9, 0, -5.0]), right)
    np.testing.assert_allclose(fall[1], right, atol=1e-12)
    np.testing.assert_allclose(track_axes(at, np.array([0.0, -3, 1]), right)[1], [0, -1, 0], atol=1e-12)
    upwards = track_axes(at, np.zeros(3), np.array([0.0, 0, 1]))
    np.testing.assert_allclose(upwards @ upwards.T, np.eye(3), atol=1e-12)


def test_states_inside_the_body_are_one_line_and_exit_2(tmp_path, refused):
    trimesh.creation.box((400.0, 200.0, 200.0)).export(tmp_path / "box.obj")
    low = "flyby: {periapsis_m: 150, v_infinity_m_s: 1, gm_m3_s2: 0.01, duration_s: 600, step_s: 150}"
    (tmp_path / "scene.yaml").write_text(
        f"body: {{shape: box.obj, unit: m}}\ncamera: {{width_px: 64, height_px: 64, fov_deg: 30}}\n"
        f"sequence: {{trajectory: {{{low}}}}}\n"
    )
    (tmp_path / "campaign.yaml").write_text(
        "experiment: sequence\nscenarios: [scene.yaml]\nestimators: [dead-reckoning]\ntrials: 1\nseed: 1\n"
    )
    for command in (["validate", str(tmp_path / "campaign.yaml")], ["run", str(tmp_path / "campaign.yaml")]):
        said = refused(*command)
        assert "scene.yaml: sequence: row 2 (from 0) of the trajectory is inside the body" in said


@pytest.mark.parametrize("away", [False, True])
def test_a_camera_that_looks_away_is_refused_before_a_run(away, tmp_path, capsys):
    turn = look_at(np.array([600.0, 0.0, 0.0])).rotation
    quaternion = Rotation.from_matrix(np.diag([1, -1, -1]) @ turn if away else turn).as_quat(scalar_first=True)
    table = pd.DataFrame([quaternion] * 3, columns=["qw", "qx", "qy", "qz"])
    table.assign(time_s=[0.0, 60.0, 120.0], x_m=600.0, y_m=0.0, z_m=0.0).to_csv(tmp_path / "states.csv", index=False)
    (tmp_path / "scene.yaml").write_text(SCENE.format(flight="table: states.csv"))
    assert main(["validate", str(tmp_path / "scene.yaml")]) == (2 if away else 0)
    said = "scene.yaml: sequence: nothing of the body is in the frame in all 3 frames: check"
    assert (said in capsys.readouterr().err) == away


SEEN = """
body: {shape: apophis-sphere, detail: {facets: 20000, albedo: {sigma: 0.35, wavelength_m: 60}}}
camera: {width_px: 200, height_px: 200, fov_deg: 30}
detector: {psf_sigma_px: 0.5}
sequence:
  trajectory:
    flyby: {periapsis_m: 600, v_infinity_m_s: 0.1, gm_m3_s2: 3.54, duration_s: 400, step_s: 200}
    rotation: {pole_ra_deg: 30, pole_dec_deg: 60, rate_deg_day: 284}
    sun_dir: [1, -0.5, 0.3]
  images: {tracks: 20, carry: patch, epipolar: known-attitude}
"""


def test_images_of_a_flyby_over_a_rotating_body_are_tracked_from_its_first_state(tmp_path):
    (tmp_path / "scene.yaml").write_text(SEEN)
    scenario = load_scenario(str(tmp_path / "scene.yaml"))
    images = OrbitImages.open(scenario, choose_variant().name, 5)
    one, other = Watch(images, 5, 0).whole(), Watch(images, 5, 1).whole()
    assert len(images.views) == len(one.sequence.frames) == 3
    for frame, pose, wrong in zip(one.sequence.frames, one.truth.poses, one.truth.wrong, strict=True):
        place = images.camera.project(pose.transform(one.truth.points_m[frame.tracks]))
        assert np.median(np.linalg.norm(place - frame.uv_px, axis=1)) < 0.3
        assert wrong.mean() < 0.2
    np.testing.assert_allclose(np.linalg.norm(one.truth.points_m, axis=1), 190.0, rtol=0.02)
    assert len(np.intersect1d(one.sequence.frames[0].tracks, one.sequence.frames[1].tracks)) > 8
    # The same way, and noise of its own.
    for first, second in zip(one.truth.poses, other.truth.poses, strict=True):
        np.testing.assert_array_equal(first.translation_m, second.translation_m)
    assert not np.array_equal(images.image(0, 1), images.image(1, 1))
