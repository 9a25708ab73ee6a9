"""A second body in a scenario: its orbit, its part in digests and views, what is refused, and what is on board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boresight.campaign.imaging.image_store import fingerprint, image_set_key
from boresight.campaign.imaging.world import check_bodies, open_world
from boresight.campaign.runs.check import check_scenario
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.craters import shape_digest
from boresight.scenarios.draw import Stream
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.known import known_on_board
from boresight.scenarios.load import load_scenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.second import SecondBodySpec

PAIR = """
body: {shape: didymos-like}
second_body: {body: {shape: dimorphos-like}, semi_major_axis_m: 1190}
camera: {width_px: 96, height_px: 96, fov_deg: 5.5}
detector: {exposure_s: 0.1}
viewpoint: {range_m: 40000, latitude_deg: {uniform: [-10, 10]}}
lighting: {phase_deg: {uniform: [10, 90]}}
"""


@pytest.fixture
def scenario(tmp_path):
    (tmp_path / "pair.yaml").write_text(PAIR)
    return lambda *overrides: load_scenario(str(tmp_path / "pair.yaml"), overrides)


def drawn_pose(**orbit):
    return SecondBodySpec(semi_major_axis_m=1190.0, **orbit).draw(np.random.default_rng(1))


@pytest.mark.parametrize(("inclination", "node", "phase"), [(0, 0, 0), (0, 0, 70), (30, 40, 90), (165, -100, 200)])
def test_the_orbit_is_that_of_the_textbook(inclination, node, phase):
    """Position by the elements, the pole by inclination and node; long axis towards the first body."""
    pose = drawn_pose(inclination_deg=inclination, node_deg=node, phase_deg=phase)
    i, n, u = np.radians([inclination, node, phase])
    position = 1190.0 * np.array([
        np.cos(n) * np.cos(u) - np.sin(n) * np.sin(u) * np.cos(i),
        np.sin(n) * np.cos(u) + np.cos(n) * np.sin(u) * np.cos(i),
        np.sin(u) * np.sin(i),
    ])  # fmt: skip
    np.testing.assert_allclose(pose.translation_m, position, atol=1e-9)
    np.testing.assert_allclose(pose.transform(np.array([1190.0, 0.0, 0.0])), 0.0, atol=1e-9)
    pole = [np.sin(n) * np.sin(i), -np.cos(n) * np.sin(i), np.cos(i)]
    np.testing.assert_allclose(pose.rotate(np.array([0.0, 0.0, 1.0])), pole, atol=1e-12)


def test_the_phase_has_a_stream_of_its_own(scenario):
    """The views are those without a second body, and one seed gives one phase."""
    with_moon, alone = (open_world(scenario(*more), choose_variant().name) for more in ((), ("second_body=null",)))
    views = [with_moon.source.view(5, trial) for trial in range(40)]
    for trial in range(3):
        np.testing.assert_array_equal(
            views[trial].T_cam_body.translation_m, alone.source.view(5, trial).T_cam_body.translation_m
        )
        np.testing.assert_array_equal(
            views[trial].T_body_second.translation_m, with_moon.source.view(5, trial).T_body_second.translation_m
        )
    phases = np.array([np.arctan2(*one.T_body_second.translation_m[1::-1]) for one in views])
    assert np.abs(np.exp(1j * phases).mean()) < 0.5  # 40 uniform directions: exceeded with a probability of e-10
    assert np.ptp(phases) > 4.0


def test_digests_know_the_second_body(scenario):
    def key(*overrides):
        one = scenario(*overrides)
        laws = (one.spec.viewpoint, one.spec.lighting)
        return image_set_key(one, "llvm_ad_mono", Stream.TRUTH, laws), shape_digest(one.spec, one.search_dirs)

    (images, shape), (bright, same), (other, another), (none, first) = (
        key(*more)
        for more in (
            (),
            ("second_body.albedo_ratio=0.9",),
            ("second_body.body.shape=sphere",),
            ("second_body=null",),
        )
    )
    assert len({images, bright, other, none}) == 4
    assert shape == same
    assert len({shape, another, first}) == 3
    view = open_world(scenario(), choose_variant().name).source.view(1, 0)
    moved = replace(view, T_body_second=view.T_body_second.perturbed(np.zeros(3), np.array([1e-9, 0.0, 0.0])))
    assert len({fingerprint(one) for one in (view, moved, replace(view, T_body_second=None))}) == 3


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("second_body.semi_major_axis_m=490",), "second_body.semi_major_axis_m: at 490 m the second body"),
        (("viewpoint.range_m=1200",), "ranges from 1200 to 1200 m may lead into the second body"),
        (("viewpoint.range_m={uniform: [1000, 9000]}",), "ranges from 1000 to 9000 m may lead into the second body"),
        (("second_body.body.shading=smooth",), "second_body.body.shading: both bodies have the same: give flat"),
        (
            ("craters={count: 40, min_diameter_m: 24, max_diameter_m: 120, edge_m: 6}",),
            "second_body: no image has two bodies and the section craters",
        ),
        (("viewpoint=null", "orbit={}"), "second_body has no part in a scenario with orbit"),
        (("second_body.body.shape=nowhere.obj",), "nowhere.obj"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(scenario, overrides, message):
    with pytest.raises(BoresightError, match=message) as refused:
        check_bodies(scenario(*overrides))
    assert message in str(refused.value).splitlines()[0]


def test_a_range_within_the_orbit_is_allowed(scenario):
    check_bodies(scenario("viewpoint.range_m=800"))


def test_rectangles_stay_clear_of_both_bodies(scenario):
    """The first body is 20 px wide in the middle of the frame, and the second within 30 px of it."""
    world = open_world(scenario("viewpoint.keep_clear_px=[[0, 0, 34, 96], [62, 0, 96, 96]]"), choose_variant().name)
    seen = []
    for trial in range(12):
        view = world.source.view(2, trial)
        middle = view.camera.project(view.T_cam_body.transform(view.T_body_second.translation_m))
        seen.append(34.0 < middle[0] < 62.0)
    assert all(seen)


def test_stars_and_points_of_the_surface_know_it(scenario):
    """At the pixel of its middle, where it is beside the first body, a line of sight meets the second."""
    world = open_world(scenario(), choose_variant().name)
    for trial in range(10):
        view = world.source.view(1, trial)
        middle = view.T_cam_body.transform(view.T_body_second.translation_m)
        uv = view.camera.project(middle)
        if np.linalg.norm(uv - view.camera.project(view.T_cam_body.translation_m)) < 22.0:
            continue
        hits = world.renderer.surface(view, uv[None])
        assert hits.hit.all()
        assert np.linalg.norm(hits.points_body_m[0] - view.T_body_second.translation_m) < 89.0
        return
    raise AssertionError("no trial has the bodies side by side")


def test_the_spacecraft_does_not_know_it(scenario):
    spec = scenario().spec
    assert onboard_spec(spec).second_body is None
    items = {item.name: item.standing for item in known_on_board(spec, "single-image").items}
    assert items["second body"] == "not"
    alone = scenario("second_body=null").spec
    assert onboard_spec(spec) == onboard_spec(alone)


def test_lengths_left_out_are_measured_by_its_own_body(scenario):
    spec = scenario("second_body.body.detail={facets: 60000, roughness: {rms_m: 0.5}}").spec
    # A fifth of 177 m.
    assert spec.second_body.body.detail.roughness.max_wavelength_m == pytest.approx(35.4, rel=0.01)


def test_embedded_bodies_take_the_place_of_its_shape_file(tmp_path):
    (tmp_path / "pair.yaml").write_text(PAIR.replace("dimorphos-like", "bennu_radar.obj"))
    spec = load_scenario(str(tmp_path / "pair.yaml"), embedded=True).spec
    assert [one.shape for one in spec.bodies] == ["didymos-like", "bennu-like"]


def test_it_is_refused_where_no_image_shows_it_and_where_it_would_reflect_more_than_it_gets(scenario):
    for kind in ("pose-convergence", "landmark-database"):
        with pytest.raises(BoresightError, match=f"second_body has no part in {kind}: leave it out"):
            check_scenario(scenario(), kind)
    with pytest.raises(BoresightError, match="4 times the albedo"):
        scenario("second_body.albedo_ratio=4")
