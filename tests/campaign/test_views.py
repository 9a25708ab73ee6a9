"""The preview of a scenario's views against closed forms, and what estimators get at states of a trajectory."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from boresight.campaign.imaging.observe import observe
from boresight.campaign.imaging.preview import preview
from boresight.campaign.imaging.ranges import typical_range_m
from boresight.campaign.imaging.world import check_bodies, open_world
from boresight.campaign.products.databases import database_images
from boresight.campaign.runs.check import preflight
from boresight.campaign.runs.read import read_campaign
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import prior_covariance
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import look_at
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.trajectory import SpiceTrajectorySpec

BALL = "body={shape: sphere}"
SMALL = ("camera.width_px=64", "camera.height_px=48")


def shares(*overrides: str) -> tuple[float, float]:
    """Share of the side that faces the camera out of the frame, and of the rest in the dark, %."""
    said = preview(load_scenario("quickstart", (BALL, *overrides)))[0]
    return tuple(map(float, re.findall(r"(\d+) %", said)))


@pytest.mark.parametrize("phase_deg", [0.0, 60.0, 90.0, 150.0])
def test_the_dark_share_is_that_of_a_sphere(phase_deg):
    out, dark = shares("viewpoint.range_m=1e5", "camera.fov_deg=1", f"lighting.phase_deg={phase_deg}")
    # The lit part of the disk of a far sphere is (1 + cos phase) / 2.
    assert out == 0.0
    assert dark == pytest.approx(50.0 * (1.0 - np.cos(np.radians(phase_deg))), abs=1.0)


def test_phase_angle_and_dark_share_of_real_images_are_told(tmp_path):
    """A half moon from 100 km, and a sign of the Sun that is wrong: a full one."""
    header = "file,time_s,sun_body_x,sun_body_y,sun_body_z,ref_qw,ref_qx,ref_qy,ref_qz,ref_tx_m,ref_ty_m,ref_tz_m"
    rows = [f"{name},0,{sun},1,0,0,0,0,0,1e5" for name, sun in (("a.png", "1,0,0"), ("b.png", "0,0,-1"))]
    for images, said in ((rows[:1], "phase angle 90 deg in 1 image"), (rows, "phase angle 0 to 90 deg in 2 image")):
        (tmp_path / "poses.csv").write_text("\n".join([header, *images, ""]))
        for row in images:
            cv2.imwrite(str(tmp_path / row.partition(",")[0]), np.zeros((48, 64), np.uint8))
        keys = (BALL, *SMALL, "camera.fov_deg=1", f"images={{folder: {tmp_path}}}", "viewpoint=null", "detector=null")
        line = preview(load_scenario("quickstart", (*keys, "pose_error=null", "lighting=null")))[0]
        assert said in line
        dark = float(re.findall(r"(\d+) % of the rest", line)[0])
        assert dark == pytest.approx(50.0 if len(images) == 1 else 25.0, abs=2.5)  # of 4,000 points


def test_half_a_disk_is_out_of_the_frame_where_its_centre_is_on_the_border():
    out, dark = shares(
        "viewpoint.range_m=1e5", "camera={fov_deg: 1, principal_point_px: [0, 256]}", "lighting.phase_deg=0"
    )
    assert out == pytest.approx(50.0, abs=1.0)
    assert dark == 0.0


def test_a_body_out_of_the_frame_is_refused():
    with pytest.raises(BoresightError, match="nothing of the body is in the frame in 40 views"):
        shares("viewpoint.range_m=1e5", "camera={fov_deg: 1, principal_point_px: [-600, 256]}")


def test_the_smear_by_a_roll_is_told_and_refused_where_no_image_could_be_made():
    """The corner of 64 x 48 pixels moves on a circle of 40 px."""

    def told(*choices: str) -> str:
        law = f"detector={{exposure_s: 0.1, motion: {{rate_deg_s: {{choice: [{', '.join(choices)}]}}}}}}"
        return next(one for one in preview(load_scenario("quickstart", (BALL, *SMALL, law))) if "motion" in one)

    # 0.1 s times 90 deg/s is 0.05 pi rad.
    assert told("[0, 0, 90]") == "motion moves images by 6.283 px (median) and 6.283 px at most in 40 views"
    some = re.search(
        r"and 628\.3 px at most in 40 views, above 500 px in (\d+), where", told("[0, 0, 90]", "[0, 0, 9000]")
    )
    assert some is not None
    assert 10 <= int(some[1]) <= 30
    with pytest.raises(BoresightError, match=r"detector\.motion: .* above 500 px in 40, where trials fail: give lower"):
        told("[0, 0, 9000]")


@pytest.mark.parametrize("fov_deg", [1.0, 0.05])
def test_a_coarse_shape_may_fill_the_frame(tmp_path, fov_deg):
    trimesh.creation.box((200.0, 200.0, 200.0)).export(tmp_path / "cube.obj")
    (tmp_path / "scene.yaml").write_text("extends: quickstart\nbody: {shape: cube.obj}\n")
    near = ("viewpoint={range_m: 1000}", f"camera={{fov_deg: {fov_deg}}}", "body.detail=null")
    said = preview(load_scenario(str(tmp_path / "scene.yaml"), near))[0]
    assert re.search(r"(9\d|100) % is out of the frame", said)


def test_a_trajectory_is_looked_at_from_its_beginning_to_its_end(tmp_path):
    """The first 60 of 100 states look away, the others at the body."""
    turns = Rotation.from_matrix([look_at(np.array([2000.0, 0.0, 0.0])).rotation] * 100)
    away = Rotation.from_euler("y", np.where(np.arange(100) < 60, 90.0, 0.0)[:, None], degrees=True) * turns
    table = pd.DataFrame(away.as_quat(scalar_first=True), columns=["qw", "qx", "qy", "qz"])
    table.assign(time_s=np.arange(100.0), x_m=2000.0, y_m=0.0, z_m=0.0).to_csv(tmp_path / "states.csv", index=False)
    (tmp_path / "scene.yaml").write_text(
        "extends: quickstart\nbody: {shape: sphere}\nviewpoint: {trajectory: {table: states.csv}}\n"
    )
    scenario = load_scenario(str(tmp_path / "scene.yaml"))
    assert "60 % is out of the frame" in preview(scenario)[0]
    table[:] = table.iloc[0].to_numpy()
    table.assign(time_s=np.arange(100.0), x_m=2000.0, y_m=0.0, z_m=0.0).to_csv(tmp_path / "states.csv", index=False)
    with pytest.raises(BoresightError, match="nothing of the body is in the frame"):
        preview(load_scenario(str(tmp_path / "scene.yaml")))


@pytest.mark.parametrize("phase", [(35.0, 35.0), (20.0, 40.0)])
def test_phase_angles_of_the_views_are_within_those_that_are_asked_for(phase):
    said = preview(load_scenario("quickstart", (BALL, f"lighting.phase_deg={{uniform: {list(phase)}}}")))[0]
    told = list(map(float, re.search(r"phase angle (.*) deg in 40 views", said)[1].split(" to ")))
    assert phase[0] <= told[0] <= told[-1] <= phase[1]
    assert len(told) == len(set(phase))


def test_facets_are_told_in_pixels_and_coarse_ones_with_what_to_change():
    """Pixels are those at the middle of the side of a sphere that is seen."""
    far = ("body={shape: sphere, detail: null, even_facets: 2000}", "viewpoint.range_m=2e4", "camera.fov_deg=2")
    scenario = load_scenario("quickstart", far)
    corners_m = load_body(scenario.spec.body).mesh.corners_m
    edge_m = np.linalg.norm(corners_m - np.roll(corners_m, 1, axis=1), axis=2).mean()
    for detailed in (True, False):
        line = preview(scenario, detailed=detailed)[2]
        told_m, told_px = map(float, re.search(r"edges of (\S+) m, (\S+) px", line).groups())
        assert told_m == pytest.approx(edge_m, rel=0.02)
        assert told_px == pytest.approx(edge_m / (19_850 / scenario.spec.camera.camera().fx_px), rel=0.03)
        assert "coarse for this camera" in line
    assert "coarse" not in preview(load_scenario("quickstart", far[:2]))[2]


def test_samples_move_a_small_body_as_far_as_is_told():
    """Against discs at 400 random places, on the regular grid of samples of a renderer."""
    size_m = float(np.ptp(load_body(load_scenario("quickstart", (BALL,)).spec.body).mesh.vertices_m, axis=0).max())
    camera, far = "camera={width_px: 64, height_px: 64, focal_px: [100, 100]}", f"viewpoint.range_m={10.0 * size_m}"
    scene = (BALL, camera, far)
    (line,) = (one for one in preview(load_scenario("quickstart", scene)) if "samples in a pixel" in one)
    rng, at = np.random.default_rng(3), (np.arange(32) + 0.5) / 2.0
    errors = []
    for centre in 8.0 + rng.random((400, 2)):
        inside = np.hypot(at[:, None] - centre[0], at - centre[1]) <= 5.0
        errors += [inside.sum(axis=1 - axis) @ at / inside.sum() - centre[axis] for axis in range(2)]
    told = re.search(r"^4 samples .* disc of 10 px by (\S+) px .*rendering.samples_per_pixel to (\d+)$", line)
    assert float(told[1]) == pytest.approx(np.std(errors), rel=0.15)
    assert int(told[2]) == 16
    finer = preview(load_scenario("quickstart", (*scene, "rendering.samples_per_pixel=16")))
    assert not [one for one in finer if "samples in a pixel" in one]
    far = (BALL, camera, "viewpoint.range_m=1e6", "rendering.samples_per_pixel=64")
    assert not [one for one in preview(load_scenario("quickstart", far)) if "samples in a pixel" in one]


def test_the_prior_is_told_in_pixels_and_what_estimators_are_told_of_it():
    """At 2 km a pixel is 1.258 m; an attitude that a belief leaves out is that of the draw."""
    law = (
        "pose_error.position_cam_m={normal: [12.58, 12.58, 30]}", "pose_error.attitude={angle_deg: {normal: 0.3}}",
        "onboard.pose_error={position_cam_m: {normal: [2.516, 2.516, 4]}}",
    )  # fmt: skip
    scenario = load_scenario("quickstart", law)
    assert preview(scenario)[1] == (
        "errors of the prior (RMS): 10 px in the place of the body, 30 m along the line of sight, 0.173 deg of the"
        " attitude about each axis; estimators are told 2 px in the place of the body, 4 m along the line of sight,"
        " 0.173 deg of the attitude about each axis"
    )
    assert scenario.spec.onboard.pose_error.attitude == scenario.spec.pose_error.attitude
    assert preview(load_scenario("quickstart", law[:2]))[1].endswith("; estimators are told the same")


def in_flight(tmp_path, descent: str, rest: str = ""):
    (tmp_path / "scene.yaml").write_text(
        "camera: {fov_deg: 20}\nbody: {shape: sphere}\n"
        f"viewpoint: {{trajectory: {{descent: {{{descent}}}}}}}\n{rest}"
    )
    return preview(load_scenario(str(tmp_path / "scene.yaml")))


def test_the_prior_along_a_trajectory_is_told_in_the_direction_of_its_states(tmp_path):
    """From 20 km on the y axis, 300 m in y are along the line of sight, and 20 m in x and z across it."""
    axes = "direction: [0, 1, 0], from_altitude_m: 19760, to_altitude_m: 19740, rate_m_s: 1, step_s: 5"
    law = "pose_error: {position_body_m: {normal: [20, 300, 20]}, attitude: {angle_deg: 0}}\n"
    line = in_flight(tmp_path, axes, law)[2]
    pixel_m = 20_000.0 * 2.0 * np.tan(np.radians(10.0)) / 512
    assert f"{20.0 / pixel_m:.3g} px in the place of the body, 300 m along the line of sight" in line


def test_facets_that_are_coarse_at_the_nearest_point_alone_are_told(tmp_path):
    """5,120 facets of a sphere of 250 m have edges of 19 m, 14 px at 1 km above ground."""
    far = "direction: [0, 1, 0], from_altitude_m: 60000, to_altitude_m: {}, rate_m_s: 1, step_s: 1000"
    near, still = in_flight(tmp_path, far.format(1000))[3], in_flight(tmp_path, far.format(59000))[3]
    told = float(re.search(r"px of the surface in view and (\S+) px at the nearest point: coarse", near)[1])
    edge_m = float(re.search(r"edges of (\S+) m", near)[1])
    assert told == pytest.approx(edge_m / (1000.0 * 2.0 * np.tan(np.radians(10.0)) / 512), rel=0.03)
    assert "coarse" not in still


@pytest.fixture
def flown(tmp_path):
    """Scenario of a trajectory in kilometres, the last state inside the body if ``low``."""

    def make(low: bool):
        places = [[2.0, 0.0, 0.0], [0.0, 0.1, 1.5], [0.0, 0.0, 0.05 if low else 1.0]]
        table = pd.DataFrame(places, columns=["x_km", "y_km", "z_km"]).assign(time_s=[10.0, 20.0, 30.0])
        table.assign(vx_km_s=0.0, vy_km_s=1e-4, vz_km_s=2e-5).to_csv(tmp_path / "states.csv", index=False)
        (tmp_path / "scene.yaml").write_text(
            "extends: quickstart\nbody: {shape: sphere}\nviewpoint: {trajectory: {table: states.csv}}\n"
            "pose_error: {position_rtn_m: {normal: [5, 20, 3]}, attitude: {angle_deg: {normal: 0.1}}}\n"
            "onboard: {pose_error: {position_cam_m: {normal: [7, 7, 7]}, attitude: {angle_deg: {normal: 0.2}}}}\n"
        )
        return load_scenario(str(tmp_path / "scene.yaml"), SMALL)

    return make


def test_a_state_inside_the_body_is_refused(flown):
    check_bodies(flown(low=False))
    with pytest.raises(BoresightError, match=r"row 2 \(from 0\) of the trajectory is inside the body"):
        check_bodies(flown(low=True))


def test_an_estimator_gets_the_epoch_of_its_state_and_the_covariance_that_is_believed(flown):
    scenario = flown(low=False)
    world = open_world(scenario, choose_variant().name)
    for trial in (1, 4):
        image = world.source.trial_image(3, trial)
        assert np.allclose(image.view.T_cam_body.camera_position_m, [0.0, 100.0, 1500.0], atol=1e-9)
        frame = observe(world, image, 3, trial).frame
        assert frame.time_s == 20.0
        believed = prior_covariance(scenario.spec.onboard.pose_error, frame.prior_T_cam_body, world.camera)
        assert np.array_equal(frame.prior_covariance, believed)
        assert np.allclose(np.diag(believed)[3:], 49.0)
    errors = []
    for trial in range(0, 180, 3):  # the state on the body's x axis, which moves along y and z
        image = world.source.trial_image(3, trial)
        prior = observe(world, image, 3, trial).frame.prior_T_cam_body
        errors.append(prior.camera_position_m - image.view.T_cam_body.camera_position_m)
    along = np.array([0.0, 1e-4, 2e-5]) / np.hypot(1e-4, 2e-5)
    sigmas = np.std([[e[0], e @ along, e @ np.cross([1.0, 0.0, 0.0], along)] for e in errors], axis=0)
    assert sigmas == pytest.approx([5.0, 20.0, 3.0], rel=0.35)


def test_brightness_multiplies_the_radiance_of_each_image_before_the_detector():
    law = "lighting.brightness={uniform: [0.5, 1.5]}"
    ideal = "shot_noise: false, read_noise_e: 0, psf_sigma_px: 0, dark_e_per_s: 0, offset_dn: 0"
    detector = f"detector={{{ideal}, exposure_s: 0.02, bits: 16, gain_e_per_dn: 1, full_well_e: 1.0e+6}}"
    factors = []
    for overrides in ((), (detector,)):
        plain, drawn = (
            open_world(load_scenario("quickstart", (BALL, *SMALL, *overrides, *more)), choose_variant().name)
            for more in ((), (law,))
        )
        for trial in range(12):
            one, other = (world.source.trial_image(3, trial) for world in (plain, drawn))
            assert np.array_equal(one.view.T_cam_body.rotation, other.view.T_cam_body.rotation)
            lit = one.image > 0.2 * one.image.max()
            ratios = other.image[lit] / one.image[lit]
            assert np.ptp(ratios) < (1e-6 if not overrides else 2e-3)
            factors.append(float(np.median(ratios)))
    assert np.allclose(factors[:12], factors[12:], atol=1e-3), "the factor does not depend on the detector"
    assert 0.5 <= min(factors) < 0.75 < 1.25 < max(factors) <= 1.5


def test_correlated_keys_of_light_and_detector_reach_the_image():
    """Rows in which brightness and exposure make up for each other give the image of a trial without them."""
    ideal = "shot_noise: false, read_noise_e: 0, psf_sigma_px: 0, dark_e_per_s: 0, offset_dn: 0"
    detector = f"{ideal}, bits: 16, gain_e_per_dn: 1, full_well_e: 1.0e+6"
    rows = (
        f"detector={{{detector}, exposure_s: {{choice: [0.01, 0.02, 0.04]}}}}",
        "lighting.brightness={choice: [2, 1, 0.5]}",
        "correlated={keys: [lighting.brightness, detector.exposure_s], same_row: true}",
    )
    plain, together, apart = (
        open_world(load_scenario("quickstart", (BALL, *SMALL, *more)), choose_variant().name).source
        for more in ((f"detector={{{detector}, exposure_s: 0.02}}",), rows, rows[:2])
    )
    unlike = 0
    for trial in range(6):
        one, other, free = (source.trial_image(3, trial).image for source in (plain, together, apart))
        np.testing.assert_allclose(one, other, atol=1.0)  # a digital number, by rounding
        unlike += bool(np.abs(one - free).max() > 100.0)
    assert unlike > 1


def test_estimators_are_not_told_which_values_were_drawn_together():
    keys = "correlated={keys: [viewpoint.range_m, viewpoint.off_pointing_deg], correlation: [[1, 0.9], [0.9, 1]]}"
    laws = ("viewpoint.range_m={uniform: [1800, 2500]}", "viewpoint.off_pointing_deg={normal: 1}")
    world = open_world(load_scenario("quickstart", (BALL, *SMALL, *laws, keys)), choose_variant().name)
    drawn = [world.source.view(3, trial).T_cam_body.translation_m for trial in range(40)]
    ranges, off = np.linalg.norm(drawn, axis=1), [np.hypot(x, y) for x, y, _ in drawn]
    assert 1800.0 <= ranges.min() < ranges.max() <= 2500.0
    assert np.ptp(off) > 10.0
    priors = [
        prior_covariance(world.scenario.spec.pose_error, look_at(np.array([0, 0, r])), world.camera) for r in ranges
    ]
    frame = observe(world, world.source.trial_image(3, 1), 3, 1).frame
    assert frame.prior_covariance == pytest.approx(priors[0])


CRATERS = "craters={count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6, known_diameter_m: 30}"


@pytest.fixture
def approach(tmp_path):
    """Path of a scenario with ten states at 2000, 2100, ... m on the x axis, the Sun behind the first eight."""
    table = pd.DataFrame({"time_s": np.arange(10.0), "x_m": 2000.0 + 100.0 * np.arange(10.0), "y_m": 0.0, "z_m": 0.0})
    far = np.arange(10) >= 8
    table.assign(sun_x=np.where(far, 0.0, 1.0), sun_y=np.where(far, 1.0, 0.0), sun_z=0.0).to_csv(
        tmp_path / "states.csv", index=False
    )
    (tmp_path / "scene.yaml").write_text(
        "extends: quickstart\nbody: {shape: sphere}\nlighting: null\nviewpoint: {trajectory: {table: states.csv}}\n"
    )
    return str(tmp_path / "scene.yaml")


@pytest.mark.parametrize(
    ("order", "trials", "flown", "ranges", "phases"),
    [
        ("in-turn", 8, "8 of 10 states are flown, one in each trial; ", "2000 to 2700", "0"),
        ("in-turn", 1, "1 of 10 states is flown, one in each trial; ", "2000", "0"),
        ("in-turn", 10, "10 ", "2000 to 2900", "0 to 90"),
        ("in-turn", None, "10 ", "2000 to 2900", "0 to 90"),
        ("random", 8, "10 ", "2000 to 2900", "0 to 90"),
    ],
)
def test_the_states_of_the_trials_are_described(approach, order, trials, flown, ranges, phases):
    views, states, *_ = preview(load_scenario(approach, [f"viewpoint.trajectory.order={order}"]), trials=trials)
    assert states == f"trajectory: {flown}states over 9 s in body axes; if they are inertial, give trajectory.rotation"
    assert f"range {ranges} m," in views
    assert f"phase angle {phases} deg" in views


def test_inertial_states_are_described_as_such(approach):
    rotation = "viewpoint.trajectory.rotation={pole_ra_deg: 0, pole_dec_deg: 90, rate_deg_day: 0}"
    said = preview(load_scenario(approach, [rotation]))[1]
    assert said == "trajectory: 10 states over 9 s in inertial axes, turned to body axes by trajectory.rotation"


def test_states_of_kernels_are_in_the_frame_of_the_body(approach):
    """Kernels are not read again: the states stand for theirs."""
    scenario = load_scenario(approach)
    kernels = SpiceTrajectorySpec.model_construct(target_frame="ITOKAWA_FIXED")
    trajectory = scenario.spec.viewpoint.trajectory.model_copy(update={"table": None, "spice": kernels})
    viewpoint = scenario.spec.viewpoint.model_copy(update={"trajectory": trajectory})
    read = replace(scenario, spec=scenario.spec.model_copy(update={"viewpoint": viewpoint}))
    assert preview(read)[1] == "trajectory: 10 states over 9 s in ITOKAWA_FIXED"


def test_a_sequence_flies_all_states_whatever_the_trials_are():
    flight = "hover: {position_m: [600, 0, 0], duration_s: 300, step_s: 100}"
    given = f"sequence={{sphere_radius_m: 190, trajectory: {{{flight}}}}}"
    said = preview(load_scenario("apophis-sphere-sequence", [given]), trials=2)[1]
    assert said == "trajectory: 4 states over 300 s in body axes; if they are inertial, give trajectory.rotation"


@pytest.mark.parametrize(
    ("sun", "phase", "dark"), [("[1, 0, 0]", "0", "and 0 %"), ("[-1, 0, 0]", "180", "and 100 %")], ids=["lit", "dark"]
)
def test_a_sequence_of_images_tells_the_light_and_the_nearest_ground(tmp_path, sun, phase, dark):
    """The descent is from 300 to 20 m above a ball of 250 m: a pixel is that of the ground, not that of the centre."""
    (tmp_path / "scene.yaml").write_text(
        "extends: apophis-sphere-images\nbody: {shape: sphere}\nsequence:\n"
        "  trajectory:\n    descent: {direction: [1, 0, 0], from_altitude_m: 300, to_altitude_m: 20, rate_m_s: 1,"
        f" step_s: 20}}\n    sun_dir: {sun}\n",
        encoding="utf-8",
    )
    views, _, facets, *signal = preview(load_scenario(str(tmp_path / "scene.yaml")))
    assert f"phase angle {phase} deg in 40 views" in views and f"{dark} of the rest in the dark" in views
    told = re.search(r"edges of ([\d.]+) m, ([\d.]+) px of the surface in view", facets)
    m_per_px = float(told[1]) / float(told[2])
    focal_px = 512.0 / np.tan(np.radians(15.0))
    if phase == "0":
        assert 20.0 < m_per_px * focal_px < 300.0
        assert signal[0].startswith("lit surface: median")
    else:
        assert m_per_px * focal_px == pytest.approx(250.0 + 160.0, rel=0.05), "nothing is lit: the median range"
        assert not signal


def test_a_run_describes_the_states_of_its_trials(approach, tmp_path):
    (tmp_path / "campaign.yaml").write_text("scenarios: [scene.yaml]\nestimators: [centroid]\ntrials: 3\nseed: 1\n")
    read = read_campaign(str(tmp_path / "campaign.yaml"))
    for trials, flown in ((None, 3), (5, 5)):
        said = preflight(read.scenarios, read.loaded.spec, trials=trials)[1]
        assert said.startswith(f"scene: trajectory: {flown} of 10 states are flown, one in each trial; ")


@pytest.mark.parametrize("more", [("body.detail.facets=5000",), (CRATERS, "body.detail=null")], ids=["mesh", "craters"])
def test_altitudes_are_above_the_surface_that_is_rendered(more):
    scenario = load_scenario("quickstart", (BALL, *SMALL, *more, "viewpoint.altitude_m=250"))
    check_bodies(scenario)
    world = open_world(scenario, choose_variant().name)
    for trial in range(12):
        view = world.source.view(3, trial)
        centre = np.array([[view.camera.cx_px, view.camera.cy_px]])
        hit = world.renderer.surface(view, centre).points_body_m[0]
        assert np.linalg.norm(view.T_cam_body.camera_position_m - hit) == pytest.approx(250.0, abs=0.01)
    radii_m = np.linalg.norm(world.body.mesh.vertices_m, axis=1)
    ends = dict.fromkeys(f"{250.0 + radius_m:.4g}" for radius_m in (radii_m.min(), radii_m.max()))
    assert f"range {' to '.join(ends)} m" in preview(scenario)[0]


def test_images_of_data_bases_are_from_the_median_altitude():
    overrides = (BALL, *SMALL, "body.detail.facets=5000", "viewpoint.altitude_m={log_uniform: [100, 400]}")
    scenario = load_scenario("quickstart", overrides)
    for image in database_images(scenario, range(4), (0.0, 60.0), 1, choose_variant().name):
        position_m = image.view.T_cam_body.camera_position_m
        range_m = float(np.linalg.norm(position_m))
        mesh = open_world(scenario, choose_variant().name).body.mesh
        assert range_m - mesh.distance_along_m(position_m / range_m) == pytest.approx(200.0)
    assert typical_range_m(scenario) == pytest.approx(200.0 + np.cbrt(0.75 * mesh.volume_m3 / np.pi))
