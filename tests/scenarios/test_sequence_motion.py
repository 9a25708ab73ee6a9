"""Orbits under forces and bodies that turn: closed forms, conserved quantities, numerical gradients, other solvers."""

from __future__ import annotations

import astropy.constants
import astropy.units
import cv2
import numpy as np
import pytest
import trimesh
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from boresight.scenarios.dynamics.gravity import PointMass, Polyhedron
from boresight.scenarios.dynamics.propagation import radiation_pressure
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, TriangleMesh
from boresight.scenarios.sequences import (
    MeshGround,
    SphereGround,
    camera_trajectory,
    draw_sequence,
    draw_unmodelled_m_s2,
)
from boresight.scenarios.sequences.trajectory import angular_velocity, attitude_function
from boresight.scenarios.spec.sequence import BodyMotionSpec, ForcesSpec, SequenceSpec

CAMERA = Camera.from_fov(1024, 1024, np.radians(30.0))
SPHERE = SphereGround(190.0)
GM = 3.54
CUBE = trimesh.creation.box((200.0, 200.0, 200.0))
TUMBLING = BodyMotionSpec(kind="tumbling", axis_body=(0.5, 0.3, 1.0))


def mesh_of(shape):
    return TriangleMesh(shape.vertices, shape.faces)


def spec(orbit=None, motion=None, knowledge=None, **more):
    return SequenceSpec.model_validate(
        {
            "sphere_radius_m": 190.0,
            "orbit": {"revolutions": 1.0, "step_deg": 6, **(orbit or {})},
            "body_motion": motion or {},
            "knowledge": knowledge or {},
            **more,
        }
    )


def calm(section):
    return np.zeros((section.orbit.frames - 1, 3))


def test_gravity_of_a_polyhedron_is_that_of_a_point_far_away_and_of_a_sphere_nearby():
    cube = Polyhedron(mesh_of(CUBE), GM)
    for direction in ([1.0, 0.0, 0.0], [0.3, -0.5, 0.8]):
        far = 2e4 * np.array(direction) / np.linalg.norm(direction)
        # A cube has no quadrupole: what is left falls off with the fourth power.
        np.testing.assert_allclose(cube.acceleration(far), PointMass(GM).acceleration(far), rtol=1e-7, atol=1e-15)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=190.0)
    near = np.array([120.0, 150.0, -80.0])
    expected = PointMass(GM).acceleration(near)
    np.testing.assert_allclose(Polyhedron(mesh_of(ball), GM).acceleration(near), expected, rtol=2e-3)


def test_a_polyhedron_agrees_with_the_sum_over_its_volume():
    """A box seen from outside, divided into small cubes with the gravity of points."""
    size = np.array([300.0, 200.0, 100.0])
    axes = [np.arange(-s / 2 + 1.25, s / 2, 2.5) for s in size]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    at = np.array([180.0, 90.0, 70.0])
    away = cells - at
    expected = GM / len(cells) * (away / np.linalg.norm(away, axis=1, keepdims=True) ** 3).sum(axis=0)
    box = Polyhedron(mesh_of(trimesh.creation.box(size)), GM)
    np.testing.assert_allclose(box.acceleration(at), expected, rtol=1e-4)


@pytest.mark.parametrize("at", [(150.0, 20.0, 30.0), (40.0, -30.0, 20.0)], ids=["outside", "inside"])
def test_the_divergence_of_gravity_obeys_poissons_equation(at):
    cube = Polyhedron(mesh_of(CUBE), GM)
    step = 1e-2
    divergence = sum(
        (cube.acceleration(np.array(at) + e)[i] - cube.acceleration(np.array(at) - e)[i]) / (2 * step)
        for i, e in enumerate(step * np.eye(3))
    )
    inside = np.abs(at).max() < 100.0
    expected = -4.0 * np.pi * GM / 200.0**3 if inside else 0.0
    assert cube.laplacian(np.array(at)) == pytest.approx(expected, abs=1e-15)
    assert divergence == pytest.approx(expected, abs=1e-11)


def test_solar_pressure_agrees_with_astropy_constants():
    sun = astropy.constants.L_sun / (4 * np.pi * astropy.constants.au**2 * astropy.constants.c)
    expected = 1.4 * 0.02 * sun.to_value(astropy.units.Pa) / 0.9**2
    forces = ForcesSpec(area_to_mass_m2_kg=0.02, reflectivity=1.4, sun_distance_au=0.9)
    sun_dir = np.array([0.0, 0.6, 0.8])
    np.testing.assert_allclose(radiation_pressure(forces, sun_dir), -expected * sun_dir, rtol=1e-3)


