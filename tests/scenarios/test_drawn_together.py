"""Keys that are drawn together, altitudes above a surface, and the limits of what keys may have.

Every statistical test has a false-alarm level of 1e-4 or 5 standard errors; seeds are fixed, so that a pass repeats.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from boresight.scenarios.bodies import load_body
from boresight.scenarios.craters import cratered_surface
from boresight.scenarios.draw import Stream, draw_aimed_view, draw_lit_view, drawn_together, generator
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.load import load_scenario
from boresight.scenarios.spec.base import digest
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.craters import CratersSpec
from boresight.scenarios.spec.distribution import LogUniform
from boresight.scenarios.spec.world import LightingSpec, ViewpointSpec

FALSE_ALARM = 1e-4
N = 1500
KEYS = ("viewpoint.range_m", "viewpoint.off_pointing_deg", "lighting.brightness")
LAWS = (
    "viewpoint.range_m={normal: [2000, 100], within: [1000, 3000]}",
    "viewpoint.off_pointing_deg={normal: 0.3}",
    "lighting.brightness={log_normal: [1, 0.1]}",
)
R = np.array([[1.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 1.0]])
MATRIX = f"correlation: {R.tolist()}"


def together(keys=KEYS, more=MATRIX):
    return f"correlated={{keys: [{', '.join(keys)}], {more}}}"


def values(overrides, keys=KEYS, count=N):
    """(count, keys) values of trials."""
    spec = load_scenario("itokawa-2km-lambert", overrides).spec
    trials = [drawn_together(spec, 7, trial) for trial in range(count)]
    return np.array([[trial.law_of(key).uniform[0] for key in keys] for trial in trials])


def test_normal_laws_are_jointly_normal_with_their_covariance():
    drawn = values([*LAWS, together()])
    scores = np.column_stack([(drawn[:, 0] - 2000.0) / 100.0, drawn[:, 1] / 0.3, np.log(drawn[:, 2]) / 0.1])
    # Standard error of a mean product of unit normals: sqrt((1 + r^2) / N).
    assert np.abs(scores.T @ scores / N - R).max() < 5.0 * np.sqrt(2.0 / N)
    # Of three degrees of freedom if they are jointly normal, not each alone.
    distances = np.einsum("ti,ij,tj->t", scores, np.linalg.inv(R), scores)
    assert stats.kstest(distances, stats.chi2(3).cdf).pvalue > FALSE_ALARM
    for column, law in zip(drawn.T, (stats.norm(2000, 100), stats.norm(0, 0.3), stats.lognorm(0.1)), strict=True):
        assert stats.kstest(column, law.cdf).pvalue > FALSE_ALARM


@pytest.mark.parametrize(
    ("measure", "cosine"), [("solid-angle", stats.uniform(0.5, 0.5).cdf), ("angle", None)], ids=["solid-angle", "angle"]
)
def test_each_key_keeps_its_own_law(measure, cosine):
    keys = ("viewpoint.range_m", "lighting.phase_deg")
    laws = ("viewpoint.range_m={log_uniform: [1000, 4000]}", "lighting.phase_deg={uniform: [0, 60]}")
    law = f"lighting.measure={measure}"
    drawn = values([*laws, law, together(keys, "correlation: [[1, 0.8], [0.8, 1]]")], keys)
    assert stats.kstest(drawn[:, 0], stats.loguniform(1000, 4000).cdf).pvalue > FALSE_ALARM
    if cosine is None:
        assert stats.kstest(drawn[:, 1], stats.uniform(0, 60).cdf).pvalue > FALSE_ALARM
    else:
        assert stats.kstest(np.cos(np.radians(drawn[:, 1])), cosine).pvalue > FALSE_ALARM
    # Rank correlation of a Gaussian copula (Kruskal 1958).
    assert stats.spearmanr(drawn).statistic == pytest.approx(6.0 / np.pi * np.arcsin(0.4), abs=5.0 / np.sqrt(N))


def test_rows_of_a_table_are_drawn_as_they_stand(tmp_path):
    rows = np.array([[1500.0, 10.0, 0.9], [2500.0, -20.0, 1.1], [2000.0, 40.0, 1.0], [1500.0, 70.0, 1.2]])
    (tmp_path / "pass.csv").write_text("r,roll,b\n" + "\n".join(",".join(map(str, row)) for row in rows))
    keys = ("viewpoint.range_m", "viewpoint.roll_deg", "lighting.brightness")
    laws = [
        f"{key}={{choice: {{table: {tmp_path}/pass.csv, columns: {name}}}}}"
        for key, name in zip(keys, ("r", "roll", "b"), strict=True)
    ]
    found, counts = np.unique(values([*laws, together(keys, "same_row: true")], keys), axis=0, return_counts=True)
    assert np.array_equal(found, rows[np.lexsort(rows.T[::-1])])
    assert stats.chisquare(counts).pvalue > FALSE_ALARM


def test_nothing_else_of_a_view_changes():
    apart, joint = (load_scenario("itokawa-2km-lambert", [*LAWS, *more]).spec for more in ((), (together(),)))
    camera = joint.camera.camera()
    assert drawn_together(apart, 7, 0) is apart
    assert digest(apart) != digest(joint)
    for trial in range(20):
        one, other = (
            draw_lit_view(spec.viewpoint, spec.lighting, camera, generator(7, Stream.TRUTH, trial))
            for spec in (drawn_together(apart, 7, trial), drawn_together(joint, 7, trial))
        )
        directions = [view.T_cam_body.camera_position_m for view in (one, other)]
        assert np.cross(*directions) == pytest.approx(0.0, abs=1e-6)
        assert np.linalg.norm(directions[0]) != pytest.approx(np.linalg.norm(directions[1]), abs=1e-3)
        assert one.phase_angle_rad == pytest.approx(other.phase_angle_rad, abs=1e-9)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ([together(more="correlation: [[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]]")], "not positive semidefinite"),
        ([together(more="correlation: [[1, 0.9, 0], [0.8, 1, 0], [0, 0, 1]]")], "correlation is not symmetric"),
        ([together(more="correlation: [[1, 0, 0], [2, 1, 0], [0, 0, 1]]")], "2 is not at most 1"),
        ([together(more="correlation: [[4, 0, 0], [0, 1, 0], [0, 0, 1]]")], "4 is not at most 1"),
        ([together(more="correlation: [[0.5, 0, 0], [0, 1, 0], [0, 0, 1]]")], "other numbers than 1 on its diagonal"),
        ([together(more="correlation: [[1, 0], [0, 1]]")], "correlation is not 3 x 3, as there are 3 keys"),
        ([together((*KEYS[:2], KEYS[1]))], "keys: viewpoint.off_pointing_deg is given twice"),
        ([together((*KEYS[:2], "viewpoint.rang_m"))], r"correlated.keys\[2\]: 'viewpoint.rang_m' is not 'viewpoint"),
        ([together((*KEYS[:2], "detector.exposure_s"))], "detector.exposure_s is not drawn"),
        (["lighting.brightness=2", together()], "lighting.brightness is not drawn: give it a distribution"),
        (["viewpoint.range_m={uniform: [0, 10]}", together()], r"range_m \[0, 10\] is not within \[0.001, 1e\+13\]"),
        ([together(more="same_row: true")], "same_row: give each of the keys a choice of as many values"),
        (["viewpoint.range_m={choice: [1900, 2000]}", "viewpoint.off_pointing_deg={choice: [1, 2, 3]}",
          together(KEYS[:2], "same_row: true")], "same_row: give each of the keys a choice of as many values"),
        ([together(more="same_row: false")], "same_row: false is not True"),
        ([together(more="")], "give either correlation or same_row"),
        ([together(more=f"same_row: true, {MATRIX}")], "not both"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_together_is_one_line(overrides, said):
    with pytest.raises(BoresightError, match=said) as raised:
        load_scenario("itokawa-2km-lambert", [*LAWS, *overrides])
    assert "\n" not in str(raised.value)


def test_what_a_trajectory_has_is_not_drawn(tmp_path):
    header = "time_s,x_m,y_m,z_m,qw,qx,qy,qz,sun_x,sun_y,sun_z"
    (tmp_path / "states.csv").write_text(f"{header}\n0,2000,0,0,1,0,0,0,1,0,0\n")
    (tmp_path / "scene.yaml").write_text("extends: quickstart\nviewpoint: {trajectory: {table: states.csv}}\n")
    for key in ("viewpoint.roll_deg", "lighting.phase_deg"):
        keys = together(("lighting.brightness", key), "correlation: [[1, 0], [0, 1]]")
        with pytest.raises(BoresightError, match=f"correlated.keys: {key} is not drawn"):
            load_scenario(str(tmp_path / "scene.yaml"), ["lighting.brightness={uniform: [1, 2]}", keys])


def test_only_views_are_drawn_together():
    with pytest.raises(BoresightError, match="correlated has no part in a scenario with images"):
        load_scenario("navcam67p-real", [together()])


# --- altitudes -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def body():
    return load_body(load_scenario("quickstart").spec.body.model_copy(update={"detail": None}), ()).mesh


def test_the_outermost_surface_is_that_of_all_planes_met(body):
    """Of each facet a + s (b - a) + t (c - a) = r d is solved as three equations."""
    a, b, c = np.moveaxis(body.vertices_m[body.faces], 1, 0)
    for direction in np.random.default_rng(1).normal(size=(25, 3)):
        ray = direction / np.linalg.norm(direction)
        matrices = np.stack([b - a, c - a, np.broadcast_to(-ray, a.shape)], axis=-1)
        s, t, r = np.linalg.solve(matrices, -a[..., None])[..., 0].T
        expected = r[(s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)].max()
        assert body.distance_along_m(ray) == pytest.approx(expected, rel=1e-9)
    # On vertices and in the middle of edges a ray belongs to several facets.
    for point in [*body.vertices_m[:50], *body.vertices_m[body.faces[:50, :2]].mean(axis=1)]:
        distance = float(np.linalg.norm(point))
        assert body.distance_along_m(point / distance) >= distance * (1.0 - 1e-12)


def test_a_ray_through_edges_meets_the_outermost_of_several_surfaces():
    square = np.array([[1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])  # their common edge crosses the axis exactly
    plates = TriangleMesh(
        np.concatenate([square * [x, 1.0, 1.0] for x in (5.0, 9.0, -20.0)]),
        np.concatenate([faces, faces + 4, faces + 8]),
    )
    assert plates.distance_along_m(np.array([1.0, 0.0, 0.0])) == 9.0
    assert plates.distance_along_m(np.array([-1.0, 0.0, 0.0])) == 20.0


def test_where_no_surface_is_an_altitude_is_refused():
    plate = TriangleMesh(np.array([[9.0, -1.0, -1.0], [9.0, 1.0, -1.0], [9.0, 0.0, 2.0]]), np.array([[0, 1, 2]]))
    assert plate.distance_along_m(np.array([1.0, 0.0, 0.0])) == pytest.approx(9.0)
    for direction in ([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 0.0]):
        with pytest.raises(BoresightError, match="no surface lies towards"):
            plate.distance_along_m(np.array(direction))


@pytest.mark.parametrize("targets", [(), ("nadir", "limb")])
def test_an_altitude_is_above_the_surface_below_the_camera(body, targets):
    camera, lighting = load_scenario("quickstart").spec.camera.camera(), LightingSpec()
    above = ViewpointSpec(altitude_m=LogUniform(log_uniform=(100.0, 4000.0)), targets=targets)
    altitudes = []
    for trial in range(100):
        rngs = [generator(1, Stream.TRUTH, trial) for _ in range(2)]
        view = draw_aimed_view(above, lighting, camera, body, rngs[0])
        position_m = view.T_cam_body.camera_position_m
        range_m = float(np.linalg.norm(position_m))
        altitudes.append(range_m - body.distance_along_m(position_m / range_m))
        plain = draw_lit_view(ViewpointSpec(range_m=2000.0), lighting, camera, rngs[1])
        assert position_m / range_m == pytest.approx(plain.T_cam_body.camera_position_m / 2000.0, abs=1e-12)
    assert stats.kstest(altitudes, stats.loguniform(100.0, 4000.0).cdf).pvalue > FALSE_ALARM


def test_an_altitude_above_craters_is_above_their_relief():
    """Straight above each vertex of the relief, which is the surface there if nothing overhangs."""
    craters = CratersSpec(count=40, min_diameter_m=24, max_diameter_m=120, edge_m=6, known_diameter_m=30)
    ground = cratered_surface(BodySpec(shape="sphere"), craters)
    picked = np.random.default_rng(2).choice(len(ground.vertices_m), 100, replace=False)
    points_m = np.asarray(ground.vertices_m[picked], dtype=np.float64)
    for point in points_m:
        distance = float(np.linalg.norm(point))
        assert ground.distance_along_m(point / distance) == pytest.approx(distance, rel=1e-6)


def test_an_altitude_needs_a_surface():
    with pytest.raises(BoresightError, match="an altitude is above a surface"):
        camera = load_scenario("quickstart").spec.camera.camera()
        draw_lit_view(ViewpointSpec(altitude_m=5.0), LightingSpec(), camera, np.random.default_rng(0))


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("viewpoint.range_m={uniform: [1, 1.0e+300]}", r"uniform\[1\]: 1e\+300 is not at most 1e\+30"),
        ("viewpoint.range_m={uniform: [1, 1.0e+20]}", r"range_m \[1, 1e\+20\] is not within \[0.001, 1e\+13\]"),
        ("viewpoint.range_m=1.0e+20", r"range_m \[1e\+20, 1e\+20\] is not within \[0.001, 1e\+13\]"),
        ("viewpoint.altitude_m={uniform: [-5, 5]}", r"altitude_m \[-5, 5\] is not within \[0.001, 1e\+13\]"),
        ("viewpoint.altitude_m=0", "altitude_m: 0 is not above 0"),
        ("viewpoint.roll_deg={normal: 1.0e+300}", r"normal: 1e\+300 is not at most 1e\+30"),
        ("viewpoint.roll_deg={log_normal: [1.0e+99, 1]}", r"log_normal\[0\]: 1e\+99 is not at most 1e\+30"),
        ("lighting.brightness={uniform: [0, 1.0e+9]}", r"brightness has a root mean square of 5.77e\+08, above 1e\+06"),
        ("lighting.brightness={log_normal: [1, 9]}", r"brightness has a root mean square of .*, above 1e\+06"),
        ("detector.exposure_s={choice: [1, 1.0e+20]}", r"exposure_s has a root mean square of 7.07e\+19"),
        ("detector.exposure_s=0", "exposure_s: 0 is not above 0"),
        ("detector.exposure_s={normal: [1, 0.1]}", "exposure_s .* is not of 0 and more; bound it by within"),
        ("pose_error.position_cam_m={normal: [1, 1, 1.0e+200]}", r"normal\[2\]: 1e\+200 is not at most 1e\+30"),
        ("pose_error.position_cam_m={uniform: [[0, 1.0e+200], [0, 1], [0, 1]]}", r"1e\+200 is not at most 1e\+30"),
        ("onboard.sun_error_deg={uniform: [-1.0e+40, 0]}", r"uniform\[0\]: -1e\+40 is not at least -1e\+30"),
    ],
)  # fmt: skip
def test_absurd_numbers_are_refused_by_the_limits_of_keys(override, said):
    with pytest.raises(BoresightError, match=said) as raised:
        load_scenario("quickstart", [override])
    assert "\n" not in str(raised.value)
