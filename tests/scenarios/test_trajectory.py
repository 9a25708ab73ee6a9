"""Views of a table of states, against SPICE, scipy and closed forms."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import spiceypy
from scipy import stats
from scipy.spatial.transform import Rotation
from tiny_mission import KERNELS, START_ET, SUN_FROM_BODY_KM, make_mission

from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import (
    Stream,
    degrade,
    draw_aimed_view,
    draw_view,
    generator,
    prior_covariance,
    state_of_trial,
)
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import canonical_json, digest, load_scenario
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.trajectory import RotationSpec
from boresight.scenarios.spice import SpiceNames, apparent_geometry, loaded_kernels

TIMES = np.array([-7200.0, 0.0, 600.0, 90000.0])
POSITIONS = np.array([[2000.0, 0.0, 100.0], [0.0, -1500.0, 0.0], [300.0, 400.0, -1200.0], [-900.0, 900.0, 900.0]])
VELOCITIES = np.array([[0.0, 0.1, 0.0], [0.2, 0.0, 0.1], [-0.1, 0.1, 0.0], [0.0, 0.0, 0.3]])
TURNS = Rotation.from_euler("xyz", [[10, 20, 30], [80, -40, 170], [5, 0, -5], [0, 90, 45]], degrees=True)
SUNS = np.array([[1.0, 0.0, 0.0], [0.0, -0.6, 0.8], [0.0, 0.0, -1.0], [-0.6, 0.64, 0.48]])


def table_of(positions=POSITIONS, velocities=None, turns=None, suns=None, times=TIMES) -> pd.DataFrame:
    columns = {"time_s": times} | dict(zip(("x_m", "y_m", "z_m"), positions.T, strict=True))
    if velocities is not None:
        columns |= dict(zip(("vx_m_s", "vy_m_s", "vz_m_s"), velocities.T, strict=True))
    if turns is not None:
        columns |= dict(zip(("qw", "qx", "qy", "qz"), turns.as_quat(scalar_first=True).T, strict=True))
    if suns is not None:
        columns |= dict(zip(("sun_x", "sun_y", "sun_z"), suns.T, strict=True))
    return pd.DataFrame(columns)


@pytest.fixture
def spec_of(tmp_path):
    """Load a scenario with a table of states: ``more`` is added to the trajectory, ``views`` to the viewpoint."""

    def make(table: pd.DataFrame | str, more: str = "", rest: str = "", views: str = "") -> ScenarioSpec:
        file = tmp_path / "states.csv"
        file.write_text(table if isinstance(table, str) else table.to_csv(index=False))
        scene = f"extends: quickstart\nviewpoint: {{trajectory: {{table: states.csv{more}}}{views}}}\n{rest}"
        (tmp_path / "scene.yaml").write_text(scene)
        return load_scenario(str(tmp_path / "scene.yaml")).spec

    return make


def view_of(spec: ScenarioSpec, trial: int, seed: int = 1):
    rng, state = generator(seed, Stream.TRUTH, trial), state_of_trial(spec.viewpoint, seed, trial)
    return draw_view(spec, spec.camera.camera(), rng, state)


def test_views_have_positions_attitudes_and_suns_of_the_table_in_turn(spec_of):
    spec = spec_of(table_of(turns=TURNS, suns=SUNS), rest="lighting: null")
    for trial in range(6):
        view, row = view_of(spec, trial), trial % 4
        assert np.allclose(view.T_cam_body.camera_position_m, POSITIONS[row], rtol=1e-14, atol=1e-10)
        assert np.allclose(view.T_cam_body.rotation, TURNS[row].as_matrix(), atol=1e-14)
        assert np.allclose(view.sun_dir_body, SUNS[row], atol=1e-15)
    ranges = np.linalg.norm(POSITIONS, axis=1)
    assert spec.viewpoint.range_bounds_m == (ranges.min(), ranges.max())
    assert spec.viewpoint.median_range_m == np.median(ranges)


def test_without_attitude_and_sun_these_are_drawn_as_for_any_view(spec_of):
    spec = spec_of(table_of(), rest="lighting: {phase_deg: {uniform: [20, 50]}}")
    for trial in range(40):
        view = view_of(spec, trial)
        assert np.allclose(view.T_cam_body.camera_position_m, POSITIONS[trial % 4], atol=1e-9)
        assert np.allclose(view.T_cam_body.translation_m[:2], 0.0, atol=1e-9)
        assert 20.0 <= np.degrees(view.phase_angle_rad) <= 50.0
    assert len({view_of(spec, trial).T_cam_body.rotation[0, 0] for trial in range(0, 40, 4)}) == 10, "the roll is drawn"


def test_kilometres_and_metres_are_the_same_states(spec_of):
    metres = spec_of(table_of(velocities=VELOCITIES))
    renamed = {f"{p}{a}_m{s}": f"{p}{a}_km{s}" for p, s in (("", ""), ("v", "_s")) for a in "xyz"}
    table = table_of(POSITIONS / 1000.0, VELOCITIES / 1000.0).rename(columns=renamed)
    kilometres = spec_of(table)
    for name in ("position_m", "velocity_m_s"):
        assert np.allclose(getattr(metres.viewpoint.states, name), getattr(kilometres.viewpoint.states, name))


def test_inertial_axes_turn_into_those_of_the_body_as_spice_has_them(spec_of):
    """The IAU's angles in the kernel pool: pole, prime meridian and rate of a made-up body, by SPICE itself."""
    kernel = [
        "BODY2009999_POLE_RA = (312.7 0.0 0.0)", "BODY2009999_POLE_DEC = (-66.4 0.0 0.0)",
        "BODY2009999_PM = (120.5 712.143 0.0)", "FRAME_TINY = 1409999", "FRAME_1409999_NAME = 'TINY'",
        "FRAME_1409999_CLASS = 2", "FRAME_1409999_CLASS_ID = 2009999", "FRAME_1409999_CENTER = 2009999",
    ]  # fmt: skip
    spiceypy.lmpool(kernel)
    try:
        to_body = np.array([spiceypy.pxform("J2000", "TINY", et) for et in TIMES])
    finally:
        spiceypy.clpool()
    rotation = RotationSpec(pole_ra_deg=312.7, pole_dec_deg=-66.4, meridian_deg=120.5, rate_deg_day=712.143)
    assert np.allclose(rotation.matrices(TIMES), to_body, atol=1e-11)
    more = ", rotation: {pole_ra_deg: 312.7, pole_dec_deg: -66.4, meridian_deg: 120.5, rate_deg_day: 712.143}"
    spec = spec_of(table_of(velocities=VELOCITIES, turns=TURNS, suns=SUNS), more, "lighting: null")
    for trial in range(4):
        view = view_of(spec, trial)
        assert np.allclose(view.T_cam_body.camera_position_m, to_body[trial] @ POSITIONS[trial], atol=1e-7)
        assert np.allclose(view.T_cam_body.rotation @ to_body[trial], TURNS[trial].as_matrix(), atol=1e-11)
        assert np.allclose(view.sun_dir_body, to_body[trial] @ SUNS[trial], atol=1e-11)
        assert np.allclose(spec.viewpoint.states.velocity_m_s[trial], to_body[trial] @ VELOCITIES[trial])


