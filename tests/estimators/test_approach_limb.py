"""The outline of shapes, profiles across the limb and the covariance of an arc, against closed forms and OpenCV."""

import cv2
import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.spatial.distance import pdist, squareform
from scipy.stats import multivariate_normal
from test_approach_geometry import CAMERA, MESH, POSE, dual_outline

from boresight.estimators.approach import limb
from boresight.estimators.approach.body import Patch
from boresight.estimators.approach.ellipsoid import Ellipsoid
from boresight.estimators.approach.fusion import grouped_covariance
from boresight.estimators.approach.limb_errors import correlated_covariance, limb_covariance, scatter_covariance
from boresight.estimators.approach.outline import ShapeOutline, outline_normals, ray_directions
from boresight.estimators.approach.profile import ACROSS_PX, DEPTHS_PX, blurred, fit_limb, sampled, second_law
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import MitsubaRenderer, choose_variant
from boresight.scenarios.bodies.embedded import EMBEDDED, icosphere
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Ellipses, Pose, View, look_at
from boresight.scenarios.observation import Frame, Observation
from boresight.scenarios.spec.brdf import LambertSpec
from boresight.scenarios.spec.camera import DetectorSpec


def test_the_outline_of_an_ellipsoid_is_its_dual_conic():
    rays, centre = ray_directions(180), CAMERA.project(POSE.translation_m)
    radius, points = ShapeOutline(MESH).at(POSE, CAMERA, centre, rays)
    outline = centre + radius[:, None] * rays
    np.testing.assert_allclose(CAMERA.project(points), outline, atol=1e-6)
    ellipse = Ellipses.from_conics(dual_outline()[None])
    fitted, size, _ = cv2.fitEllipse(outline.astype(np.float32))
    np.testing.assert_allclose(fitted, ellipse.centre_px[0], atol=0.02)
    np.testing.assert_allclose(sorted(size)[::-1], 2.0 * ellipse.semi_axes_px[0], atol=0.1)
    # The gradient of the conic is along its normal.
    gradient = np.column_stack([outline, np.ones(180)]) @ dual_outline()[:, :2]
    gradient /= np.linalg.norm(gradient, axis=1)[:, None] * np.sign(np.einsum("ni,ni->n", gradient, rays))[:, None]
    assert np.einsum("ni,ni->n", gradient, outline_normals(radius, rays)).min() > np.cos(np.radians(2.0))


def test_rays_from_outside_meet_the_far_side_or_nothing():
    rays = ray_directions(36)
    centre = CAMERA.project(POSE.translation_m) - [400.0, 0.0]
    radius, points = ShapeOutline(MESH).at(POSE, CAMERA, centre, rays)
    assert np.isfinite(radius[0]) and radius[0] > 400.0
    assert np.isnan(radius[18]) and np.isnan(points[18]).all()


@pytest.mark.parametrize(
    ("phase_deg", "radius_px", "law"),
    [(phase, radius, law) for phase in (5.0, 30.0, 80.0) for radius, law in ((6.0, 0.0), (30.0, 0.0), (30.0, 1.0))]
    + [(120.0, 30.0, 0.0), (120.0, 30.0, 1.0), (140.0, 12.0, 0.0), (140.0, 12.0, 1.0)],
)
def test_the_profile_finds_the_limb(phase_deg, radius_px, law):
    """A ball, drawn eight times as fine, by Lambert's law or that of Lommel and Seeliger; its light in closed form."""
    sun = np.array([np.sin(np.radians(phase_deg)), 0.0, -np.cos(np.radians(phase_deg))])
    fine = Camera(100 * 8, 100 * 8, 8e4, 8e4, 50.3 * 8, 49.6 * 8)
    pose = look_at(np.array([0.0, 0.0, -1000.0]))
    ball = Ellipsoid(np.zeros(3), np.eye(3) / (0.1 * radius_px) ** 2)
    image = ball.render(View(fine, pose, pose.rotation.T @ sun)).astype(np.float64)
    rows, columns = np.mgrid[:800, :800] + 0.5
    from_middle_px = np.hypot(columns / 8 - 50.3, rows / 8 - 49.6)
    emitted = np.sqrt(np.maximum(1.0 - (from_middle_px / radius_px) ** 2, 0.0))
    image = image / np.maximum(image + emitted, 1e-12) if law else image
    image = gaussian_filter(cv2.resize(image, (100, 100), interpolation=cv2.INTER_AREA), 0.7)
    angle = np.radians(np.linspace(-50.0, 50.0, 21))
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    limb = [50.3, 49.6] + radius_px * normals
    samples = sampled(Patch(image, 0, 0), limb[:, None] + ACROSS_PX[:, None] * normals[:, None])
    cosine = 1.0 - np.minimum(DEPTHS_PX / radius_px, 1.0)
    sine = np.sqrt(1.0 - cosine**2)
    incident = np.maximum((normals @ sun[:2])[:, None] * cosine - sun[2] * sine, 0.0)
    terms = blurred(np.stack([incident, incident / (incident + sine)], axis=1), radius_px, 0.7)
    start = np.full(21, 0.5)
    place, gain = fit_limb(samples, terms[:, [int(law)]], start)
    assert np.abs(place).max() < 0.1
    assert abs(place.mean()) < 0.03
    assert (gain[:, 0] > 0.0).all() and not gain[:, 1].any()
    # Within a narrow strip both laws are alike.
    if radius_px > 20.0 and phase_deg < 100.0:
        assert second_law(samples, terms, start) == pytest.approx(law, abs=0.15)