def test_a_point_mass_alone_keeps_the_circle_and_its_attitude():
    section = spec({"model": "propagated", "normal_body": [1, 2, -0.5], "revolutions": 2})
    free = camera_trajectory(section, SPHERE, calm(section))
    circle = camera_trajectory(spec({"normal_body": [1, 2, -0.5], "revolutions": 2}), SPHERE, calm(section))
    np.testing.assert_allclose(free.positions_m, circle.positions_m, atol=1e-6)
    np.testing.assert_allclose(free.velocities_m_s, circle.velocities_m_s, atol=1e-11)
    for one, two in zip(free.poses, circle.poses, strict=True):
        np.testing.assert_allclose(one.rotation, two.rotation, atol=1e-8)


def runge_kutta(state, interval, push, steps=40):
    """The classic method of fourth order."""

    def change(y):
        return np.concatenate([y[3:], -GM * y[:3] / np.linalg.norm(y[:3]) ** 3 + push])

    h = interval / steps
    for _ in range(steps):
        k1 = change(state)
        k2 = change(state + h / 2 * k1)
        k3 = change(state + h / 2 * k2)
        k4 = change(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


def test_sunlight_and_noise_move_the_orbit_as_another_solver_says():
    """The pressure alone keeps r x v along its axis, and the energy with its own potential."""
    forces = {"area_to_mass_m2_kg": 0.02, "noise_m_s2": 1e-7}
    section = spec({"model": "propagated", "normal_body": [0, 1, 0], "forces": forces})
    kicks = draw_unmodelled_m_s2(section.orbit, 3, 1)
    path = camera_trajectory(section, SPHERE, kicks)
    push = -4.5398e-6 * 1.3 * 0.02 * np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(path.radiation_m_s2, push, rtol=1e-4)

    state = np.concatenate([path.positions_m[0], path.velocities_m_s[0]])
    for kick, interval in zip(kicks, np.diff(path.times_s), strict=True):
        state = runge_kutta(state, interval, path.radiation_m_s2 + kick)
    np.testing.assert_allclose(path.positions_m[-1], state[:3], atol=1e-3)
    still = camera_trajectory(section, SPHERE, calm(section))
    assert 1.0 < np.linalg.norm(path.positions_m[-1] - still.positions_m[-1]) < 2000.0
    energy = 0.5 * np.sum(still.velocities_m_s**2, axis=1) - GM / np.linalg.norm(still.positions_m, axis=1)
    energy -= still.positions_m @ still.radiation_m_s2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)
    about = np.cross(still.positions_m, still.velocities_m_s)[:, 1]
    np.testing.assert_allclose(about, about[0], rtol=1e-10)


def test_unmodelled_acceleration_has_the_asked_deviation_and_its_own_draws():
    orbit = spec({"model": "propagated", "forces": {"noise_m_s2": 1e-7}, "step_deg": 0.1}).orbit
    drawn = draw_unmodelled_m_s2(orbit, 1, 0)
    assert drawn.shape == (3600, 3)
    assert np.std(drawn) == pytest.approx(1e-7, rel=0.04)
    assert not np.array_equal(drawn, draw_unmodelled_m_s2(orbit, 1, 1))


def test_a_rotating_polyhedron_conserves_the_jacobi_integral():
    egg = trimesh.creation.icosphere(subdivisions=2, radius=150.0).apply_scale([1.3, 1.0, 0.8])
    section = SequenceSpec.model_validate(
        {
            "orbit": {"model": "propagated", "forces": {"gravity": "polyhedral"}, "step_deg": 6, "revolutions": 0.5},
            "body_motion": {"kind": "spin", "period_h": 5},
        }
    )
    path = camera_trajectory(section, MeshGround(mesh_of(egg)), calm(section))
    ball = camera_trajectory(spec({"model": "propagated", "revolutions": 0.5}), SPHERE, calm(section))
    assert np.linalg.norm(path.positions_m[-1] - ball.positions_m[-1]) > 1.0
    # E - Omega h is constant about a body that turns uniformly; its potential is integrated along x from far away.
    rate = 2 * np.pi / (5 * 3600)
    gravity = Polyhedron(mesh_of(egg), GM)
    speeds = 0.5 * np.sum(path.velocities_m_s**2, axis=1)
    turned = rate * np.cross(path.positions_m, path.velocities_m_s)[:, 2]
    body = np.einsum("fij,fj->fi", path.R_body_inertial, path.positions_m)
    potential = np.array([_potential(gravity, at) for at in body[[0, 15, 30]]])
    jacobi = (speeds - turned)[[0, 15, 30]] - potential
    np.testing.assert_allclose(jacobi, jacobi[0], rtol=1e-7)


