"""The ground that the learned detector is trained on: closed forms of slopes, shadows and lines of sight."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest
from training.crater_network import digest
from training.ground import STEP_PX, Bowl, Ground, make_ground
from training.sight import CAMERA, HEIGHT_PX, WIDTH_PX, Geometry, draw_geometry, draw_lesson, look, shade
from training.thresholds import lowest_threshold

from boresight.estimators.craters.learned.detector import packaged_network
from boresight.scenarios.errors import BoresightError


def plain(heights):
    return Ground(heights, (), np.zeros((0, 48, 3)), np.zeros(0))


def geometry(emission_deg, incidence_deg, size, azimuth_deg=0.0):
    """The camera leans over towards -x, the Sun stands towards an azimuth."""
    e, i, a = np.radians([emission_deg, incidence_deg, azimuth_deg])
    axes = np.array([[np.cos(e), 0, np.sin(e)], [0, -1, 0], [np.sin(e), 0, -np.cos(e)]])
    sun = np.array([np.sin(i) * np.cos(a), np.sin(i) * np.sin(a), np.cos(i)])
    return Geometry(axes, sun, np.array([size[0] / 2, size[1] / 2, 0.0]))


def test_a_bowls_crest_is_its_highest_point_and_its_floor_as_deep_as_said():
    bowl = Bowl(0.0, 0.0, 10.0, 0.15, 0.03, 2.0, 3.0, 0.05)
    r = np.linspace(0.0, 3.5, 2001)
    heights = bowl.heights(r)
    assert r[heights.argmax()] == pytest.approx(1.0, abs=2e-3)
    assert heights.max() == pytest.approx(2 * 10.0 * 0.03, rel=1e-4)
    assert heights.max() - heights[0] == pytest.approx(2 * 10.0 * 0.15, rel=0.02)
    assert heights[r >= 3.0] == pytest.approx(0.0)


def test_level_ground_is_as_bright_as_its_incidence_says():
    at = geometry(0.0, 60.0, (300, 200))
    ground = plain(np.zeros((300, 400)))
    np.testing.assert_allclose(shade(ground, at, 0.0), 0.5, atol=1e-9)
    np.testing.assert_allclose(shade(ground, at, 1.0), 0.5 / 1.5, atol=1e-9)


def test_a_wall_throws_a_shadow_of_its_height_times_the_tangent():
    heights = np.zeros((60, 500))
    heights[:, 300:] = 20.0
    value = shade(plain(heights), geometry(0.0, 65.0, (300, 36), 0.0), 0.0)
    length = np.count_nonzero(value[30, :300] == 0.0) * STEP_PX
    assert length == pytest.approx(20.0 * np.tan(np.radians(65.0)), abs=2.0)


@pytest.mark.parametrize("emission_deg", [0.0, 35.0, 55.0])
def test_a_line_of_sight_meets_the_ground_where_it_projects(emission_deg):
    """Radiance that is the ground's own x, on a slope: a pixel's value must project back to the pixel."""
    size = (900.0, 480.0)
    x = np.arange(int(size[0] / STEP_PX)) * STEP_PX
    slope = 0.15
    ground = plain(np.tile(slope * (x - size[0] / 2), (int(size[1] / STEP_PX), 1)))
    at = geometry(emission_deg, 40.0, size)
    seen = look(ground, np.tile(x, (len(ground.heights), 1)), at)
    points = np.stack([seen, np.full(seen.shape, size[1] / 2), slope * (seen - size[0] / 2)], axis=-1)
    columns = np.arange(WIDTH_PX) + 0.5
    middle = at.project(points)[HEIGHT_PX // 2, 40:-40, 0]
    np.testing.assert_allclose(middle, columns[40:-40], atol=0.05)


def test_the_drawn_camera_has_right_handed_axes():
    for seed in range(20):
        at, size = draw_geometry(np.random.default_rng(seed))
        np.testing.assert_allclose(at.axes @ at.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(at.axes) == pytest.approx(1.0)
        assert -at.axes[2, 2] > 0.5
        corners = np.array([[0, 0], [WIDTH_PX, 0], [0, HEIGHT_PX], [WIDTH_PX, HEIGHT_PX]]) - [
            WIDTH_PX / 2,
            HEIGHT_PX / 2,
        ]
        level = np.linalg.solve(at.axes[:2, :2], corners.T).T + size / 2
        assert np.all((level >= 0) & (level <= size))


def test_the_same_seed_draws_the_same_lesson_with_its_rims_in_the_picture():
    one, other = (draw_lesson(np.random.default_rng(11)) for _ in range(2))
    np.testing.assert_array_equal(one.frame.image, other.frame.image)
    np.testing.assert_array_equal(one.rims.centre_px, other.rims.centre_px)
    assert one.weight.sum() > 5
    assert CAMERA.contains(one.rims.centre_px[one.weight > 0]).all()


def test_younger_craters_cut_older_ones():
    ground = make_ground(np.random.default_rng(5), np.array([250.0, 250.0]))
    assert ground.cut[-1] == 0.0
    for i in (0, len(ground.bowls) // 2):
        share = np.mean(
            [any(np.hypot(p[0] - b.x, p[1] - b.y) < b.radius for b in ground.bowls[i + 1 :]) for p in ground.crests[i]]
        )
        assert ground.cut[i] == pytest.approx(share)


def test_the_weights_are_those_whose_making_is_noted():
    note = json.loads((files("boresight.estimators.craters.learned") / "weights.json").read_text())
    assert note["sha256"] == digest(packaged_network())


# --- Thresholds on a detector's confidence, by hand ------------------------------------------------------------------


def test_lowest_threshold_lets_the_share_through_and_no_more() -> None:
    confidence = np.array([0.2, 0.9, 0.8, 0.5, 0.7, 0.6])
    false = np.array([True, False, False, False, True, False])
    # From the top: 0, 0, 1/3, 1/4, 1/5, 2/6 are false.
    assert lowest_threshold(confidence, false, 0.2) == 0.5
    assert lowest_threshold(confidence, false, 0.19) == 0.8
    assert lowest_threshold(confidence, false, 0.34) == 0.2


def test_equal_confidences_are_let_through_together() -> None:
    confidence = np.array([0.9, 0.5, 0.5])
    assert lowest_threshold(confidence, np.array([False, False, True]), 0.1) == 0.9
    assert lowest_threshold(confidence, np.array([False, False, True]), 0.4) == 0.5


def test_no_threshold_is_an_error() -> None:
    with pytest.raises(BoresightError, match="no threshold"):
        lowest_threshold(np.array([0.9, 0.5]), np.array([True, False]), 0.1)
