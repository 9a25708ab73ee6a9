"""Orbit scenarios: horizons against rays, shapes as harmonics, statistics of the sightings."""

import numpy as np
import pytest
import trimesh
from orbit_worlds import lump, orbit_world

from boresight.scenarios.bodies.embedded import contact_binary
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.orbits.draw import draw_knowledge, draw_orbit
from boresight.scenarios.orbits.shape import fit_star_shape
from boresight.scenarios.orbits.sightings import Horizons, merged_numbers
from boresight.scenarios.orbits.true_orbit import state_at_epoch
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.orbit import ArcSpec


def test_horizons_agree_with_ray_tracing():
    mesh = contact_binary()
    ground = MeshGround(mesh)
    points, normals = ground.sample(300, np.random.default_rng(1))
    horizons = Horizons.of(mesh, points, normals)
    hidden, agree = [], []
    for direction in np.random.default_rng(2).normal(size=(30, 3)):
        camera = 20_000.0 * direction / np.linalg.norm(direction)
        towards = (camera - points) / np.linalg.norm(camera - points, axis=1, keepdims=True)
        cosine = np.einsum("ni,ni->n", normals, towards)
        seen = ground.in_sight(points, normals, camera)
        low = (cosine > 0.0) & (cosine < 0.3)
        hidden.append((~seen)[low].mean())
        agree.append((seen == horizons.free(np.arange(len(points)), towards))[low].mean())
    assert np.mean(hidden) > 0.05  # there is something to hide
    assert np.mean(agree) > 0.95


def test_rays_intersect_an_ellipsoid_as_in_closed_form():
    ball = trimesh.creation.icosphere(subdivisions=4)
    axes = np.array([300.0, 220.0, 160.0])
    shape = fit_star_shape(TriangleMesh(np.array(ball.vertices) * axes, np.array(ball.faces)), 16)
    assert shape.rms_m < 0.5
    rng = np.random.default_rng(3)
    origins = rng.normal(size=(50, 3))
    origins *= 3000.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    rays = 60.0 * rng.normal(size=(50, 3)) - origins
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    a = np.sum((rays / axes) ** 2, axis=1)
    b, c = np.sum(origins * rays / axes**2, axis=1), np.sum((origins / axes) ** 2, axis=1) - 1.0
    exact = origins + ((-b - np.sqrt(b * b - a * c)) / a)[:, None] * rays
    assert np.linalg.norm(shape.intersect(origins, rays) - exact, axis=1).max() < 3.0
    missing = shape.intersect(np.array([[3000.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    assert np.linalg.norm(missing[0] - [300.0, 0.0, 0.0]) < 2.0


def test_more_degrees_fit_a_shape_better_and_too_many_are_refused():
    mesh = lump()
    errors = [fit_star_shape(mesh, degree).rms_m for degree in (2, 4, 8, 12)]
    assert np.all(np.diff(errors) < 0.0)
    with pytest.raises(BoresightError, match="shape_degree: 34"):
        fit_star_shape(mesh, 34)


def test_the_initial_state_has_the_given_elements():
    arc = ArcSpec(eccentricity=0.3, inclination_deg=50, node_deg=70, pericentre_deg=20, anomaly_deg=130)
    state = state_at_epoch(arc, 4.463e5)
    r, v = state[:3], state[3:]
    h = np.cross(r, v)
    e = np.cross(v, h) / 4.463e5 - r / np.linalg.norm(r)
    assert 1.0 / (2.0 / np.linalg.norm(r) - v @ v / 4.463e5) == pytest.approx(arc.semi_major_axis_m)  # vis viva
    assert np.linalg.norm(e) == pytest.approx(0.3)
    assert np.degrees(np.arccos(h[2] / np.linalg.norm(h))) == pytest.approx(50.0)
    assert np.degrees(np.arctan2(h[0], -h[1])) == pytest.approx(70.0)
    assert np.degrees(np.arcsin(e[2] / 0.3 / np.sin(np.radians(50.0)))) == pytest.approx(20.0)


def test_correct_sightings_are_the_projections_of_their_craters():
    world = orbit_world(pointing={"attitude_urad": 1e-3, "misalignment_urad": 0.0})
    truth, data = draw_orbit(world, 5, 0)
    pictures = data.pictures
    turns = world.rotation.at(pictures.times_s)
    off = []
    for image, crater, uv in zip(pictures.image, truth.crater, pictures.uv_px, strict=True):
        inertial = turns[image].T @ truth.points_body_m[crater] - truth.image_states[image, :3]
        off.append(uv - world.camera.project(pictures.R_cam_inertial[image] @ inertial))
    assert np.std(off) == pytest.approx(world.spec.sightings.noise_px, rel=0.1)
    assert np.array_equal(truth.crater, pictures.landmark)
    assert not truth.wrong.any()


def test_errors_have_the_stated_standard_deviations():
    world = orbit_world(sightings={"wrong_share": 0.2, "images": 200}, knowledge={"position_m": 40.0})
    truth, data = draw_orbit(world, 5, 1)
    assert truth.wrong.mean() == pytest.approx(0.2, abs=0.05)
    assert np.array_equal(truth.crater == data.pictures.landmark, ~truth.wrong)
    assert np.linalg.norm(data.knowledge.state[:3] - truth.states[0, :3]) == pytest.approx(40.0)
    numbers = merged_numbers(truth.points_body_m, 0.25, np.random.default_rng(0))
    assert (numbers != np.arange(len(numbers))).sum() == round(0.25 * len(numbers))
    assert np.unique(numbers, return_counts=True)[1].max() == 2


def test_only_the_onboard_spin_has_the_stated_errors():
    world = orbit_world(knowledge={"pole_sigma_deg": 2.0, "spin_sigma": 1e-3})
    (truth, exact), (same, wrong) = draw_orbit(orbit_world(), 5, 0), draw_orbit(world, 5, 0)
    np.testing.assert_array_equal(same.states, truth.states)
    for name in ("R_cam_inertial", "uv_px", "landmark"):
        np.testing.assert_array_equal(getattr(wrong.pictures, name), getattr(exact.pictures, name))
    np.testing.assert_array_equal(wrong.knowledge.state, exact.knowledge.state)
    assert abs(wrong.landmarks.positions_body_m - exact.landmarks.positions_body_m).max() > 1.0
    spins = [draw_knowledge(world, truth.states[0], 5, trial).field.rotation for trial in range(400)]
    poles = np.array([spin.at(np.zeros(1))[0].T @ [0.0, 0.0, 1.0] for spin in spins])
    assert np.degrees(poles[:, :2].std(axis=0)) == pytest.approx([2.0, 2.0], rel=0.15)  # 4 sigma of 400 draws
    assert np.degrees(poles[:, :2].mean(axis=0)) == pytest.approx([0.0, 0.0], abs=0.4)
    ratios = np.array([spin.rate_rad_s for spin in spins]) / exact.knowledge.field.rotation.rate_rad_s
    assert ratios.std() == pytest.approx(1e-3, rel=0.15)
    assert ratios.mean() == pytest.approx(1.0, abs=2e-4)


def test_the_same_trial_gives_the_same_bits_and_another_does_not():
    world = orbit_world()
    (one, first), (_, again), (_, other) = (draw_orbit(world, 5, trial) for trial in (0, 0, 1))
    assert np.array_equal(first.pictures.uv_px, again.pictures.uv_px)
    assert np.array_equal(first.knowledge.state, again.knowledge.state)
    assert first.pictures.uv_px.shape != other.pictures.uv_px.shape or not np.array_equal(
        first.pictures.uv_px, other.pictures.uv_px
    )
    assert np.isfinite(one.states).all()
