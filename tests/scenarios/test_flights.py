"""Made-up flights against scipy and closed forms, and messages of ephemerides against tables."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from boresight.scenarios.bodies import load_body
from boresight.scenarios.draw import Stream, draw_view, generator, state_of_trial
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import canonical_json, digest, load_scenario
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.tables import columns_of, read_table
from boresight.scenarios.spec.trajectory import DescentSpec, FlybySpec, HoverSpec

PLACE, SPEED = ("x_m", "y_m", "z_m"), ("vx_m_s", "vy_m_s", "vz_m_s")


def flown(flight, *surface):
    """Return times (n,), positions and, for a flyby, velocities (n, 3)."""
    table = flight.states(*surface)
    parts = [columns_of(table, ("time_s",))[:, 0], columns_of(table, PLACE)]
    return (*parts, columns_of(table, SPEED)) if SPEED[0] in table else tuple(parts)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, -0.5, 0.8), (2, 0, 0)])
def test_a_flyby_is_what_scipy_integrates_from_its_first_state(normal):
    gm = 4.9
    flyby = FlybySpec(periapsis_m=700, v_infinity_m_s=0.08, gm_m3_s2=gm, duration_s=40_000, step_s=2000, normal=normal)
    times, places, speeds = flown(flyby)
    assert (times == 2000.0 * np.arange(-10, 11)).all()
    start = np.concatenate([places[0], speeds[0]])

    def pull(_, y):
        return np.concatenate([y[3:], -gm * y[:3] / np.linalg.norm(y[:3]) ** 3])

    found = solve_ivp(pull, times[[0, -1]], start, "DOP853", t_eval=times, rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(found.y[:3].T, places, atol=1e-5)
    np.testing.assert_allclose(found.y[3:].T, speeds, atol=1e-9)


# Extremes: nearly a parabola, a fast flyby of a small body, and long before and after.
FLYBYS = [
    (700, 0.08, 4.9, 4e4),
    (1e4, 1.5e-5, 1.0, 1e9),
    (2e5, 6e3, 1e-3, 200.0),
    (3e5, 10.0, 4e5, 1e7),
    (1, 1, 1, 1e9),
]


@pytest.mark.parametrize(("periapsis", "v_infinity", "gm", "duration"), FLYBYS)
def test_a_flyby_conserves_energy_momentum_and_lenz_s_vector(periapsis, v_infinity, gm, duration):
    flyby = FlybySpec(
        periapsis_m=periapsis, v_infinity_m_s=v_infinity, gm_m3_s2=gm, duration_s=duration, step_s=duration / 50,
        normal=(0.2, -1, 0.4),
    )  # fmt: skip
    times, places, speeds = flown(flyby)
    ranges, squares = np.linalg.norm(places, axis=1), np.sum(speeds**2, axis=1)
    assert ranges.argmin() == 25
    assert times[25] == pytest.approx(0.0, abs=1e-6 * duration)
    assert ranges[25] == pytest.approx(periapsis, rel=1e-9)
    largest = squares.max()  # of kinetic and potential energy, the difference of which is the energy
    np.testing.assert_allclose(squares - 2.0 * gm / ranges, v_infinity**2, atol=1e-9 * largest)
    momentum, e = np.cross(places, speeds), 1.0 + periapsis * v_infinity**2 / gm
    # h^2 = GM a (e^2 - 1), along the normal.
    size = np.sqrt(gm * periapsis * (1.0 + e))
    normal = np.array([0.2, -1, 0.4]) / np.linalg.norm([0.2, -1, 0.4])
    np.testing.assert_allclose(momentum, np.tile(size * normal, (51, 1)), atol=1e-7 * size)
    lenz = np.cross(speeds, momentum) / gm - places / ranges[:, None]
    np.testing.assert_allclose(lenz, np.tile(e * places[25] / ranges[25], (51, 1)), atol=1e-6 * e)
    # Kepler's equation itself: M = e sinh H - H with r = a (e cosh H - 1), far from where it has no digits.
    far = np.abs(np.arange(51) - 25) > 5
    h = np.arccosh((ranges[far] / (gm / v_infinity**2) + 1.0) / e)
    np.testing.assert_allclose((e * np.sinh(h) - h) * gm / v_infinity**3, np.abs(times[far]), rtol=1e-5)


def test_the_periapsis_is_nearest_to_x_and_passed_about_the_normal():
    _, places, speeds = flown(FlybySpec(periapsis_m=500, v_infinity_m_s=1, gm_m3_s2=1, duration_s=20, step_s=10))
    np.testing.assert_allclose(places[1], [500, 0, 0], atol=1e-9)
    np.testing.assert_allclose(speeds[1], [0, np.sqrt(1 + 2 / 500), 0], atol=1e-12)


def test_a_hover_stays_in_its_box_and_drifts_at_its_speed():
    times, still = flown(HoverSpec(position_m=(0, 500, 80), duration_s=60, step_s=20))
    assert times.tolist() == [0, 20, 40, 60]
    assert (still == [0, 500, 80]).all()
    _, places = flown(HoverSpec(position_m=(0, 500, 80), duration_s=20_000, step_s=2, box_m=30, drift_m_s=0.05))
    away = places - [0, 500, 80]
    assert np.abs(away).max() <= 30
    assert (np.abs(away).max(axis=0) > 29.8).all()
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert np.quantile(steps, [0.05, 0.95]) == pytest.approx(0.1)
    assert steps.max() <= 0.1 + 1e-9, "it turns within a step at most"


def test_steps_of_a_flyby_are_no_longer_than_stated_and_meet_the_periapsis():
    way = {"periapsis_m": 900, "v_infinity_m_s": 0.2, "gm_m3_s2": 5, "duration_s": 10_000}
    for step_s, states in ((3000, 5), (5000, 3), (20_000, 3), (1000, 11)):
        times, places, _ = flown(FlybySpec(**way, step_s=step_s))
        assert (len(times), times[0], times[-1]) == (states, -5000, 5000)
        assert np.linalg.norm(places, axis=1).min() == pytest.approx(900)


def test_a_descent_has_a_constant_rate_and_ends_above_its_last_distance():
    way = {"direction": (0, 3, 4), "from_altitude_m": 850, "to_altitude_m": 90, "rate_m_s": 0.5, "step_s": 150}
    times, places = flown(DescentSpec(**way), lambda _, up: 150.0)
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 1000 - 0.5 * times)
    np.testing.assert_allclose(places[0], [0, 600, 800])
    # 1520 s in eleven equal steps, which are not longer than 150 s.
    assert np.linalg.norm(places[-1]) == pytest.approx(240)
    np.testing.assert_allclose(np.diff(times), 1520 / 11)
    whole = {"from_altitude_m": 150, "rate_m_s": 0.1, "step_s": 60}
    assert len(flown(DescentSpec(**way | whole), lambda _, up: 150.0)[0]) == 11


@pytest.mark.parametrize("more", ["", "rotation: {pole_ra_deg: -90, pole_dec_deg: 90, rate_deg_day: 10800}"])
def test_a_descent_ends_at_its_height_above_the_facet_below_its_end(tmp_path, more):
    """Of a box of 400 x 200 x 200 m the camera comes down on +x, or after a turn by 90 deg in 720 s on -y."""
    trimesh.creation.box((400.0, 200.0, 200.0)).export(tmp_path / "box.obj")
    descent = "{direction: [1, 0, 0], from_altitude_m: 770, to_altitude_m: 50, rate_m_s: 1, step_s: 240}"
    box = f"body: {{shape: box.obj, unit: m, detail: null}}\nviewpoint: {{trajectory: {{descent: {descent}, {more}}}}}"
    spec = load(tmp_path, box)
    end = [0, -150, 0] if more else [250, 0, 0]
    np.testing.assert_allclose(spec.viewpoint.states.position_m[-1], end, atol=1e-9)
    assert np.linalg.norm(spec.viewpoint.states.position_m[0]) == pytest.approx(np.linalg.norm(end) + 720)
    sphere = f"sequence: {{sphere_radius_m: 90, trajectory: {{descent: {descent}}}}}\nviewpoint: null"
    assert load(tmp_path, sphere).sequence.trajectory.states.position_m[-1] == pytest.approx((140, 0, 0))


def test_a_descent_needs_a_surface(tmp_path):
    descent = "descent: {direction: [1, 0, 0], from_altitude_m: 770, to_altitude_m: 50, rate_m_s: 1, step_s: 240}"
    for body, said in (
        ("body: {shape: none.obj}", "descent cannot be used: body.shape: none.obj was not found"),
        ("body: {unit: inch}", "the surface below it is not known, as body or craters are wrong"),
        ("body: {shape: sphere, detail: null}\ncraters: {}", "craters.known_diameter_m: missing"),
    ):
        with pytest.raises(BoresightError, match=said):
            load(tmp_path, f"{body}\nviewpoint: {{trajectory: {{{descent}}}}}")


BARE = "body: {detail: null}\n"
FLIGHTS = {
    "flyby": "{periapsis_m: 2000, v_infinity_m_s: 0.5, gm_m3_s2: 2.34, duration_s: 4000, step_s: 1000}",
    "hover": "{position_m: [2000, 100, 0], duration_s: 4000, step_s: 1000, box_m: 20, drift_m_s: 0.01}",
    "descent": "{direction: [1, 0, 1], from_altitude_m: 2800, to_altitude_m: 800, rate_m_s: 0.5, step_s: 1000}",
}


def load(folder, text):
    (folder / "scene.yaml").write_text(f"extends: quickstart\n{text}\n")
    return load_scenario(str(folder / "scene.yaml")).spec


@pytest.mark.parametrize("kind", FLIGHTS)
def test_views_of_single_images_are_those_of_the_flight_in_turn(tmp_path, kind):
    """With a rotation the states are in inertial axes, without one in those of the body."""
    turning = "rotation: {pole_ra_deg: -90, pole_dec_deg: 90, rate_deg_day: 720}"
    flown_as = f"{BARE}viewpoint: {{trajectory: {{{kind}: {FLIGHTS[kind]}, %s}}}}"
    still, turned = (load(tmp_path, flown_as % more) for more in ("", turning))
    flight = getattr(still.viewpoint.trajectory, kind)
    mesh = load_body(still.body).mesh

    def to_body(times):
        return Rotation.from_rotvec(np.outer(-720.0 / 86400.0 * times, [0, 0, 1]), degrees=True)

    def place(*surface):
        return flown(flight, *surface if kind == "descent" else [])[:2]

    times, places = place(lambda _, up: mesh.distance_along_m(up))
    np.testing.assert_allclose(still.viewpoint.states.position_m, places)
    _, above = place(lambda time_s, up: mesh.distance_along_m(to_body(time_s).apply(up)[0]))
    np.testing.assert_allclose(turned.viewpoint.states.position_m, to_body(times).apply(above), atol=1e-9)
    camera = still.camera.camera()
    for trial in (1, len(times) + 1):
        view = draw_view(still, camera, generator(1, Stream.TRUTH, trial), state_of_trial(still.viewpoint, 1, trial))
        np.testing.assert_allclose(view.T_cam_body.camera_position_m, places[1], atol=1e-9)
    again = ScenarioSpec.model_validate_json(canonical_json(still))
    assert digest(again) == digest(still) != digest(turned)


@pytest.mark.parametrize(
    ("flight", "said"),
    [
        ("flyby: {periapsis_m: 9, v_infinity_m_s: 1.0e-6, gm_m3_s2: 5, duration_s: 9, step_s: 1}", "makes a parabola"),
        (FLIGHTS["flyby"].replace("{p", "flyby: {normal: [0, 0, 0], p"), "normal is zero"),
        (FLIGHTS["hover"].replace(", drift_m_s: 0.01", "").replace("{p", "hover: {p"), "box_m and drift_m_s belong"),
        (FLIGHTS["hover"].replace("0, 0]", "0, .nan]").replace("{p", "hover: {p"), "is not a finite number"),
        (FLIGHTS["hover"].replace("4000", "4.0e+8").replace("{p", "hover: {p"), "more than 20000: take longer steps"),
        ("hover: {position_m: [0, 0, 0], duration_s: 9, step_s: 1}", "a position is the body's origin"),
        (FLIGHTS["descent"].replace("800, r", "2800, r").replace("{d", "descent: {d"), "not below from_altitude_m"),
        (FLIGHTS["descent"].replace("800, r", "0, r").replace("{d", "descent: {d"), "to_altitude_m: 0 is not above 0"),
        (
            f"hover: {FLIGHTS['hover']}, read_states: {{time_s: [0], position_m: [[9, 0, 0]]}}",
            "read_states are filled in",
        ),
        (FLIGHTS["descent"].replace("[1, 0, 1]", "[0, 0, 0]").replace("{d", "descent: {d"), "direction is zero"),
        ("table: x.csv, hover: {position_m: [9, 0, 0], duration_s: 9, step_s: 1}", "not both"),
        ("order: random", "give either table or spice or flyby or hover or descent"),
    ],
)
def test_a_flight_that_makes_no_sense_is_one_line(tmp_path, flight, said):
    with pytest.raises(BoresightError, match=said) as caught:
        load(tmp_path, f"{BARE}viewpoint: {{trajectory: {{{flight}}}}}")
    assert str(caught.value).startswith(str(tmp_path / "scene.yaml") + ":3: viewpoint.trajectory")
    assert "\n" not in str(caught.value)


# --- OEM -----------------------------------------------------------------------------------------------------------

META = """META_START
OBJECT_NAME = HERA
OBJECT_ID = 2024-180A
CENTER_NAME = DIDYMOS
REF_FRAME = {frame}
TIME_SYSTEM = TDB
START_TIME = 2027-02-01T00:00:00
STOP_TIME = 2027-02-01T00:20:00
META_STOP
"""
HEAD = "CCSDS_OEM_VERS = 2.0\nCOMMENT made up\nCREATION_DATE = 2026-11-25T00:00:00\nORIGINATOR = X\n\n"
FIRST = """COMMENT states in km and km/s
2027-02-01T23:59:30.5 10.0 -2.0 0.5 0.001 -0.0002 0.00005
2027-02-02T00:09:30.500 10.6 -2.1 0.53 0.001 -0.0002 0.00005 1e-9 0 0
"""
SECOND = """2027-033T00:09:30.5Z 10.6 -2.1 0.53 0.001 -0.0002 0.00005
2027-033T00:19:30.75Z 11.2 -2.2 0.56 0.001 -0.0002 0.00005
COVARIANCE_START
EPOCH = 2027-02-02T00:19:30
1.0e-4
1.0e-5 2.0e-4
COVARIANCE_STOP
"""
BODY_FIXED = META.format(frame="DIDYMOS_FIXED")
MESSAGE = HEAD + BODY_FIXED + FIRST + BODY_FIXED + SECOND


def states_of(folder, message, more=""):
    (folder / "way.oem").write_text(message)
    return load(folder, f"viewpoint: {{trajectory: {{table: way.oem{more}}}}}").viewpoint.states


def test_a_message_has_seconds_metres_and_its_segments_in_one(tmp_path):
    states = states_of(tmp_path, MESSAGE)
    np.testing.assert_allclose(states.time_s, [0.0, 600.0, 1200.25], atol=1e-9)
    np.testing.assert_allclose(states.position_m, [[1e4, -2e3, 500], [10600, -2100, 530], [11200, -2200, 560]])
    assert states.velocity_m_s is None, "velocities in rotating axes are relative to these"
    assert states.attitude is None
    assert set(read_table(str(tmp_path / "way.oem"), ())["ref_frame"]) == {"DIDYMOS_FIXED"}


def test_a_message_in_inertial_axes_needs_the_rotation(tmp_path):
    for frame in ("icrf3", "B1950", "EME2000"):
        inertial = MESSAGE.replace("DIDYMOS_FIXED", frame)
        with pytest.raises(BoresightError, match=rf"way\.oem cannot be used: its states are in {frame}, inertial axes"):
            states_of(tmp_path, inertial)
    with pytest.raises(BoresightError, match="in DIDYMOS_FIXED, taken as body axes: rotation has no part"):
        states_of(tmp_path, MESSAGE, ", rotation: {pole_ra_deg: 0, pole_dec_deg: 90, rate_deg_day: 0}")
    turned = states_of(tmp_path, inertial, ", rotation: {pole_ra_deg: 0, pole_dec_deg: 90, rate_deg_day: 0}")
    np.testing.assert_allclose(turned.position_m[0], [-2e3, -1e4, 500], atol=1e-9)
    np.testing.assert_allclose(turned.velocity_m_s, np.tile([-0.2, -1.0, 0.05], (3, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("CCSDS_OEM_VERS = 2.0", "<oem>", "its first line is not CCSDS_OEM_VERS"),
        ("REF_FRAME = DIDYMOS_FIXED\n", "", "line 15: a state comes before REF_FRAME of its META section"),
        ("2027-033T00:19", "2027-032T00:19", r"time_s -8\d+.\d+ of row 2 \(from 0\) is not after the one before"),
        ("T00:19:30.75Z", "T00:19", "is not an epoch"),
        ("2027-02-01T23:59", "2027-13-01T23:59", "line 16: '2027-13-01T23:59:30.5' is not an epoch"),
        ("10.0 -2.0 0.5 0.001", "10.0 -2.0 0.5", "line 16: not an epoch with 6 or 9 numbers"),
        ("10.0 -2.0", "10.0 far", "could not convert string to float: 'far'"),
        ("10.0 -2.0", "10.0 nan", "row 0 .* is not all numbers"),
        ("COVARIANCE_STOP\n", "", "it ends without COVARIANCE_STOP"),
    ],
)
def test_a_message_that_cannot_be_used_is_one_line(tmp_path, old, new, said):
    assert old in MESSAGE
    with pytest.raises(BoresightError, match=said) as caught:
        states_of(tmp_path, MESSAGE.replace(old, new))
    assert "scene.yaml:2: viewpoint.trajectory: way.oem cannot be used" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_messages_without_states_or_of_two_objects_are_refused(tmp_path):
    for message, said in ((HEAD + BODY_FIXED, "no states"), ("", "no states")):
        with pytest.raises(BoresightError, match=said):
            states_of(tmp_path, message)
    with pytest.raises(BoresightError, match="segments of another OBJECT_NAME than HERA"):
        states_of(tmp_path, HEAD + BODY_FIXED + FIRST + BODY_FIXED.replace("HERA", "MILANI") + SECOND)


POSES = """# timestamp tx ty tz qx qy qz qw
10.5 3000 0 0 0.5 0.5 -0.5 -0.5