@pytest.mark.parametrize("name", ["contact-binary", "itokawa-like"])
def test_the_light_inside_the_outline_is_that_of_a_ray_tracer(name):
    """Facets by Mitsuba at the same pixels; the bodies hide parts of themselves, and the Sun is off to the side."""
    body, sun = EMBEDDED[name](), np.array([0.8, 0.0, -0.6])
    camera, depths_px = Camera(160, 128, 1000.0, 1000.0, 80.0, 64.0), np.arange(0.1, 8.0, 0.2)
    pose = look_at(body.radius_m * np.array([18.0, 9.0, 6.0]), 1.0)
    view, centre, rays = (
        View(camera, pose, pose.rotation.T @ sun),
        camera.project(pose.translation_m),
        ray_directions(90),
    )
    outline = ShapeOutline(body)
    radius, _ = outline.at(pose, camera, centre, rays)
    edge = centre + radius[:, None] * rays
    uv = edge[:, None] - depths_px[:, None] * outline_normals(radius, rays)[:, None]
    tracer = MitsubaRenderer(body, LambertSpec(), 1, variant=choose_variant())
    hits = tracer.surface(view, uv.reshape(-1, 2))
    sight = pose.camera_position_m - hits.points_body_m
    emitted = np.einsum("ni,ni->n", hits.normals_body, sight) / np.linalg.norm(sight, axis=1)
    incident = np.maximum(hits.normals_body @ view.sun_dir_body, 0.0)
    stated = np.nan_to_num(np.column_stack([incident, incident / (incident + emitted)])).reshape(*uv.shape[:2], 2)
    same = np.isclose(outline.light(view, uv), stated, atol=1e-5).all(axis=-1)
    assert same.mean() > 0.999  # places on the edges of facets may be in either
    assert 0.3 < (stated[..., 0] > 0.0).mean() < 0.95
    away = edge + 3.0 * outline_normals(radius, rays)
    assert (outline.light(view, away) == 0.0).mean() > 0.9


def test_facets_beside_and_behind_the_camera_have_no_light():
    """A ball about the camera, and one whose pixels are off the frame."""
    ball, camera = icosphere(2, 10.0), Camera(160, 128, 1000.0, 1000.0, 80.0, 64.0)
    outline, uv = ShapeOutline(ball), np.array([[[80.0, 64.0], [10.0, 5.0]]])
    for place in ([0.0, 0.0, 0.0], [0.0, 0.0, -100.0], [100.0, 0.0, 100.0]):
        view = View(camera, Pose(np.eye(3), np.array(place)), np.array([0.0, 0.0, -1.0]))
        assert not outline.light(view, uv).any()


@pytest.mark.parametrize("half_deg", [40.0, 90.0, 180.0])
def test_the_covariance_of_an_arc(half_deg):
    """Simulated: circles through noisy points of an arc, by SciPy."""
    focal, radius_m, range_m, sigma, n = 2000.0, 100.0, 4000.0, 0.1, 60
    rng = np.random.default_rng(3)
    theta = np.radians(np.linspace(-half_deg, half_deg, n, endpoint=False) + half_deg / n)
    normal, radius_px = np.column_stack([np.cos(theta), np.sin(theta)]), focal * radius_m / range_m
    found = []
    for _ in range(400):
        points = (radius_px + rng.normal(0.0, sigma, n))[:, None] * normal

        def distance(x, points=points):
            centre, z = focal * x[:2] / (range_m + x[2]), range_m + x[2]
            return np.linalg.norm(points - centre, axis=1) - focal * radius_m / z

        found.append(least_squares(distance, np.zeros(3), x_scale=[1.0, 1.0, 30.0]).x)
    stated = limb_covariance(n, sigma, np.radians(half_deg), radius_m, range_m, focal)
    # 400 trials: 3.5 % of a standard deviation, 1 sigma.
    np.testing.assert_allclose(np.std(found, axis=0), np.sqrt(np.diag(stated)), rtol=0.15)
    if half_deg < 180.0:
        together = np.corrcoef(np.array(found).T)[0, 2]
        assert together == pytest.approx(stated[0, 2] / np.sqrt(stated[0, 0] * stated[2, 2]), abs=0.1)
    with pytest.raises(BoresightError, match="half-angle"):
        limb_covariance(n, sigma, 0.0, radius_m, range_m, focal)


