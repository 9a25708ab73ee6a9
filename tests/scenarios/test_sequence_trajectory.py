"""Sequences along given states: against the same way as an orbit, closed forms of kernels, and other solvers."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import spiceypy
import trimesh
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from tiny_mission import KERNELS, START_ET, SUN_FROM_BODY_KM, make_mission

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, look_at
from boresight.scenarios.load import canonical_json, digest, load_scenario
from boresight.scenarios.sequences import MeshGround, SphereGround, draw_sequence, nominal_trajectory
from boresight.scenarios.sequences.track_simulation import Visibility, simulate_tracks
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.sequence import SequenceSpec
from boresight.scenarios.spec.tables import columns_of
from boresight.scenarios.spice import loaded_kernels

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))
GROUND = SphereGround(190.0)
ORBIT = "orbit: {step_deg: 4, revolutions: 0.5, normal_body: [0.2, -0.4, 1]}"
SPIN = "body_motion: {kind: spin, period_h: 20}"
# Body and inertial axes agree at the first frame: the meridian is on the inertial x axis at time 0.
ROTATION = "rotation: {pole_ra_deg: -90, pole_dec_deg: 90, rate_deg_day: 432}"
HOVER = "hover: {position_m: [790, 100, 50], duration_s: 6000, step_s: 600}"
FLYBY = "flyby: {periapsis_m: 500, v_infinity_m_s: 0.1, gm_m3_s2: 3.54, duration_s: 8000, step_s: 400}"
DESCENT = "descent: {direction: [1, 0, 0], from_altitude_m: 710, to_altitude_m: 50, rate_m_s: 0.1, step_s: 300}"
UNKNOWING = "knowledge: {motion_error: 0.3}"


@pytest.fixture
def section_of(tmp_path):
    """Load a sequence about a sphere of 190 m, with the tables of the folder."""

    def make(*keys: str) -> SequenceSpec:
        text = "\n  ".join(("sequence:", "sphere_radius_m: 190", *keys))
        (tmp_path / "scene.yaml").write_text(f"camera: {{width_px: 1024, height_px: 1024, fov_deg: 30}}\n{text}\n")
        return load_scenario(str(tmp_path / "scene.yaml")).spec.sequence

    return make


def save(path, file, *, body_axes, velocities=True, start_s=0.0):
    """Write the states of a trajectory to a table, in body or in inertial axes."""
    turns = path.R_body_inertial if body_axes else np.tile(np.eye(3), (len(path.times_s), 1, 1))
    columns = {"time_s": start_s + path.times_s}
    parts = {"x_m y_m z_m": path.positions_m}
    if velocities:
        parts["vx_m_s vy_m_s vz_m_s"] = path.velocities_m_s
    for names, values in parts.items():
        columns |= dict(zip(names.split(), np.einsum("nij,nj->in", turns, values), strict=True))
    pd.DataFrame(columns).to_parquet(file)


@pytest.mark.parametrize("body_axes", [True, False])
def test_the_states_of_an_orbit_are_seen_as_the_orbit_is(section_of, tmp_path, body_axes):
    orbit = section_of(ORBIT, SPIN, "vision: {lit_only: true}", UNKNOWING)
    file, turning = tmp_path / "way.parquet", SPIN if body_axes else ""
    save(nominal_trajectory(orbit, GROUND), file, body_axes=body_axes)
    way = f"trajectory: {{table: way.parquet, sun_dir: [0.2, -0.4, 1]{'' if body_axes else ', ' + ROTATION}}}"
    flown = section_of(way, turning, "vision: {lit_only: true}", UNKNOWING)
    assert flown.frames == orbit.frames
    (true, seen), (other, again) = (draw_sequence(one, CAMERA, GROUND, 3, 1) for one in (orbit, flown))
    assert [len(frame.tracks) for frame in seen.frames] == [len(frame.tracks) for frame in again.frames]
    for name in ("times_s", "positions_m", "velocities_m_s", "R_body_inertial", "suns_body"):
        found, wanted = (getattr(one.trajectory, name) for one in (other, true))
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-7)
    for pose, wanted in zip(other.poses, true.poses, strict=True):
        np.testing.assert_allclose(pose.rotation, wanted.rotation, atol=1e-11)
    for frame, wanted in zip(again.frames, seen.frames, strict=True):
        np.testing.assert_allclose(frame.uv_px, wanted.uv_px, atol=1e-5)
        np.testing.assert_allclose(frame.motion_m, wanted.motion_m, atol=1e-6)
    assert np.isnan(other.anomaly_deg).all()
    assert other.trajectory.radiation_m_s2.tolist() == [0, 0, 0]


def test_without_velocities_they_are_differences_and_north_is_up(section_of, tmp_path):
    path = nominal_trajectory(section_of("orbit: {step_deg: 1, revolutions: 0.2}"), GROUND)
    save(path, tmp_path / "way.parquet", body_axes=True, velocities=False, start_s=-500.0)
    found = nominal_trajectory(section_of("trajectory: {table: way.parquet}"), GROUND)
    assert found.times_s[0] == 0.0
    np.testing.assert_allclose(found.velocities_m_s[1:-1], path.velocities_m_s[1:-1], rtol=1e-4, atol=1e-5)
    for pose, place in zip(found.poses, path.positions_m, strict=True):
        np.testing.assert_allclose(pose.rotation, look_at(place).rotation, atol=1e-12)
    np.testing.assert_allclose(found.suns_body, np.tile(path.positions_m[0] / 790.0, (len(found.poses), 1)))


def test_a_vertical_velocity_has_no_direction_for_the_roll(section_of, tmp_path):
    up = np.array([0.3, -0.5, 0.7]) / np.linalg.norm([0.3, -0.5, 0.7])
    columns = {"time_s": [0, 10, 20]}
    for k, axis in enumerate("xyz"):
        columns |= {f"{axis}_m": np.array([900, 800, 700]) * up[k], f"v{axis}_m_s": -10 * up[k]}
    pd.DataFrame(columns).to_csv(tmp_path / "way.csv", index=False)
    path = nominal_trajectory(section_of("trajectory: {table: way.csv}"), GROUND)
    for pose in path.poses:
        np.testing.assert_allclose(pose.rotation, look_at(up).rotation, atol=1e-9)


def test_attitudes_of_a_table_are_those_of_the_frames(section_of, tmp_path):
    turns = Rotation.from_euler("xyz", [[10, 20, 30], [80, -40, 170], [5, 0, -5]], degrees=True)
    table = {"time_s": [0, 60, 120], "x_m": [700, 710, 720], "y_m": 0.0, "z_m": [0, 5, 10], "sun_x": 0.6, "sun_y": 0.8}
    quaternions = dict(zip(("qw", "qx", "qy", "qz"), turns.as_quat(scalar_first=True).T, strict=True))
    pd.DataFrame({**table, "sun_z": 0.0, **quaternions}).to_csv(tmp_path / "way.csv", index=False)
    path = nominal_trajectory(section_of("trajectory: {table: way.csv}", SPIN), GROUND)
    np.testing.assert_allclose([pose.rotation for pose in path.poses], turns.as_matrix(), atol=1e-12)
    np.testing.assert_allclose([pose.camera_position_m for pose in path.poses][2], [720, 0, 10], atol=1e-9)
    np.testing.assert_allclose(path.suns_body, [[0.6, 0.8, 0.0]] * 3)


def test_a_flyby_is_flown_in_inertial_space_with_known_forces(section_of):
    """Over a rotating body, whose pole is not that of the flyby."""
    tilted = ROTATION.replace("dec_deg: 90", "dec_deg: 40").replace("rate", "meridian_deg: 70, rate")
    section = section_of(
        f"trajectory: {{{FLYBY}, {tilted}, sun_dir: [0, 3, 4]}}",
        "knowledge: {dynamics: true, gm_sigma: 0.1, velocity_sigma_m_s: 0.001}",
    )
    truth, sequence = draw_sequence(section, CAMERA, GROUND, 3, 0)
    path = truth.trajectory

    def pull(_, y):
        return np.concatenate([y[3:], -3.54 * y[:3] / np.linalg.norm(y[:3]) ** 3])

    start = np.concatenate([path.positions_m[0], path.velocities_m_s[0]])
    found = solve_ivp(pull, path.times_s[[0, -1]], start, "DOP853", t_eval=path.times_s, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(found.y[:3].T, path.positions_m, atol=1e-4)
    assert np.ptp(path.R_body_inertial, axis=0).max() > 0.5
    # Sun and states are given in the same inertial axes: the angle between them is the same in body axes.
    places = np.array([pose.camera_position_m for pose in truth.poses])
    wanted = [place @ [0.0, 0.6, 0.8] for place in columns_of(section.trajectory.flyby.states(), ("x_m", "y_m", "z_m"))]
    np.testing.assert_allclose(np.sum(places * path.suns_body, axis=1), wanted, atol=1e-6)
    assert truth.gm_m3_s2 == 3.54
    assert sequence.forces.gm_m3_s2 == pytest.approx(3.54, rel=0.5)
    assert sequence.forces.gm_m3_s2 != 3.54
    assert sequence.forces.velocity_m_s == pytest.approx(path.velocities_m_s[0], abs=0.006)


def test_tracks_are_lost_as_the_ground_comes_nearer(section_of):
    """Straight down no view changes its direction; of tracks near the nadir, which stay in view, k^(scale) go on."""
    section = section_of(f"trajectory: {{{DESCENT}}}", "vision: {landmarks_per_frame: 4000, min_connection: 0}")
    views = nominal_trajectory(section, GROUND).views(CAMERA)
    draws = [
        simulate_tracks(section.vision, Visibility(GROUND), views, 40_000, np.random.default_rng(1), by_scale=by_scale)
        for by_scale in (True, False)
    ]
    heights = np.array([np.linalg.norm(view.T_cam_body.camera_position_m) for view in views]) - 190.0
    for i in (5, 15, len(views) - 2):
        shares = []
        for tracks in draws:
            last, after = tracks.seen[i], tracks.seen[i + 1]
            near = last[Visibility(GROUND).visible(tracks.points_m[last], tracks.points_m[last] / 190.0, views[i + 1])]
            shares.append((np.isin(near, after).mean(), len(near)))
        keep = 0.9 ** (np.degrees(np.log(heights[i] / heights[i + 1])) / 2.0)
        (share, n), (whole, _) = shares
        assert whole == 1.0
        assert share == pytest.approx(keep, abs=5.0 * np.sqrt(keep * (1.0 - keep) / n) + 0.005), f"of {n}"


def test_tracks_are_lost_by_the_true_height_above_a_large_body():
    """The height is that of the ground below, however large the body; a mesh is met by the ray to the origin."""
    at = np.array([[0.0, 0.0, 8440.0], [5000.0, 10.0, -20.0]])
    assert SphereGround(8400.0).heights_m(at)[0] == pytest.approx(40.0)
    box = trimesh.creation.box((8000.0, 6000.0, 2 * 8400.0))
    ground = MeshGround(TriangleMesh(box.vertices, box.faces))
    np.testing.assert_allclose(ground.heights_m(at), [40.0, 1000.0], rtol=1e-3)


def test_a_field_that_cannot_be_kept_up_near_the_ground_is_refused(section_of):
    section = section_of(f"trajectory: {{{DESCENT}}}", "vision: {field: fixed, tracked_share: 0.9}")
    views = nominal_trajectory(section, GROUND).views(CAMERA)
    with pytest.raises(BoresightError, match=r"tracked_share 0\.9 cannot be kept up where 0\.\d+ of .* shorter steps"):
        simulate_tracks(section.vision, Visibility(GROUND), views, 100, np.random.default_rng(1), by_scale=True)


def test_a_camera_that_rests_is_not_known_to_rest(section_of):
    """Methods invert the covariance of the motion; a nanometre of rounding is no information either."""
    for more in ("", f", {ROTATION}"):
        section = section_of(f"trajectory: {{{HOVER}{more}}}", UNKNOWING)
        draw = draw_sequence(section, CAMERA, GROUND, 1, 0)
        for frame in draw[1].frames[1:]:
            sigmas = np.sqrt(np.diag(frame.motion_covariance_m2))
            np.testing.assert_allclose(sigmas, 0.3 * 1e-6 * np.linalg.norm([790, 100, 50]) / np.sqrt(3.0))


def test_a_hover_over_a_spinning_body_is_at_rest_in_the_axes_that_it_is_given_in(section_of):
    over, among_stars = (
        nominal_trajectory(section_of(f"trajectory: {{{HOVER}{more}}}", motion), GROUND)
        for more, motion in (("", SPIN), (f", {ROTATION}", ""))
    )
    body = np.array([pose.camera_position_m for pose in over.poses])
    np.testing.assert_allclose(body, [[790, 100, 50]] * 11, atol=1e-9)
    np.testing.assert_allclose(among_stars.positions_m, [[790, 100, 50]] * 11, atol=1e-9)
    np.testing.assert_allclose(over.R_body_inertial, among_stars.R_body_inertial, atol=1e-12)
    speeds = np.linalg.norm(over.velocities_m_s, axis=1)
    np.testing.assert_allclose(speeds, 2.0 * np.pi / 72_000 * np.hypot(790, 100), rtol=1e-3)


def test_a_stored_sequence_needs_no_table_and_its_digest_is_that_of_the_states(section_of, tmp_path):
    save(nominal_trajectory(section_of(ORBIT), GROUND), tmp_path / "way.parquet", body_axes=True)

    def scenario(*keys):
        section_of(*keys)
        return load_scenario(str(tmp_path / "scene.yaml")).spec

    spec = scenario("trajectory: {table: way.parquet}")
    again = ScenarioSpec.model_validate_json(canonical_json(spec))
    assert again == spec
    assert "orbit" not in spec.model_dump()["sequence"]
    (tmp_path / "way.parquet").rename(tmp_path / "other.parquet")
    assert digest(again) == digest(spec) == digest(scenario("trajectory: {table: other.parquet}"))
    assert digest(spec) != digest(scenario(f"trajectory: {{table: other.parquet, {ROTATION}}}"))
    assert digest(spec) != digest(scenario("trajectory: {table: other.parquet, sun_dir: [0, 1, 0]}"))


def test_a_trajectory_takes_the_place_of_an_inherited_orbit(tmp_path):
    (tmp_path / "scene.yaml").write_text(f"extends: apophis-sphere-sequence\nsequence: {{trajectory: {{{HOVER}}}}}\n")
    sequence = load_scenario(str(tmp_path / "scene.yaml")).spec.sequence
    assert (sequence.frames, sequence.sphere_radius_m) == (11, 190)
    back = load_scenario(str(tmp_path / "scene.yaml"), ["sequence.orbit.step_deg=9"]).spec.sequence
    assert (back.trajectory, back.orbit.step_deg) == (None, 9)


# --- kernels -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    return make_mission(tmp_path_factory.mktemp("mission"))


def with_kernels(mission, more="", last_s=3000.0):
    with loaded_kernels(mission.kernels):
        start, stop = (spiceypy.et2utc(START_ET + offset, "ISOC", 6) for offset in (100.0, last_s))
    file = mission.folder / "scene.yaml"
    file.write_text(
        "camera: {width_px: 64, height_px: 64, fov_deg: 30}\nsequence:\n  trajectory: {spice: {"
        f"kernels: [{', '.join(KERNELS)}], observer: HAYABUSA, target: ITOKAWA, target_frame: ITOKAWA_FIXED,"
        f" camera_frame: HAYABUSA_AMICA, start_utc: '{start}', stop_utc: '{stop}', step_s: 600, aberration: NONE}}}}\n"
        f"{more}"
    )
    return load_scenario(str(file)).spec.sequence


def test_kernels_have_the_rotation_of_the_body_and_the_sun(mission):
    """The spacecraft rests beside a body that spins; inertial axes are the body's at the first frame."""
    section = with_kernels(mission, "  knowledge: {spin_sigma: 0.01}\n")
    path, times = nominal_trajectory(section, GROUND), START_ET + 100.0 + 600.0 * np.arange(5)
    to_body = np.array([mission.R_body_j2000(et) for et in times])
    np.testing.assert_allclose(path.R_body_inertial, to_body @ to_body[0].T, atol=1e-9)
    place = -1e3 * to_body[0] @ mission.body_from_craft_km
    np.testing.assert_allclose(path.positions_m, np.tile(place, (5, 1)), atol=1e-3)
    np.testing.assert_allclose(path.velocities_m_s, 0.0, atol=1e-6)
    for pose, turn in zip(path.poses, to_body, strict=True):
        np.testing.assert_allclose(pose.rotation, mission.R_cam_j2000 @ turn.T, atol=1e-9)
    sun = to_body @ SUN_FROM_BODY_KM / np.linalg.norm(SUN_FROM_BODY_KM)
    np.testing.assert_allclose(path.suns_body, sun, atol=1e-3)