20 3001.25 -1e2 40 0.5 0.5 -0.5 -0.5  # the same attitude
"""


def poses_of(folder, text, more=""):
    (folder / "way.tum").write_text(text)
    return load(folder, f"viewpoint: {{trajectory: {{table: way.tum{more}}}}}").viewpoint.states


def test_a_tum_file_has_places_and_the_inverse_of_its_rotations(tmp_path):
    states = poses_of(tmp_path, POSES)
    assert states.time_s == (10.5, 20.0)
    np.testing.assert_array_equal(states.position_m, [[3000, 0, 0], [3001.25, -100, 40]])
    to_table = Rotation.from_quat([0.5, 0.5, -0.5, -0.5])
    # The camera looks back at the body: its third axis is against x.
    np.testing.assert_allclose(to_table.apply([0, 0, 1]), [-1, 0, 0], atol=1e-12)
    for quaternion in states.attitude:
        np.testing.assert_allclose(
            Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), to_table.inv().as_matrix(), atol=1e-12
        )
    turned = poses_of(tmp_path, POSES, ", rotation: {pole_ra_deg: 0, pole_dec_deg: 90, rate_deg_day: 0}")
    np.testing.assert_allclose(turned.position_m[0], [0, -3000, 0], atol=1e-9)
    looks = Rotation.from_quat(turned.attitude[0], scalar_first=True).apply([0, 1, 0])
    np.testing.assert_allclose(looks, [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("20 3001.25", "3001.25", "line 4: 7 numbers, not the 8 of time x y z qx qy qz qw"),
        ("3001.25", "far", "line 4: could not convert string to float: 'far'"),
        ("3001.25", "nan", r"row 1 \(from 0\) of x_m, y_m, z_m is not all numbers"),
        ("20 3001", "10 3001", r"time_s 10 of row 1 \(from 0\) is not after the one before"),
        ("40 0.5 0.5", "40 0.5 5", "the quaternion has the length"),
        (POSES, "# nothing", "it has no poses"),
    ],
)
def test_a_tum_file_that_cannot_be_used_is_one_line(tmp_path, old, new, said):
    assert old in POSES
    with pytest.raises(BoresightError, match=said) as caught:
        poses_of(tmp_path, POSES.replace(old, new))
    assert "way.tum cannot be used" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["tum", "oem", "csv"])
def test_a_table_of_bytes_is_no_text(tmp_path, suffix):
    (tmp_path / f"way.{suffix}").write_bytes(bytes(range(256)))
    with pytest.raises(BoresightError, match="cannot be used: not a text table: it holds bytes that are not UTF-8"):
        load(tmp_path, f"viewpoint: {{trajectory: {{table: way.{suffix}}}}}")