def _potential(gravity, at):
    """Potential by Gauss-Legendre quadrature of gravity in 1 / r from 1000 times the distance, a point mass beyond."""
    radius = np.linalg.norm(at)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    inverse = 0.5 * (nodes + 1) / radius
    pull = [gravity.acceleration(at / radius / u) @ at / radius / u**2 for u in inverse]
    return -0.5 / radius * float(weights @ np.array(pull))


def test_an_orbit_that_impacts_is_refused():
    section = spec({"model": "propagated"})
    with pytest.raises(BoresightError, match=r"the orbit leads into the body, which reaches .* after .* h"):
        camera_trajectory(section, SphereGround(780.0), calm(section) + np.array([1e-6, 0.0, 0.0]))


def test_a_spin_turns_the_body_once_a_period_and_is_that_of_opencv():
    motion = BodyMotionSpec(kind="spin", period_h=10, axis_body=(1.0, 2.0, 2.0))
    rate = angular_velocity(motion)
    attitude = attitude_function(motion, rate, 1e5)
    np.testing.assert_allclose(attitude(np.array([0.0, 36000.0])), np.tile(np.eye(3), (2, 1, 1)), atol=1e-12)
    # A point of the body moves by + omega t in inertial space, so inertial points move by - omega t in the body's.
    expected = cv2.Rodrigues(-rate * 5000.0)[0]
    np.testing.assert_allclose(attitude(np.array([5000.0]))[0], expected, atol=1e-12)


def test_tumbling_conserves_energy_and_angular_momentum():
    rate = angular_velocity(TUMBLING)
    times = np.linspace(0.0, 5e5, 2001)
    turns = attitude_function(TUMBLING, rate, times[-1])(times)
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (2001, 1, 1)), atol=1e-12)
    # The angular velocity from the attitudes alone: R(t + dt) R(t)^T = exp(-omega dt).
    small = 1.0
    later = attitude_function(TUMBLING, rate, times[-1] + small)(times + small)
    omega = -Rotation.from_matrix(later @ np.swapaxes(turns, 1, 2)).as_rotvec() / small
    inertia = np.array(TUMBLING.inertia)
    energy = np.sum(inertia * omega**2, axis=1)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-4)
    momentum = np.einsum("tji,tj->ti", turns, inertia * omega)
    np.testing.assert_allclose(momentum, np.tile(inertia * rate, (2001, 1)), atol=1e-4 * np.linalg.norm(inertia * rate))
    assert np.ptp(omega[:, 2]) > 0.01 * np.linalg.norm(rate), "it tumbles"


def test_a_symmetric_top_precesses_in_closed_form():
    """Poinsot's cone: the spin along the momentum at |L| / I1, about the figure at (I1 - I3) / I1 of its own rate."""
    motion = BodyMotionSpec(kind="tumbling", period_h=8, axis_body=(1.0, 0.0, 2.0), inertia=(1.0, 1.0, 1.6))
    rate = angular_velocity(motion)
    momentum = np.array(motion.inertia) * rate
    time = 7e4
    about_momentum = Rotation.from_rotvec(momentum / 1.0 * time)
    about_figure = Rotation.from_rotvec([0.0, 0.0, (1.0 - 1.6) / 1.0 * rate[2] * time])
    expected = (about_momentum * about_figure).as_matrix().T
    np.testing.assert_allclose(attitude_function(motion, rate, time)(np.array([time]))[0], expected, atol=1e-9)


def test_a_turning_body_is_seen_by_the_same_bearings_and_moves_its_landmarks():
    section = spec(motion={"kind": "spin", "period_h": 12}, vision={"noise_px": 0.0}, knowledge={"motion_error": 0})
    truth, sequence = draw_sequence(section, CAMERA, SPHERE, 5, 0)
    place = sequence.position_m
    for pose, frame in zip(truth.poses, sequence.frames, strict=True):
        turn = frame.R_body_inertial
        rotation = frame.R_cam_body @ turn
        at = turn.T @ pose.camera_position_m
        np.testing.assert_allclose(np.linalg.norm(at), 790.0)
        points = truth.points_m[frame.tracks] @ turn
        expected = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], -rotation @ at, CAMERA.matrix, None)[0][:, 0]
        np.testing.assert_allclose(frame.uv_px, expected, atol=1e-6)
        place = place + frame.motion_m
        np.testing.assert_allclose(place, pose.camera_position_m, atol=1e-9)
    angle = Rotation.from_matrix(sequence.frames[-1].R_body_inertial).magnitude()
    hours = sequence.frames[-1].time_s / 3600
    assert np.cos(angle) == pytest.approx(np.cos(2 * np.pi * hours / 12), abs=1e-12)


