"""Looks at orbits and at craters: closed forms of what is coloured and where cameras stand, and a page in a browser."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from browser import needs_chromium, opened
from orbit_worlds import orbit_world

from boresight.campaign.inspection.recompute import Case
from boresight.campaign.inspection.show import camera_scale
from boresight.campaign.kinds.crater_matching.show import pair_outcomes
from boresight.campaign.kinds.orbit_determination.show import image_sets, landmark_errors, orbit_marks, sightings_of
from boresight.campaign.trial.kind import InspectedTrial
from boresight.estimators.craters.contract import CraterMatches
from boresight.estimators.orbit.contract import Orbit, OrbitEstimate
from boresight.reports.pages.view3d import BAD, GOOD, View3D, raised_points, write_view3d
from boresight.scenarios.craters.simulated import NO_CRATER, CraterPair, CraterView, LabelledDetections
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.orbits.draw import draw_orbit

OFFSET_M = np.array([3.0, -4.0, 12.0])
# What plotly's script and a browser without a graphics card say of their own speed.
SPEED = "willReadFrequently|GPU stall due to ReadPixels|software WebGL"


@pytest.fixture(scope="module")
def world():
    return orbit_world(sightings={"images": 30})


@pytest.fixture(scope="module")
def shown(world):
    """The true orbit, all landmarks 13 m off, all residuals (3, 4) px, and the sightings of image 2 edited."""
    truth, data = draw_orbit(world, 5, 0)
    numbers, count = data.landmarks.numbers, len(data.pictures.image)
    orbit = Orbit(
        state=truth.states[0],
        covariance=np.eye(6),
        positions_m=truth.states[:, :3],
        velocities_m_s=truth.states[:, 3:],
        position_covariances_m2=np.tile(np.eye(3), (len(truth.states), 1, 1)),
        numbers=numbers,
        points_body_m=truth.points_body_m[numbers] + OFFSET_M,
        residuals_px=np.tile([3.0, 4.0], (count, 1)),
        used=data.pictures.image != 2,
    )
    return InspectedTrial(truth, data, OrbitEstimate("ok", orbit))


def orbit_used(shown):
    """Tell which landmarks have a sighting that was used."""
    orbit, pictures = shown.estimate.orbit, shown.observation.pictures
    return np.isin(orbit.numbers, pictures.landmark[orbit.used])


def test_landmarks_of_an_orbit_have_the_errors_and_residuals_that_they_were_given(shown):
    orbit, sightings = shown.estimate.orbit, sightings_of(shown, shown.estimate.orbit)
    errors, residuals = orbit_marks(orbit, shown.truth, sightings, "middle")
    assert (errors.name, residuals.name) == ("landmark error, middle trial", "residual, middle trial")
    np.testing.assert_allclose(errors.values, 13.0)
    np.testing.assert_allclose(residuals.values, np.where(orbit_used(shown), 5.0, np.nan))
    seen, used = (sum(int(re.search(rf"{word} (\d+)", text)[1]) for text in errors.texts) for word in ("in", "used in"))
    assert seen == len(sightings)
    assert used == int(orbit.used.sum()) < seen
    nowhere = replace(shown.truth, points_body_m=np.zeros((0, 3)))
    assert [marks.unit for marks in orbit_marks(orbit, nowhere, sightings, "worst")] == ["px"], "no place, no error"


def test_a_number_with_two_landmarks_stands_for_two_craters(shown):
    orbit, truth = shown.estimate.orbit, shown.truth
    sightings = sightings_of(shown, orbit)
    first, other = orbit.numbers[:2]
    # The second crater goes by the number of the first as well, less often.
    more, fewer = (sightings[sightings["number"] == number] for number in (first, other))
    merged = sightings[~sightings["number"].isin([first, other])]
    parts = [part.assign(number=first).iloc[:1] for count, part in ((3, more), (2, fewer)) for _ in range(count)]
    merged = pd.concat([merged, *parts])
    twice = replace(
        orbit,
        numbers=np.array([first, first]),
        points_body_m=truth.points_body_m[[first, other]] + np.array([[0.0, 0.0, 1.0], [0.0, 2.0, 0.0]]),
    )
    np.testing.assert_allclose(landmark_errors(twice, truth, merged), [1.0, 2.0])
    once = replace(orbit, numbers=twice.numbers[:1], points_body_m=truth.points_body_m[[other]])
    gap = np.linalg.norm(truth.points_body_m[first] - truth.points_body_m[other])
    np.testing.assert_allclose(landmark_errors(once, truth, merged), [gap], err_msg="it stands for the more frequent")


def test_images_of_an_orbit_stand_where_the_turning_body_had_the_camera(world, shown):
    sightings = sightings_of(shown, shown.estimate.orbit)
    useful, useless = image_sets(shown, sightings, world.rotation, Case("s", "e", 7), ("middle", GOOD))
    assert len(useful.points_m) + len(useless.points_m) == 30
    numbers = [int(re.search(r"trial 7, image (\d+)", text)[1]) for text in useful.texts]
    assert 2 not in numbers
    turn = 2.0 * np.pi * shown.observation.pictures.times_s[numbers] / (3600.0 * world.spec.asteroid.rotation_h)
    inertial = shown.truth.image_states[numbers, :3]
    # The body has turned by this angle about z: its axes see the camera turned back.
    x = np.cos(turn) * inertial[:, 0] + np.sin(turn) * inertial[:, 1]
    y = np.cos(turn) * inertial[:, 1] - np.sin(turn) * inertial[:, 0]
    np.testing.assert_allclose(useful.points_m, np.stack([x, y, inertial[:, 2]], axis=1), atol=1e-6)
    assert "residual, RMS 5 px" in useful.texts[0]


def test_a_far_camera_is_drawn_nearer_and_a_near_one_where_it_is():
    factor, told = camera_scale(np.array([[0.0, 0.0, 1800.0], [0.0, 1800.0, 0.0]]), 100.0)
    assert factor == pytest.approx(10.0)
    assert "10 times nearer" in told
    assert camera_scale(np.array([[150.0, 0.0, 0.0]]), 100.0) == (1.0, "")


def test_craters_of_a_pair_are_counted_by_hand():
    def look(craters):
        rims = Ellipses(np.zeros((len(craters), 2)), np.ones((len(craters), 2)), np.zeros(len(craters)))
        return CraterView(None, LabelledDetections(rims, np.array(craters)), None)

    pair = CraterPair(look([4, 7, NO_CRATER, 9]), look([9, 7, 4, NO_CRATER]), 1.0, 1.0)
    # 7 with 7 is right, 4 with 9 is wrong, no crater with no crater is nothing.
    found = pair_outcomes(InspectedTrial(pair, None, CraterMatches(np.array([[1, 1], [0, 0], [2, 3]]), np.ones(3))))
    assert found.set_index("crater")["hits"].to_dict() == {4: 0.0, 7: 1.0, 9: 0.0}
    assert pair_outcomes(InspectedTrial(pair, None, None))["hits"].sum() == 0.0


def test_landmarks_are_drawn_just_above_the_surface(world):
    mesh = world.asteroid.mesh
    look = View3D("a", "b", mesh.vertices_m, mesh.faces, ())
    lifted = raised_points(look, world.asteroid.points_m)
    # Along the craters' own normals, which come from the mesh by another way.
    heights = np.einsum("ni,ni->n", lifted - world.asteroid.points_m, world.asteroid.normals)
    np.testing.assert_allclose(heights, 0.02 * mesh.radius_m, rtol=0.05)
    assert raised_points(look, np.zeros((0, 3))).shape == (0, 3)


@needs_chromium
def test_the_page_of_an_orbit_changes_what_colours_the_landmarks(world, shown, tmp_path):
    orbit, sightings = shown.estimate.orbit, sightings_of(shown, shown.estimate.orbit)
    mesh, case = world.asteroid.mesh, Case("s", "e", 7)
    cameras = [
        *image_sets(shown, sightings, world.rotation, case, ("middle", GOOD)),
        *image_sets(shown, sightings, world.rotation, case, ("worst", BAD)),
    ]
    marks = orbit_marks(orbit, shown.truth, sightings, "middle")
    note = "The trial of median error and the worst one. " * 6
    write_view3d(
        View3D("orbit / batch-filter", note, mesh.vertices_m, mesh.faces, marks, cameras), tmp_path / "look.html"
    )
    with opened(tmp_path / "look.html", SPEED) as page:
        page.wait_for_selector(".gl-container canvas")
        names = page.locator(".legendtext").all_text_contents()
        assert names[:4] == ["body", *(one.name for one in marks), f"images, middle trial ({len(cameras[0].points_m)})"]
        visible = "document.querySelector('.js-plotly-plot')._fullData.map(trace => trace.visible)"
        assert page.evaluate(visible)[:3] == [True, True, "legendonly"]
        page.locator(".updatemenu-button").nth(1).click()
        assert page.evaluate(visible)[:3] == [True, "legendonly", True]
        boxes = "[...document.querySelectorAll('.gtitle, .gtitle-subtitle, .updatemenu-button')]"
        sides = "(e => e.getBoundingClientRect()).map(b => [b.left, b.right, b.top, b.bottom])"
        edges = np.array(page.evaluate(f"{boxes}.map{sides}"))
        assert edges.min() >= 0.0
        assert edges[:, 1].max() <= 1200.0, "nothing runs out of the page"
        assert edges[0, 3] <= edges[1, 2] + 1.0
        assert edges[1, 3] <= edges[2:, 2].min() + 1.0, "title, note and buttons lie below each other"