def test_the_closed_form_of_an_arc_is_the_fit_s():
    """A sphere of 200 px on the boresight with the Sun to the right: the points of the fit make the same covariance."""
    camera, ball = Camera(400, 400, 2000.0, 2000.0, 200.0, 200.0), icosphere(5, 100.0)
    pose = look_at(np.array([0.0, -2000.0, 0.0]))
    sun, none = np.array([1.0, 0.0, 0.0]), np.zeros((400, 400), np.float32)
    edges = ShapeOutline(ball).silhouette(pose)
    scene = limb._Plan(Frame(none, sun, pose, np.eye(6)), camera, ray_directions(240), edges)
    points = limb.LimbEstimator(ball, limb.LimbOptions())._limb_at(scene, pose, np.array([200.0, 200.0]))
    found = 0.1**2 * np.linalg.inv(points.by_position.T @ points.by_position)
    half = np.arccos(points.normals[:, 0].min())
    stated = limb_covariance(len(points.ray), 0.1, half, 100.0, 2000.0, 2000.0)
    assert 1.2 < half < np.pi / 2
    np.testing.assert_allclose(np.diag(found), np.diag(stated), rtol=0.15)
    assert found[0, 2] == pytest.approx(stated[0, 2], rel=0.15)


def test_of_an_exact_ball_the_closed_form_is_stated_and_holds():
    """Renderings with noise, a wide prior and no errors but those of the points."""
    camera, ball, range_m = Camera(240, 240, 2000.0, 2000.0, 120.0, 120.0), icosphere(6, 250.0), 5000.0
    renderer = MitsubaRenderer(ball, LambertSpec(), 16, variant=choose_variant())
    method = limb.LimbEstimator(ball, limb.LimbOptions(shift=0.0, bias_px=0.0))
    sigmas = np.array([1e-9] * 3 + [50.0, 50.0, 500.0])
    ratio, nees = [], []
    for trial in range(20):
        rng = np.random.default_rng((12, trial))
        direction = rng.normal(size=3)
        truth = look_at(range_m * direction / np.linalg.norm(direction), rng.uniform(0.0, 6.0))
        truth = truth.perturbed(np.zeros(3), np.array([*rng.uniform(-20.0, 20.0, 2), 0.0]))
        phase, around = np.radians(rng.uniform(30.0, 90.0)), rng.uniform(0.0, 6.28)
        sun = np.array([np.sin(phase) * np.cos(around), np.sin(phase) * np.sin(around), -np.cos(phase)])
        image = renderer.render(View(camera, truth, truth.rotation.T @ sun))
        image = Detector(DetectorSpec()).expose(image, rng)
        prior = truth.perturbed(np.zeros(3), rng.normal(size=3) * [5.0, 5.0, 50.0])
        found = method.estimate(Observation(camera, Frame(image, sun, prior, np.diag(sigmas**2))), rng=rng)
        points, scatter_px = found.diagnostics["limb_points"], found.diagnostics["residual_px"]
        sigma_px = scatter_px * np.sqrt(points / (points - 3))
        half_rad = np.pi * points / limb._ray_count(200.0)
        closed = limb_covariance(points, sigma_px, half_rad, 250.0, range_m, 2000.0)
        stated = found.covariance[3:, 3:]
        ratio.append(np.sqrt(np.linalg.eigvalsh(stated) / np.linalg.eigvalsh(closed)))
        error_m = found.pose.translation_m - truth.translation_m
        nees.append(error_m @ np.linalg.solve(stated, error_m) / 3.0)
    np.testing.assert_allclose(np.median(ratio, axis=0), 1.0, atol=0.15)
    assert 0.6 < np.mean(nees) < 1.5