def test_errors_of_pole_and_rate_grow_as_their_law_says():
    knowledge = {"pole_sigma_deg": 0.4, "spin_sigma": 0.001}
    section = spec(motion={"kind": "spin", "period_h": 20.6}, knowledge=knowledge)
    squares = []
    for trial in range(30):
        truth, sequence = draw_sequence(section, CAMERA, SPHERE, 5, trial)
        known = np.array([frame.R_body_inertial for frame in sequence.frames])
        errors = Rotation.from_matrix(known @ np.swapaxes(truth.trajectory.R_body_inertial, 1, 2)).as_rotvec()
        squares.append(np.sum(errors**2, axis=1) / 3)
        seen = sequence.frames[20].R_cam_body @ known[20]
        np.testing.assert_allclose(seen, truth.poses[20].rotation @ truth.trajectory.R_body_inertial[20], atol=1e-12)
    sigmas = [frame.attitude_sigma_rad for frame in sequence.frames]
    assert sigmas[0] == 0.0
    assert np.sqrt(np.mean(squares, axis=0))[[10, 30, 45]] == pytest.approx(np.array(sigmas)[[10, 30, 45]], rel=0.25)
    assert sigmas[30] > 3 * sigmas[5]


def test_onboard_forces_have_the_stated_errors():
    forces = {"area_to_mass_m2_kg": 0.02, "noise_m_s2": 1e-7}
    knowledge = {"dynamics": True, "gm_sigma": 0.05, "radiation_sigma": 0.2, "velocity_sigma_m_s": 0.001}
    section = spec({"model": "propagated", "forces": forces, "revolutions": 0.1}, knowledge=knowledge)
    off = []
    for trial in range(100):
        truth, sequence = draw_sequence(section, CAMERA, SPHERE, 5, trial)
        known = sequence.forces
        true = truth.trajectory.radiation_m_s2
        scale = known.radiation_m_s2 @ true / (true @ true)
        off.append([known.gm_m3_s2 / GM - 1, scale - 1, *(known.velocity_m_s - truth.trajectory.velocities_m_s[0])])
    asked = [0.05, 0.2, 0.001, 0.001, 0.001]
    np.testing.assert_allclose(np.std(off, axis=0), asked, rtol=0.3)
    assert (np.abs(np.mean(off, axis=0)) < 4 * np.array(asked) / 10).all()
    assert (known.gm_sigma_m3_s2, known.noise_m_s2) == (pytest.approx(0.05 * GM), 1e-7)
    assert known.radiation_sigma_m_s2 == pytest.approx(0.2 * np.linalg.norm(truth.trajectory.radiation_m_s2))
    np.testing.assert_array_equal(known.velocity_covariance_m2_s2, 1e-6 * np.eye(3))
    assert draw_sequence(spec(), CAMERA, SPHERE, 5, 0)[1].forces is None


def test_ranges_are_repeated_at_the_given_interval():
    section = spec(knowledge={"range_every": 10, "ranges": 2, "range_sigma_m": 0.5})
    truth, sequence = draw_sequence(section, CAMERA, SPHERE, 5, 0)
    with_ranges = [i for i, frame in enumerate(sequence.frames) if frame.ranges]
    assert with_ranges == list(range(0, 61, 10))
    errors = [
        one.range_m - np.linalg.norm(truth.points_m[one.track] - truth.poses[i].camera_position_m)
        for i in with_ranges
        for one in sequence.frames[i].ranges
    ]
    assert len(errors) == 14
    assert 0.2 < np.std(errors) < 1.0
    assert all(one.track in sequence.frames[i].tracks for i in with_ranges for one in sequence.frames[i].ranges)
    alone = draw_sequence(spec(knowledge={"ranges": 2, "range_sigma_m": 0.5}), CAMERA, SPHERE, 5, 0)[1]
    assert alone.frames[0].ranges == sequence.frames[0].ranges


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"orbit": {"forces": {"noise_m_s2": 1e-7}}}, "say model: propagated"),
        ({"orbit": {"model": "propagated", "forces": {"gravity": "polyhedral"}}}, "pulls like a point"),
        ({"body_motion": {"kind": "tumbling"}}, "is a principal axis"),
        ({"body_motion": {"kind": "spin", "axis_body": [0, 0, 0]}}, "axis_body is zero"),
        ({"body_motion": {"kind": "tumbling", "inertia": [1, 1, 3], "axis_body": [1, 0, 1]}}, "no moment may exceed"),
        ({"body_motion": {"kind": "spin", "inertia": [1, 1, 1]}}, "say kind: tumbling"),
        ({"knowledge": {"pole_sigma_deg": 1}}, "the body does not turn"),
        ({"knowledge": {"gm_sigma": 0.1}}, "say dynamics: true"),
    ],
)
def test_inconsistent_sections_are_refused_with_the_reason(section, said):
    with pytest.raises(ValidationError, match=said):
        SequenceSpec.model_validate({"sphere_radius_m": 190.0, **section})