def test_brightness_may_be_drawn_where_the_table_has_the_sun(spec_of):
    spec = spec_of(table_of(suns=SUNS), rest="lighting: {brightness: {log_normal: [1, 0.1]}}")
    assert np.allclose(view_of(spec, 1).sun_dir_body, SUNS[1])


def test_stored_states_of_unlike_number_are_refused(spec_of):
    stored = json.loads(canonical_json(spec_of(table_of())))
    stored["viewpoint"]["trajectory"]["read_states"]["position_m"].pop()
    with pytest.raises(ValueError, match="states are of unlike number"):
        ScenarioSpec.model_validate_json(json.dumps(stored))


def test_a_random_order_has_every_state_as_often(spec_of):
    spec = spec_of(table_of(), ", order: random")
    counts = np.bincount([state_of_trial(spec.viewpoint, 3, trial) for trial in range(2000)], minlength=4)
    assert stats.chisquare(counts).pvalue > 1e-4
    assert digest(spec) != digest(spec_of(table_of()))


def test_a_stored_scenario_needs_no_table(spec_of, tmp_path):
    spec = spec_of(table_of(velocities=VELOCITIES, turns=TURNS, suns=SUNS), rest="lighting: null")
    (tmp_path / "states.csv").unlink()
    again = ScenarioSpec.model_validate_json(canonical_json(spec))
    assert again == spec
    assert digest(again) == digest(spec)


