"""Outlines, the horizon of ellipsoids, limb profiles and covariances, against closed forms and other software."""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import fourier_shift, gaussian_filter
from scipy.optimize import least_squares

from boresight.estimators.approach.body import Patch
from boresight.estimators.approach.correlation import correlation_shift, correlation_weights
from boresight.estimators.approach.ellipsoid import Ellipsoid
from boresight.estimators.approach.fusion import fuse, grouped_covariance
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies.embedded import EMBEDDED, icosphere
from boresight.scenarios.geometry import Camera, Ellipses, TriangleMesh, View, look_at
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.brdf import LambertSpec

CAMERA = Camera(512, 400, 2000.0, 2000.0, 256.0, 200.0)
SEMI_M = np.array([300.0, 240.0, 180.0])
POSE = look_at(np.array([3000.0, 2000.0, 1500.0]), 0.4).perturbed(np.zeros(3), np.array([60.0, -40.0, 0.0]))
MESH = TriangleMesh(icosphere(6, 1.0).vertices_m * SEMI_M, icosphere(6, 1.0).faces)


def dual_outline():
    """The ellipse of the outline: the dual conic P Q* P^T of the dual quadric of the ellipsoid."""
    projection = CAMERA.matrix @ np.column_stack([POSE.rotation, POSE.translation_m])
    return np.linalg.inv(projection @ np.diag([*SEMI_M**2, -1.0]) @ projection.T)


def test_the_ellipsoid_of_a_mesh_has_its_moments():
    found = Ellipsoid.of(MESH)
    np.testing.assert_allclose(found.centre_m, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.form, np.diag(SEMI_M**-2.0), rtol=1e-3, atol=1e-12)
    body = EMBEDDED["contact-binary"]()
    found, theirs = Ellipsoid.of(body), trimesh.Trimesh(body.vertices_m, body.faces, process=False)
    np.testing.assert_allclose(found.centre_m, theirs.center_mass, atol=1e-6 * body.radius_m)
    values, axes = np.linalg.eigh(found.form)
    assert 4.0 / 3.0 * np.pi / np.sqrt(values.prod()) == pytest.approx(theirs.volume)
    inertia = axes.T @ theirs.moment_inertia @ axes
    np.testing.assert_allclose(inertia - np.diag(np.diag(inertia)), 0.0, atol=1e-6 * inertia.max())


def test_the_horizon_gives_the_position():
    t = np.linspace(0.0, 1.7, 40)  # an arc of about a quarter
    points = Ellipses.from_conics(dual_outline()[None]).points(360)[0][0][(t * 57.3).astype(int)]
    ellipsoid = Ellipsoid(np.zeros(3), np.diag(SEMI_M**-2.0))
    found = ellipsoid.from_horizon(CAMERA.unproject(points), POSE.rotation)
    np.testing.assert_allclose(found, POSE.translation_m, rtol=1e-6)
    moved = Ellipsoid(np.array([10.0, 0.0, 5.0]), ellipsoid.form).from_horizon(CAMERA.unproject(points), POSE.rotation)
    np.testing.assert_allclose(moved, POSE.translation_m - POSE.rotation @ [10.0, 0.0, 5.0], rtol=1e-6)
    noisy = points + np.random.default_rng(1).normal(0.0, 0.05, points.shape)

    def distances(translation):
        projection = CAMERA.matrix @ np.column_stack([POSE.rotation, translation])
        conic = np.linalg.inv(projection @ np.diag([*SEMI_M**2, -1.0]) @ projection.T)
        x = np.column_stack([noisy, np.ones(40)])
        return np.einsum("ni,ij,nj->n", x, conic, x) / np.linalg.norm(x @ conic[:, :2], axis=1) / 2.0

    best = least_squares(distances, POSE.translation_m, x_scale=[1.0, 1.0, 10.0])
    spread = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac))) * 0.05
    ours = ellipsoid.from_horizon(CAMERA.unproject(noisy), POSE.rotation)
    assert (np.abs(ours - best.x) < 3.0 * spread).all()


