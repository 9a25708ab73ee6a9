"""Orbit scenarios: horizons against rays, shapes as harmonics, statistics of the sightings."""

import numpy as np
import pytest
import trimesh
from orbit_worlds import lump, orbit_world
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from boresight.scenarios.bodies.embedded import contact_binary
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import TriangleMesh
from boresight.scenarios.orbits.draw import (
    draw_knowledge,
    draw_orbit,
    draw_radiometry,
    lit_and_seen,
    merged_numbers,
    misidentify,
)
from boresight.scenarios.orbits.true_orbit import _true_forces, propagate_truth, state_at_epoch, true_views
from boresight.scenarios.orbits.world import Horizons, fit_star_shape
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.orbit import ArcSpec, CraterSightingSpec


def test_horizons_agree_with_ray_tracing():
    mesh = contact_binary()
    ground = MeshGround(mesh)
    points, normals = ground.sample(300, np.random.default_rng(1))
    horizons = Horizons.of(mesh, points, normals)
    wide = CraterSightingSpec(emission_max_deg=90.0, incidence_max_deg=90.0)
    hidden, agree, dark = [], [], []
    for direction in np.random.default_rng(2).normal(size=(30, 3)):
        camera = 20_000.0 * direction / np.linalg.norm(direction)
        towards = (camera - points) / np.linalg.norm(camera - points, axis=1, keepdims=True)
        cosine = np.einsum("ni,ni->n", normals, towards)
        seen = ground.in_sight(points, normals, camera)
        low = (cosine > 0.0) & (cosine < 0.3)
        hidden.append((~seen)[low].mean())
        agree.append((seen == horizons.free(np.arange(len(points)), towards))[low].mean())
        # The same direction as that of the Sun, from a camera beside it.
        beside = camera + np.array([0.0, 9000.0, 0.0])
        sighted = lit_and_seen(horizons, beside, direction / np.linalg.norm(direction), wide)
        dark.append((~seen & low)[sighted].sum() / max(low[sighted].sum(), 1))
    assert np.mean(hidden) > 0.05  # there is something to hide
    assert np.mean(agree) > 0.95
    assert np.mean(dark) < 0.4 * np.mean(hidden)


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
    known, error = data.knowledge, data.knowledge.state - truth.states[0]
    assert np.linalg.norm(error[:3]) == pytest.approx(40.0)
    # On a circle of 3000 m a velocity is wrong by the same share as a position; each axis has a third of the square.
    assert np.linalg.norm(error[3:]) / np.sqrt(5.0 / 3000.0) == pytest.approx(40.0 / 3000.0)
    assert 3.0 * known.position_sigma_m**2 == pytest.approx(error[:3] @ error[:3])
    assert 3.0 * known.velocity_sigma_m_s**2 == pytest.approx(error[3:] @ error[3:])
    right = ~np.isin(data.landmarks.numbers, data.pictures.landmark[truth.wrong])
    off = (data.landmarks.positions_body_m - truth.points_body_m[data.landmarks.numbers]) / data.landmarks.sigma_m[
        :, None
    ]
    assert 0.2 < np.sqrt(np.mean(off[right] ** 2)) < 1.0  # an error of 40 m, mostly across the line of sight
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


def test_ranges_and_rates_are_those_of_a_distant_station_and_share_a_bias():
    sigmas = {"range_sigma_m": 0.01, "range_rate_sigma_m_s": 1e-6, "range_bias_sigma_m": 5.0}
    world = orbit_world(radiometry=sigmas)
    flown = propagate_truth(world, np.zeros(0), 5, 0)
    drawn = [draw_radiometry(world, flown, 5, trial) for trial in range(200)]
    earth = 1e9 * np.array([0.75, -0.45, 0.48]) / np.linalg.norm([0.75, -0.45, 0.48])

    def distance_m(seconds):
        return np.linalg.norm(earth - flown.radio_states[:, :3] - seconds * flown.radio_states[:, 3:], axis=1) - 1e9

    offsets = np.array([one.range_m - distance_m(0.0) for one in drawn])
    assert offsets.mean(axis=1).std() == pytest.approx(5.0, rel=0.2)  # 4 sigma of 200 draws
    assert offsets.std(axis=1).max() < 0.02
    rates = 0.005 * (distance_m(100.0) - distance_m(-100.0))
    assert abs(np.array([one.range_rate_m_s for one in drawn]) - rates).max() < 1e-5


def test_views_are_in_the_axes_of_the_shape_model_with_the_true_camera():
    exact = {"attitude_urad": 1e-6, "misalignment_urad": 0.0, "focal_error": 0.01}
    world = orbit_world(pointing=exact)
    flown = propagate_truth(world, np.array([3600.0, 50_000.0]), 5, 0)
    reported = Rotation.random(2, rng=np.random.default_rng(1)).as_matrix()
    sun = np.array([0.6, 0.0, 0.8])
    assert np.linalg.norm(world.asteroid.centre_m) > 1.0
    for view, state, time_s, attitude in zip(
        true_views(world, flown, reported, 5, 0), flown.image_states, flown.times_s, reported, strict=True
    ):
        to_body = Rotation.from_euler("z", -360.0 * time_s / 3600.0 / 5.27, degrees=True)
        place = to_body.apply(state[:3]) + world.asteroid.centre_m
        np.testing.assert_allclose(view.T_cam_body.camera_position_m, place, atol=1e-6)
        np.testing.assert_allclose(view.sun_dir_body, to_body.apply(sun), atol=1e-9)
        np.testing.assert_allclose(view.T_cam_body.rotate(view.sun_dir_body), attitude @ sun, atol=1e-9)
        longer = view.camera.fx_px / world.camera.fx_px
        assert 0.0 < abs(longer - 1.0) < 0.04
        assert view.camera.fy_px / world.camera.fy_px == pytest.approx(longer)


def test_unmodelled_accelerations_have_their_share_of_the_light_and_their_time():
    # Over 365 days, 1460 pieces of 6 h: three axes, of which every eighth piece is independent.
    world = orbit_world(light={"area_to_mass_m2_kg": 0.01, "noise_share": 0.1}, arc={"days": 365.0})
    _, pushes = _true_forces(world, 5, 0)
    light_m_s2 = 1361.0 / 299_792_458.0 * 1.3 * 0.01 / 1.75**2
    rms = np.sqrt(np.mean(pushes.acceleration_m_s2**2))
    assert rms == pytest.approx(0.1 * light_m_s2, rel=0.1)
    later, now = pushes.acceleration_m_s2[4:], pushes.acceleration_m_s2[:-4]
    assert np.diff(pushes.edges_s) == pytest.approx(21_600.0)
    assert np.mean(later * now) / rms**2 == pytest.approx(np.exp(-1.0), abs=0.15)


def test_a_wrong_number_is_that_of_a_near_crater():
    spec = CraterSightingSpec(wrong_share=0.999, wrong_within_px=40.0)
    uv, rng = np.array([[0.0, 0.0], [40.0, 0.0], [0.0, 80.0]]), np.random.default_rng(3)
    given = [misidentify(np.arange(3), np.array([0]), uv, spec, rng)[0][0] for _ in range(4000)]
    # Densities of a normal law at one and at two standard deviations.
    assert np.mean(np.array(given) == 1) == pytest.approx(norm.pdf(1) / (norm.pdf(1) + norm.pdf(2)), abs=0.03)