def outline_errors(rng, count, length_deg, share):
    """Errors of a half circle's points along their normals, of 0.3 px; directions and derivatives by a position."""
    theta = np.linspace(0.0, np.pi, count)
    directions = np.column_stack([np.cos(theta), np.sin(theta)])
    squares = squareform(pdist(directions)) ** 2
    kernel = share / (1.0 + squares / np.radians(length_deg) ** 2) + (1.0 - share) * np.eye(count)
    return (
        0.3 * np.linalg.cholesky(kernel) @ rng.normal(size=count),
        directions,
        np.column_stack([directions, np.ones(count)]),
    )


def test_correlated_errors_by_the_density_of_contrasts():
    """Contrasts that the unknowns do not move are normal: their density by SciPy, integrated over the scale."""
    errors, directions, by_position = outline_errors(np.random.default_rng(8), 14, 25.0, 0.75)
    size = np.arange(1.0, 15.0)
    contrasts = null_space(by_position.T)
    left = errors - by_position @ np.linalg.lstsq(by_position, errors)[0]
    total, expected, scales = 0.0, np.zeros((14, 14)), np.geomspace(0.01, 20.0, 400)
    for share in (0.0, 0.25, 0.5, 0.75, 0.9, 0.97):
        for length_deg in (3.0, 6.0, 12.0, 25.0, 50.0, 100.0):
            alike = 1.0 / (1.0 + squareform(pdist(directions)) ** 2 / np.radians(length_deg) ** 2)
            unit = share * alike + (1.0 - share) * np.diag(size.mean() / size)
            normal = multivariate_normal(cov=contrasts.T @ unit @ contrasts)
            weight = normal.pdf(np.outer(1.0 / scales, contrasts.T @ left)) / scales**11
            total += weight.sum()
            expected += (weight * scales**2).sum() * unit
    found = correlated_covariance(left, by_position, directions, size)
    np.testing.assert_allclose(found, expected / total, rtol=1e-4)


@pytest.mark.parametrize(("length_deg", "share"), [(3.0, 0.5), (12.0, 0.9), (25.0, 0.9), (50.0, 0.75)])
def test_a_fit_to_correlated_errors_has_the_stated_covariance(length_deg, share):
    """Simulated: NEES over 3 of the position by an unweighted fit. Arcs as groups state too small a covariance."""
    rng, squares, by_arcs = np.random.default_rng(9), [], []
    for _ in range(300):
        errors, directions, by_position = outline_errors(rng, 128, length_deg, share)
        inverse = np.linalg.inv(by_position.T @ by_position)
        moved = inverse @ by_position.T @ errors
        left = errors - by_position @ moved
        scatter, _ = scatter_covariance(left, by_position, directions, np.arange(128), np.ones(128))
        arcs = grouped_covariance(by_position * left[:, None], np.arange(128) * 6 // 128, 3)
        squares.append(moved @ np.linalg.solve(inverse @ scatter @ inverse, moved) / 3.0)
        by_arcs.append(moved @ np.linalg.solve(inverse @ arcs @ inverse, moved) / 3.0)
    # The least is that of nearly independent errors, for which correlations that reach far cannot be excluded.
    assert 0.2 < np.mean(squares) < 2.3 and np.median(squares) < 1.2
    assert np.mean(by_arcs) > 9.0


def test_few_points_have_the_scatter_of_their_weighted_errors():
    """Up to 32 neighbours are no groups, so that the covariance of the sum follows from that of the errors."""
    errors, directions, by_position = outline_errors(np.random.default_rng(10), 24, 12.0, 0.5)
    weight, ray = np.linspace(0.2, 5.0, 24), np.arange(24)
    covariance = correlated_covariance(errors, by_position, directions, weight / 5.0)
    scores = weight[:, None] * by_position
    found, sigma = scatter_covariance(errors, by_position, directions, ray, weight)
    np.testing.assert_allclose(found, scores.T @ covariance @ scores)
    assert sigma == pytest.approx(np.sqrt(np.diag(covariance).mean()))
    perfect, least = scatter_covariance(0.0 * errors, by_position, directions, ray, weight)
    assert 0.0 < np.trace(perfect) < 1e-4 * np.trace(found) and 5e-4 < least < 2e-3


def test_points_on_opposite_sides_are_no_neighbours():
    """The frame leaves two pieces of an outline, with a point and its opposite: they have no mean direction."""
    ray = np.concatenate([np.arange(11), np.arange(74, 127)])
    directions = ray_directions(128)[ray]
    by_position = np.column_stack([directions, np.ones(64)])
    errors = np.random.default_rng(11).normal(0.0, 0.3, 64)
    found, sigma = scatter_covariance(errors, by_position, directions, ray, np.ones(64))
    assert np.isfinite(found).all() and 0.2 < sigma < 0.6