def test_the_digest_is_that_of_the_states_whatever_their_file_is_called(spec_of, tmp_path):
    spec = spec_of(table_of())
    table_of().to_parquet(tmp_path / "other.parquet")
    (tmp_path / "scene.yaml").write_text("extends: quickstart\nviewpoint: {trajectory: {table: other.parquet}}\n")
    assert digest(load_scenario(str(tmp_path / "scene.yaml")).spec) == digest(spec)
    assert digest(spec_of(table_of(POSITIONS * 1.001))) != digest(spec)


def test_targets_of_a_trajectory_are_pointed_at_from_its_positions(spec_of):
    spec = spec_of(table_of())
    viewpoint = spec.viewpoint.model_copy(update={"targets": ("limb",)})
    mesh = load_body(spec.body.model_copy(update={"detail": None})).mesh
    view = draw_aimed_view(viewpoint, spec.lighting, spec.camera.camera(), mesh, generator(1, Stream.TRUTH, 2), 2)
    assert np.allclose(view.T_cam_body.camera_position_m, POSITIONS[2], atol=1e-9)
    assert np.linalg.norm(view.T_cam_body.translation_m[:2]) > 10.0


RTN = np.array([[100.0, 90.0, 0.0], [90.0, 400.0, -5.0], [0.0, -5.0, 25.0]])


def test_errors_in_radial_transverse_and_normal_direction(spec_of):
    error = f"pose_error: {{position_rtn_m: {{covariance: {RTN.tolist()}}}, attitude: {{angle_deg: {{normal: 0.01}}}}}}"
    spec = spec_of(table_of(velocities=VELOCITIES), rest=error)
    camera, view, velocity = spec.camera.camera(), view_of(spec, 2), VELOCITIES[2]
    true = view.T_cam_body
    priors = [
        degrade(true, spec.pose_error, camera, generator(3, Stream.POSE_ERROR, trial), velocity)
        for trial in range(1000)
    ]
    errors = np.array([prior.camera_position_m for prior in priors]) - POSITIONS[2]
    radial = POSITIONS[2] / np.linalg.norm(POSITIONS[2])
    normal = np.cross(POSITIONS[2], velocity) / np.linalg.norm(np.cross(POSITIONS[2], velocity))
    parts = np.column_stack([errors @ radial, errors @ np.cross(normal, radial), errors @ normal])
    products = parts[:, :, None] * parts[:, None, :]
    assert (np.abs(products.mean(axis=0) - RTN) < 5.0 * products.std(axis=0) / np.sqrt(1000)).all()
    turns = Rotation.from_matrix([prior.rotation @ true.rotation.T for prior in priors]).as_rotvec()
    off = np.hstack([turns, [prior.translation_m - true.translation_m for prior in priors]])
    nees = [
        e @ np.linalg.solve(prior_covariance(spec.pose_error, prior, camera, velocity), e)
        for e, prior in zip(off, priors, strict=True)
    ]
    assert np.mean(nees) == pytest.approx(6.0, abs=0.6), "an isotropic attitude is no normal law, but of that mean"