def test_directions_that_no_body_has_give_none():
    rays = CAMERA.unproject(np.array([[256.0, 200.0]] * 6))
    assert Ellipsoid(np.zeros(3), np.eye(3)).from_horizon(rays, np.eye(3)) is None


def test_the_lambertian_ellipsoid_is_the_renderer_s():
    sun = np.array([0.6, 0.3, 0.74])
    view = View(CAMERA, POSE, sun)
    ours = Ellipsoid.of(MESH).render(view)
    theirs = MitsubaRenderer(MESH, LambertSpec(), 4, variant=choose_variant()).render(view)
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.9995


def test_groups_take_the_place_of_unknown_correlations():
    """Scores that are equal within groups of five: the sum's variance is five times that of independent ones."""
    rng, group = np.random.default_rng(4), np.repeat(np.arange(60), 5)
    stated = [grouped_covariance(np.repeat(rng.normal(size=(60, 2)), 5, axis=0), group, 0) for _ in range(50)]
    np.testing.assert_allclose(np.mean(stated, axis=0), 60 * 25 * np.eye(2), atol=0.1 * 60 * 25)
    alone = grouped_covariance(np.ones((4, 1)), np.arange(4), 3)
    assert alone == pytest.approx(4.0 * 4.0 / 1.0)


def test_the_fused_covariance_is_that_of_the_errors():
    """Simulated: the attitude's error is not estimated, and is correlated with that of the position."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6))
    root[:3] *= 1e-3
    known, by_pose, noise = root @ root.T, rng.normal(size=(2, 6)), np.diag([0.3, 0.5])
    by_pose[:, :3] *= 1e3
    frame = Frame(np.zeros((400, 512), np.float32), np.array([0.0, 0.0, -1.0]), POSE, known)
    left = []
    for _ in range(4000):
        error = root @ rng.normal(size=6)  # of the truth from the prior
        seen = by_pose @ error + np.sqrt(np.diag(noise)) * rng.normal(size=2)
        found = fuse(Observation(CAMERA, frame), seen, by_pose, noise)
        left.append(error - np.concatenate([np.zeros(3), found.pose.translation_m - POSE.translation_m]))
    squares = np.einsum("ni,ij,nj->n", left, np.linalg.inv(found.covariance), left)
    # Chi-square of 6: the mean of 4,000 has the standard deviation 0.055.
    assert squares.mean() == pytest.approx(6.0, abs=0.25)
    np.testing.assert_array_equal(found.pose.rotation, POSE.rotation)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.3, -2.7), (-11.6, 7.25)])
def test_the_correlation_finds_a_shift(shift):
    """Shifted by SciPy's Fourier shift: exact for an image without frequencies above Nyquist's."""
    image = gaussian_filter(np.random.default_rng(6).uniform(size=(96, 96)), 2.0)
    image[:30] = image[:, :30] = image[66:] = image[:, 66:] = 0.0
    image = gaussian_filter(image, 1.5)
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(image), shift[::-1])).real
    found = correlation_shift(Patch(3.0 * moved, 100, 50), Patch(np.where(image > 1e-6, image, 0.0), 100, 50))
    np.testing.assert_allclose(found, shift, atol=0.03)


def test_the_weights_are_derivatives_of_the_correlation_s_shift():
    rng = np.random.default_rng(7)
    image = np.pad(gaussian_filter(rng.uniform(size=(20, 20)), 1.5), 12)
    image = gaussian_filter(image, 1.5)
    noise = gaussian_filter(rng.normal(size=image.shape), 1.0) * 0.004
    shift = correlation_shift(Patch(image + noise, 0, 0), Patch(image, 0, 0))
    shift -= correlation_shift(Patch(image - noise, 0, 0), Patch(image, 0, 0))
    predicted = 2.0 * (correlation_weights(image, image) * noise).sum(axis=(1, 2))
    np.testing.assert_allclose(shift, predicted, rtol=0.15, atol=0.005)