@pytest.mark.parametrize(
    ("more", "last_s", "said"),
    [
        ("", 90000.0, "trajectory: spice cannot be used: SPICE: .*insufficient"),
        ("", 200.0, "trajectory: a sequence needs two states at least"),
        (f"  {SPIN}\n", 3000.0, r"body_motion has no part where trajectory\.spice has the body's rotation"),
    ],
)
def test_kernels_that_do_not_go_with_it_are_one_line(mission, more, last_s, said):
    with pytest.raises(BoresightError, match=said) as caught:
        with_kernels(mission, more, last_s)
    assert "\n" not in str(caught.value)


# --- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ([ORBIT, f"trajectory: {{{HOVER}}}"], "give either orbit or trajectory, not both"),
        ([f"trajectory: {{{HOVER}, {ROTATION}}}", SPIN], r"body_motion has no part where trajectory\.rotation has"),
        ([f"trajectory: {{{FLYBY}}}", SPIN], r"body_motion: a flyby is in inertial axes: give .* trajectory\.rotation"),
        ([f"trajectory: {{{HOVER}}}", "knowledge: {dynamics: true}"], r"knowledge\.dynamics: only orbit and traj"),
        (
            [f"trajectory: {{{HOVER}}}", "knowledge: {spin_sigma: 0.1}"],
            r"knowledge\.spin_sigma: the body does",
        ),
        ([f"trajectory: {{{HOVER}}}", "images: {starts: 4}"], r"images\.starts has no part where trials begin at"),
        ([f"trajectory: {{{HOVER}, order: random}}"], r"trajectory\.order: unknown key"),
        ([f"trajectory: {{{HOVER}, sun_dir: [0, 0, 0]}}"], "sun_dir is zero"),
        (
            [f"trajectory: {{{HOVER.replace('790', '90')}}}"],
            r"row 0 \(from 0\), at 143\.\d+ m, is not above",
        ),
        (["trajectory: {table: one.csv}"], r"one\.csv cannot be used: table: one\.csv was not found"),
        ([f"trajectory: {{{DESCENT}}}", "vision: {field: fixed, tracked_share: 0.99, repeatability: 0.0001}"], None),
        (
            [f"trajectory: {{{FLYBY}}}", "vision: {field: fixed, tracked_share: 0.9, repeatability: 0.1}"],
            r"vision\.tracked_share 0.9 cannot be kept up where 1 of the tracks",
        ),
    ],
)
def test_what_does_not_go_together_is_one_line(section_of, keys, said):
    if said is None:  # straight down no view changes its direction
        assert section_of(*keys).frames == 23
        return
    with pytest.raises(BoresightError, match=said) as caught:
        section_of(*keys)
    assert "\n" not in str(caught.value)


def test_a_sequence_needs_two_states(section_of, tmp_path):
    (tmp_path / "way.csv").write_text("time_s,x_m,y_m,z_m\n0,500,0,0\n")
    with pytest.raises(BoresightError, match="a sequence needs two states at least"):
        section_of("trajectory: {table: way.csv}")
    # A flight has its first and its last state, however long the steps are.
    assert section_of(f"trajectory: {{{HOVER.replace('6000', '60')}}}").frames == 2


def test_the_sun_is_said_once(section_of, tmp_path):
    rows = pd.DataFrame({"time_s": [0, 1], "x_m": 500, "y_m": 0, "z_m": 0, "sun_x": 1, "sun_y": 0, "sun_z": 0})
    rows.to_csv(tmp_path / "way.csv", index=False)
    with pytest.raises(BoresightError, match="sun_dir has no part where the states have the Sun"):
        section_of("trajectory: {table: way.csv, sun_dir: [0, 0, 1]}")
