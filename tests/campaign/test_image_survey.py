"""An arc of planned images: what they have in common on a ball, and counts that agree with each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import trimesh
from orbit_worlds import orbit_world

from boresight.campaign.kinds.crater_navigation.images import DrawnSights
from boresight.campaign.kinds.image_survey import FEW, ImageSurvey, coverage
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.craters.simulated import NO_CRATER, draw_plane_craters
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh, View, look_at
from boresight.scenarios.orbits.true_orbit import imaging_of
from boresight.scenarios.sequences.ground import MeshGround

CAMERA = Camera.from_fov(100, 100, np.radians(10.0))
IMAGING = {
    "epochs": 30,
    "detections": "drawn",
    "craters": {"count": 300, "min_diameter_m": 9.0, "max_diameter_m": 60.0},
    "errors": {"recall": 0.6, "false_share": 0.1, "height_m": 0.5, "least_radius_px": 5.0},
}


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(4, 100.0)
    return MeshGround(TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)))


def _view(longitude_deg: float, sun_deg: float) -> View:
    """Look at the centre of the ball from above its equator; the whole ball is in the frame."""
    towards, sun = (np.array([np.cos(a), np.sin(a), 0.0]) for a in np.radians([longitude_deg, sun_deg]))
    return View(CAMERA, look_at(2e3 * towards), sun)


def test_images_of_a_ball_share_ground_and_light_as_their_directions_say(ball):
    views = [_view(0, 30), _view(5, 36), _view(5, 50), _view(180, 150), _view(180, 145)]
    found = coverage(views, ball)
    # The far side shares a rim at most, and lies in the dark of the others; Suns are 6, 20 and 5 deg apart.
    np.testing.assert_array_equal(found.overlapping, [2, 2, 2, 1, 1])
    np.testing.assert_array_equal(found.similar, [1, 1, 0, 1, 1])
    # What one of two images from the same place shows in the light, the other shows in the dark.
    np.testing.assert_array_equal(coverage([_view(0, 100), _view(0, -100)], ball).overlapping, [0, 0])


def test_images_that_miss_the_body_or_are_none_have_nothing_in_common(ball):
    away = look_at(np.array([2e3, 0.0, 0.0]))
    blind = View(CAMERA, replace(away, translation_m=-away.translation_m), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(coverage([blind, _view(0, 0), _view(0, 0)], ball).overlapping, [0, 1, 1])
    assert len(coverage([], ball).similar) == 0


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    world = orbit_world(arc={"days": 1.0}, knowledge={"position_m": 15.0, "shape_degree": 8}, imaging=IMAGING)
    spec, ground = imaging_of(world), MeshGround(world.asteroid.mesh)
    world = replace(world, asteroid=replace(world.asteroid, centre_m=np.zeros(3)))
    sights = DrawnSights(spec, ground, draw_plane_craters(ground, spec.craters))
    folder = tmp_path_factory.mktemp("survey")
    return ImageSurvey(scenario="small", methods={"planner": None}, seed=5, world=world, sights=sights, folder=folder)


def test_counts_agree_with_each_other_and_do_not_change(survey):
    records = survey.run(range(1))
    assert survey.run(range(1)) == records
    images, craters = (pd.DataFrame(records[name]) for name in ("surveyed_images", "surveyed_craters"))
    for name in ("surveyed_images", "surveyed_craters", "rows", "diagnostics"):
        assert set(records[name][0]) <= {column.name for column in TABLES[name]}
    assert images["n_detections"].sum() > craters["hits"].sum() > 0
    assert craters["crater"].is_unique
    assert NO_CRATER not in set(craters["crater"])
    assert craters["hits"].max() <= len(images)
    assert (images["n_similar"] <= images["n_overlapping"]).all()
    told = {record["name"]: record["value"] for record in records["diagnostics"]}
    assert told["detections"] == images["n_detections"].sum()
    assert told["few_craters_share"] == pytest.approx(100.0 * (images["n_detections"] <= FEW).mean())
    assert told["hits_a_crater"] == pytest.approx(craters["hits"].mean())


def test_nothing_but_the_planner_has_a_part():
    with pytest.raises(BoresightError, match="'vote' has no part in image-survey"):
        ImageSurvey.method_version("vote")
