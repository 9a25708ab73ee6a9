"""Sequences over shapes of missions, radar and light curves, where BORESIGHT_DATA points at them."""

from __future__ import annotations

import numpy as np
import pytest
from mission_data import data_file, needs_data
from scipy.spatial import cKDTree

from boresight.scenarios.bodies import load_body
from boresight.scenarios.dynamics.gravity import PointMass, Polyhedron
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import load_scenario
from boresight.scenarios.sequences import MeshGround, draw_sequence
from boresight.scenarios.spec.body import BodySpec
from boresight.scenarios.spec.sequence import SequenceSpec

pytestmark = needs_data()

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))
SHAPES = ("apophis_lightcurve.obj", "itokawa_radar.obj", "itokawa_gaskell_q16.obj", "bennu_radar.obj")


def ground(name):
    data_file(f"shapes/{name}")
    return MeshGround(load_body(BodySpec(shape=name, unit="km"), ()).mesh)


@pytest.mark.parametrize("name", SHAPES)
def test_occlusion_by_a_shape_agrees_with_brute_force(name):
    shape = ground(name)
    points, normals = shape.sample(60, np.random.default_rng(1))
    for direction in ([1.0, 0.3, 0.1], [-0.2, 1.0, -0.6], [0.1, 0.2, 1.0]):
        camera_m = 3.0 * shape.reach_m * np.array(direction) / np.linalg.norm(direction)
        corners = shape.mesh.corners_m
        edges = corners[:, 1:] - corners[:, :1]
        seen = shape.in_sight(points, normals, camera_m)
        for point, normal, visible in zip(points, normals, seen, strict=True):
            ray = point - camera_m
            columns = np.stack([edges[:, 0], edges[:, 1], np.broadcast_to(-ray, (len(corners), 3))], axis=2)
            u, v, t = np.linalg.solve(columns, (camera_m - corners[:, 0])[..., None])[..., 0].T
            before = ((u > 0) & (v > 0) & (u + v < 1) & (t < 1 - 1e-7)).any()
            assert visible == (normal @ ray < 0 and not before)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_has_its_n_landmarks_a_frame_and_all_of_them_lie_on_it(name):
    shape = ground(name)
    section = SequenceSpec.model_validate({"orbit": {"revolutions": 1, "step_deg": 4}})
    counts = []
    for trial in range(20):
        truth, sequence = draw_sequence(section, CAMERA, shape, 5, trial)
        counts.append(np.mean([len(frame.tracks) for frame in sequence.frames]))
    assert np.mean(counts) == pytest.approx(15.0, abs=4 * np.std(counts, ddof=1) / np.sqrt(20))
    dense, _ = shape.spread(200_000)
    assert cKDTree(dense).query(truth.points_m)[0].max() < 0.02 * shape.reach_m


def test_gravity_of_itokawa_is_that_of_a_point_only_far_away():
    mesh = ground("itokawa_gaskell_q16.obj").mesh
    gravity, point = Polyhedron(mesh, 2.36), PointMass(2.36)
    far, near = np.array([3e4, 1e4, -2e4]), np.array([350.0, 0.0, 0.0])
    np.testing.assert_allclose(gravity.acceleration(far), point.acceleration(far), rtol=1e-4, atol=1e-14)
    assert gravity.acceleration(near)[0] / point.acceleration(near)[0] > 1.1, "more from above the end of a long body"


def test_the_scenario_of_apophis_draws():
    ground("apophis_lightcurve.obj")
    scenario = load_scenario("apophis-shape-sequence")
    assert scenario.spec.sequence.sphere_radius_m is None
    assert load_body(scenario.spec.body, scenario.search_dirs).mesh.radius_m < scenario.spec.sequence.orbit.radius_m
