"""Simulated crater detections, and ray intersections with a mesh, against linear equations and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from crater_looks import CAMERA, RANGE_M, ellipsoid, population
from scipy.spatial.transform import Rotation

from boresight.scenarios.craters.simulated import (
    NO_CRATER,
    detect_simulated,
    draw_plane_craters,
    in_view,
    observed_frame,
)
from boresight.scenarios.geometry import Pose, View, look_at
from boresight.scenarios.spec.craters import DetectionErrorSpec, PlaneCratersSpec
from boresight.scenarios.spec.vectors import Normal3
from boresight.scenarios.spec.world import PoseErrorSpec


@pytest.fixture(scope="module")
def ground():
    return ellipsoid(3)


def test_ray_intersections_with_a_mesh_solve_the_linear_equations(ground) -> None:
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(60, 3))
    origins *= 40e3 / np.linalg.norm(origins, axis=1, keepdims=True)
    rays = rng.uniform(-9e3, 9e3, (60, 3)) - origins
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points, normals = ground.intersect(origins, rays)
    corners, count = ground.mesh.corners_m, 0
    for origin, ray, point, normal in zip(origins, rays, points, normals, strict=True):
        # origin + t ray = a + u (b - a) + v (c - a), for every facet
        sides = np.broadcast_to(-ray, (len(corners), 3))
        matrix = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], sides], axis=2)
        u, v, t = np.linalg.solve(matrix, (origin - corners[:, 0])[..., None])[..., 0].T
        t = np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0), t, np.inf)
        if not np.isfinite(t).any():
            assert np.isnan(point).all()
            assert np.isnan(normal).all()
            continue
        count += 1
        np.testing.assert_allclose(point, origin + t.min() * ray, atol=1e-6)
        np.testing.assert_allclose(normal, ground.mesh.normals[int(t.argmin())], atol=1e-9)
    assert 20 < count < 60


def test_sizes_follow_the_power_law(ground) -> None:
    section = PlaneCratersSpec(count=20_000, min_diameter_m=200.0, max_diameter_m=2000.0, exponent=2.0, seed=2)
    craters = draw_plane_craters(ground, section)
    above = [(craters.radius_m > radius).mean() for radius in (100.0, 200.0, 400.0)]
    closed = [(radius**-2 - 1e-6) / (1e-4 - 1e-6) for radius in (100.0, 200.0, 400.0)]
    np.testing.assert_allclose(above, closed, atol=4 * np.sqrt(0.25 / 20_000))


def _view() -> View:
    position = RANGE_M * np.array([0.0, 0.6, 0.8])
    pose = look_at(position)
    return View(CAMERA, Pose(pose.rotation, pose.translation_m), np.array([0.5, 0.4, 0.9]))


def test_detections_have_the_given_errors_misses_and_false_detections(ground) -> None:
    rng = np.random.default_rng(3)
    craters, view = population(ground, 4, 4000), _view()
    visible = in_view(craters, ground, view, (60.0, 0.0, 75.0))
    exact = DetectionErrorSpec(
        centre_px=0.0, centre_radii=0.0, axes_ratio=1e-12, recall=1.0 - 1e-12, false_share=0.0, height_m=0.0
    )
    errors = DetectionErrorSpec(centre_px=0.5, centre_radii=0.0, recall=0.7, false_share=0.2, height_m=0.0)
    truth = detect_simulated(craters, visible, view, exact, rng)
    assert len(truth.crater) > 60
    place = {int(crater): k for k, crater in enumerate(truth.crater)}
    right = false = 0
    residuals = []
    for _ in range(30):
        found = detect_simulated(craters, visible, view, errors, rng)
        own = found.crater != NO_CRATER
        right, false = right + int(own.sum()), false + int((~own).sum())
        rows = [place[int(crater)] for crater in found.crater[own]]
        residuals.append(found.ellipses.centre_px[own] - truth.ellipses.centre_px[rows])
    trials = 30 * len(truth.crater)
    assert abs(right / trials - 0.7) < 4 * np.sqrt(0.21 / trials)
    assert abs(false / (right + false) - 0.2) < 0.03
    assert np.concatenate(residuals).std() == pytest.approx(0.5, rel=0.05)


def test_craters_in_view_face_the_camera_and_the_sun(ground) -> None:
    craters, view = population(ground, 5, 3000), _view()
    rows = in_view(craters, ground, view, (60.0, 20.0, 75.0))
    assert len(rows) > 30
    towards = view.T_cam_body.camera_position_m - craters.centre_body_m[rows]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    assert (np.einsum("ni,ni->n", towards, craters.normal_body[rows]) > 0.5).all()
    incidence = np.degrees(np.arccos(craters.normal_body[rows] @ view.sun_dir_body))
    assert ((incidence > 20.0) & (incidence < 75.0)).all()
    # No rim leaves the frame: 60 points of each circle, about axes that are no part of the simulation.
    turns = np.linspace(0.0, 2.0 * np.pi, 60)
    for centre, normal, radius in zip(
        craters.centre_body_m[rows], craters.normal_body[rows], craters.radius_m[rows], strict=True
    ):
        axes = np.linalg.svd(normal[None])[2][1:]
        rim = centre + radius * (np.cos(turns)[:, None] * axes[0] + np.sin(turns)[:, None] * axes[1])
        assert CAMERA.contains(CAMERA.project(view.T_cam_body.transform(rim))).all()


def test_errors_grow_with_the_radius_and_do_not_prefer_the_long_axis(ground) -> None:
    rng = np.random.default_rng(6)
    craters, view = population(ground, 4, 4000), _view()
    visible = in_view(craters, ground, view, (60.0, 0.0, 75.0))
    sure = {"recall": 1.0 - 1e-12, "false_share": 0.0, "height_m": 0.0}
    exact = DetectionErrorSpec(centre_px=0.0, centre_radii=0.0, axes_ratio=1e-12, **sure)
    truth = detect_simulated(craters, visible, view, exact, rng)
    place = {int(crater): k for k, crater in enumerate(truth.crater)}
    errors = DetectionErrorSpec(centre_px=0.3, centre_radii=0.05, axes_ratio=0.3, **sure)
    scaled, long, short = [], [], []
    for _ in range(30):
        found = detect_simulated(craters, visible, view, errors, rng)
        true = truth.ellipses[[place[int(crater)] for crater in found.crater]]
        sigma = np.sqrt(0.3**2 + (0.05 * true.radius_px) ** 2)
        scaled.append((found.ellipses.centre_px - true.centre_px) / sigma[:, None])
        # Half the width of the found ellipse along the true axes, from its angle to each.
        off = found.ellipses.angle_rad - true.angle_rad
        a, b = found.ellipses.semi_axes_px.T
        assert (a >= b).all()
        long.append(np.log(np.hypot(a * np.cos(off), b * np.sin(off)) / true.semi_axes_px[:, 0]))
        short.append(np.log(np.hypot(a * np.sin(off), b * np.cos(off)) / true.semi_axes_px[:, 1]))
    assert np.concatenate(scaled).std() == pytest.approx(1.0, rel=0.05)
    for ratios in (np.concatenate(long), np.concatenate(short)):
        assert abs(ratios.mean()) < 4 * 0.3 / np.sqrt(len(ratios))
        assert ratios.std() == pytest.approx(0.3, rel=0.05)


def test_the_sun_of_an_observed_frame_is_in_the_axes_of_the_true_camera() -> None:
    view, error = _view(), PoseErrorSpec(position_cam_m=Normal3(normal=(10.0, 10.0, 10.0)))
    frame = observed_frame(view, np.zeros((2, 2), dtype=np.float32), error, np.random.default_rng(1), 5.0)
    turn = Rotation.from_matrix(view.T_cam_body.rotation)
    np.testing.assert_allclose(frame.sun_dir_cam, turn.apply(view.sun_dir_body.copy()), atol=1e-12)
    assert not np.allclose(frame.prior_T_cam_body.rotation, view.T_cam_body.rotation)