# --- SPICE ---------------------------------------------------------------------------------------------------------

SPICE = (
    "spice: {{kernels: [{kernels}], observer: HAYABUSA, target: ITOKAWA, target_frame: ITOKAWA_FIXED{more},"
    " start_utc: '{start}', stop_utc: '{stop}', step_s: 600}}"
)


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    return make_mission(tmp_path_factory.mktemp("mission"))


def with_kernels(mission, more="", kernels=KERNELS, first_s=100.0, last_s=3000.0, rest=""):
    """Load a scenario next to the kernels of a mission."""
    with loaded_kernels(mission.kernels):
        start, stop = (spiceypy.et2utc(START_ET + offset, "ISOC", 6) for offset in (first_s, last_s))
    section = SPICE.format(kernels=", ".join(kernels), more=more, start=start, stop=stop)
    file = mission.folder / "scene.yaml"
    file.write_text(f"extends: quickstart\nviewpoint: {{trajectory: {{{section}}}{rest}}}\nlighting: null\n")
    return load_scenario(str(file)).spec


@pytest.mark.parametrize("camera", ["", ", camera_frame: HAYABUSA_AMICA"])
def test_states_of_kernels_have_their_closed_form(mission, camera):
    spec = with_kernels(mission, f"{camera}, aberration: NONE")
    states = spec.viewpoint.states
    assert np.allclose(states.time_s, START_ET + 100.0 + 600.0 * np.arange(5), atol=1e-4)
    for trial, et in enumerate(states.time_s):
        to_body = mission.R_body_j2000(et)
        view = view_of(spec, trial)
        assert np.allclose(view.T_cam_body.camera_position_m, -1e3 * to_body @ mission.body_from_craft_km, atol=1e-4)
        if camera:
            assert np.allclose(view.T_cam_body.rotation, mission.R_cam_j2000 @ to_body.T, atol=1e-10)
        else:
            assert np.allclose(view.T_cam_body.translation_m[:2], 0.0, atol=1e-6)
        assert np.allclose(view.sun_dir_body @ to_body @ SUN_FROM_BODY_KM, np.linalg.norm(SUN_FROM_BODY_KM), rtol=1e-6)
    assert np.allclose(states.velocity_m_s, 0.0, atol=1e-6), "both fly side by side"


def test_apparent_states_are_those_of_images_from_the_same_kernels(mission):
    states = with_kernels(mission, ", camera_frame: HAYABUSA_AMICA").viewpoint.states
    names = SpiceNames("HAYABUSA", "HAYABUSA_AMICA", "ITOKAWA", "ITOKAWA_FIXED")
    with loaded_kernels(mission.kernels):
        found = apparent_geometry(names, states.time_s[3])
    assert np.array_equal(found.T_cam_body.camera_position_m, states.position_m[3])
    assert np.array_equal(found.sun_dir_body, states.sun_dir[3])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"last_s": 90000.0}, "spice cannot be used: SPICE: .*INSUFF"),
        ({"last_s": 50.0}, r"spice: stop_utc .* is before start_utc "),
        ({"kernels": ("naif.tls", "tiny.bsp", "none.bc")}, "none.bc was not found"),
        ({"kernels": ("naif.tls", "tiny.bsp")}, "spice cannot be used: SPICE: "),
        ({"kernels": ("tiny.bsp",)}, "spice cannot be used: SPICE: .*LEAP"),
        ({"more": ", camera_frame: HAYABUSA_ONC"}, "spice cannot be used: SPICE: .*HAYABUSA_ONC"),
        ({"more": "}, rotation: {pole_ra_deg: 1, pole_dec_deg: 2, rate_deg_day: 3"}, "rotation"),
        ({"more": ", aberration: LT"}, "aberration: 'LT' is not 'LT.S' or 'NONE'"),
    ],
)
def test_kernels_that_do_not_have_it_are_one_line(mission, change, said):
    with pytest.raises(BoresightError, match=said) as caught:
        with_kernels(mission, **change)
    assert "scene.yaml:2: viewpoint.trajectory" in str(caught.value)


# --- bad input -----------------------------------------------------------------------------------------------------

BAD = {
    "no file": ("", "", "states.csv cannot be used"),
    "order": (table_of(times=TIMES[[0, 2, 1, 3]]), "", r"time_s 0 of row 2 \(from 0\) is not after the one before"),
    "column": (table_of().drop(columns="y_m"), "", "no column y_m; it has time_s, x_m, z_m"),
    "part of attitudes": (table_of(turns=TURNS).drop(columns="qw"), "", "no column qw"),
    "part of the Sun": (table_of(suns=SUNS).drop(columns="sun_x"), "", "no column sun_x"),
    "part of velocities": (table_of(velocities=VELOCITIES).drop(columns="vx_m_s"), "", "no column vx_m_s"),
    "number": (table_of(np.where(POSITIONS == 900.0, np.nan, POSITIONS)), "", "row 3 .* is not all numbers"),
    "word": ("time_s,x_m,y_m,z_m\n0,1,2,far\n", "", "could not convert string to float"),
    "origin": (table_of(POSITIONS * [[1], [0], [1], [1]]), "", "a position is the body's origin"),
    "quaternion": (table_of(turns=TURNS).assign(qw=2.0), "", "the quaternion has the length"),
    "Sun": (table_of(suns=SUNS * 1.5e11), "", "the direction to the Sun has the length 1.5e"),
    "unknown": (
        table_of().assign(q0=1.0, sun=2.0),
        "",
        "cannot be used: unknown columns 'q0', 'sun': leave them out; known are time_s, x_m, y_m, z_m, x_km",
    ),
    "time by another name": (
        table_of().rename(columns={"time_s": "t"}),
        "",
        "time_s is missing; unknown columns 't': rename or leave them out; known are time_s, ",
    ),
    "positions by another name": (
        table_of().rename(columns={"x_m": "x", "z_m": "z"}),
        "",
        "x_m, z_m are missing; unknown columns 'x', 'z': rename or leave them out; known are time_s, ",
    ),
    "both units": (table_of().assign(x_km=1.0), "", "x is given in m and in km"),
    "rotation": (table_of(), ", rotation: {pole_ra_deg: 3}", "pole_dec_deg: this key is missing"),
    "empty with a frame": ("time_s,x_m,y_m,z_m,ref_frame\n", "", r"0 states are not within \[1, "),
    "empty": ("time_s,x_m,y_m,z_m\n", "", r"0 states are not within \[1, "),
}


@pytest.mark.parametrize("case", BAD)
def test_a_table_that_cannot_be_used_is_one_line(spec_of, case):
    table, more, said = BAD[case]
    with pytest.raises(BoresightError, match=said) as caught:
        spec_of(table, more)
    assert all("scene.yaml:2: viewpoint.trajectory" in line for line in str(caught.value).splitlines())


@pytest.mark.parametrize(
    ("views", "rest", "said"),
    [
        (", range_m: 2000", "", "not both"),
        (", latitude_deg: {uniform: [0, 1]}", "", "latitude_deg has no part where a trajectory has the views"),
        (", roll_deg: {uniform: [0, 1]}", "", "roll_deg has no part"),
        (", targets: [limb]", "", "targets has no part"),
        ("", "lighting: {phase_deg: 30}", "lighting has no part where the trajectory's table has the Sun"),
        ("", "pose_error: {position_rtn_m: {normal: [1, 1, 1]}}", "needs viewpoint.trajectory, with velocities that"),
    ],
)
def test_keys_that_a_trajectory_leaves_no_part_for_are_refused(spec_of, views, rest, said):
    with pytest.raises(BoresightError, match=said):
        spec_of(
            table_of(turns=TURNS, suns=SUNS), "", f"{'' if 'lighting' in rest else 'lighting: null'}\n{rest}", views
        )
