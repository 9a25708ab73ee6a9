"""Displacements of windows against shifts that are known, their covariances against scatter, and the pose from them."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.estimators.landmark.pose.posterior import GaussianPose, Posterior, solve_map, window_overlap
from boresight.estimators.landmark.pose.problem import PoseProblem
from boresight.estimators.maplets.database import MapletDatabase
from boresight.estimators.maplets.displacement import (
    Displacement,
    correlate_window,
    make_pair,
    refine_window,
    shift_covariance,
)
from boresight.estimators.maplets.matching import (
    MapletMatches,
    MapletRendering,
    MatchingOptions,
    _collect,
    _reach_px,
    body_mask,
    visible_windows,
)
from boresight.estimators.maplets.recognizer import MapletFit, surface_covariances
from boresight.scenarios.geometry import Camera, Pose, look_at

SIDE = 64
WINDOW = (slice(16, 48), slice(14, 50))


def picture(seed, smooth=1.5):
    """A periodic picture, so that a shift by Fourier's theorem is exact."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=(SIDE, SIDE)), smooth, mode="wrap")
    return 0.5 + 0.12 * values / values.std()


def shifted(image, du, dv):
    return np.fft.ifft2(fourier_shift(np.fft.fft2(image), (dv, du))).real


def correlated(observed, rendered, noise_px2=1.0):
    template = np.ascontiguousarray(rendered[WINDOW], dtype=np.float32)
    corner = (WINDOW[1].start, WINDOW[0].start)
    usable = np.ones_like(template)
    return correlate_window(observed.astype(np.float32), template, usable, corner, (6, 5), noise_px2)


def refined(observed, rendered, on_body=None, dark=0.0):
    on_body = np.ones(observed.shape, dtype=bool) if on_body is None else on_body
    pair = make_pair(observed.astype(np.float32), rendered.astype(np.float32), on_body, 0.7, dark)
    return refine_window(pair, WINDOW, 1.0)


@pytest.mark.parametrize(("du", "dv"), [(3.0, -2.0), (-1.4, 0.6), (0.0, 4.0), (2.5, 2.5)])
def test_correlation_finds_a_shift(du, dv):
    image = picture(1)
    found = correlated(0.3 + 2.0 * shifted(image, du, dv), image)
    np.testing.assert_allclose(found.shift_px, [du, dv], atol=0.05)
    assert found.correlation > 0.98


def test_a_shift_beyond_the_search_is_not_found():
    image = picture(2)
    assert correlated(shifted(image, 6.0, 0.0), image) is None


def test_a_template_without_contrast_is_not_found():
    assert correlated(picture(3), np.full((SIDE, SIDE), 0.7)) is None


def test_masked_pixels_of_the_template_do_not_count():
    image = picture(4)
    spoilt = image.copy()
    spoilt[16:30] = np.random.default_rng(1).normal(size=spoilt[16:30].shape)
    template, usable = (np.ascontiguousarray(a[WINDOW], dtype=np.float32) for a in (spoilt, np.ones((SIDE, SIDE))))
    usable[:14] = 0.0
    found = correlate_window(shifted(image, 1.0, 2.0).astype(np.float32), template, usable, (14, 16), (5, 5), 1.0)
    np.testing.assert_allclose(found.shift_px, [1.0, 2.0], atol=0.05)


@pytest.mark.parametrize(("du", "dv"), [(0.31, -0.22), (-0.05, 0.4), (0.0, 0.0)])
def test_refinement_finds_a_small_shift_under_gain_offset_and_trend(du, dv):
    image = picture(5, 2.5)
    trend = 0.002 * np.arange(SIDE)[None, :] - 0.001 * np.arange(SIDE)[:, None]
    found = refined(0.1 + 1.7 * shifted(image, du, dv) + trend, image)
    np.testing.assert_allclose(found.shift_px, [du, dv], atol=0.03)


def test_refinement_is_not_drawn_by_what_the_rendering_does_not_show():
    """Rocks with their shadows cover a tenth of the picture: a plain correlation follows them."""
    image = picture(6, 2.5)
    rng, observed = np.random.default_rng(2), shifted(image, 0.2, -0.3)
    for row, column in rng.integers(2, SIDE - 4, (40, 2)):
        observed[row, column : column + 2] += 0.4
        observed[row, column + 2 : column + 4] = 0.02
    plain = np.abs(correlated(observed, image).shift_px - [0.2, -0.3]).max()
    robust = np.abs(refined(observed, image, dark=0.1).shift_px - [0.2, -0.3]).max()
    assert robust < 0.04
    assert robust < plain


def test_pixels_off_the_body_do_not_count():
    image, on_body = picture(7, 2.5), np.zeros((SIDE, SIDE), dtype=bool)
    observed = shifted(image, 0.25, 0.1)
    on_body[:, :38] = True
    observed[:, 40:] = 5.0
    np.testing.assert_allclose(refined(observed, image, on_body).shift_px, [0.25, 0.1], atol=0.03)
    assert refined(observed, image, np.zeros_like(on_body)) is None


def test_stripes_fix_one_component_only():
    stripes = 0.5 + 0.2 * np.sin(2.0 * np.pi * np.arange(SIDE) / 8.0)[None, :] * np.ones((SIDE, 1))
    assert refined(stripes, stripes) is None


@pytest.mark.parametrize("method", [correlated, refined], ids=["correlation", "refinement"])
def test_the_covariance_is_that_of_the_scatter(method):
    """White noise is correlated over the kernel of the refinement's smoothing, 4 pi sigma^2 = 6.2 px^2."""
    area = {"correlated": 1.0, "refined": 4.0 * np.pi * 0.7**2}[method.__name__]
    image, rng = picture(8, 2.0), np.random.default_rng(3)
    found = [method(shifted(image, 0.1, 0.2) + rng.normal(0.0, 0.03, image.shape), image) for _ in range(300)]
    scatter = np.cov(np.array([f.shift_px for f in found]).T)
    expected = area * np.mean([f.covariance_px2 for f in found], axis=0)
    np.testing.assert_allclose(np.sqrt(np.diag(scatter) / np.diag(expected)), 1.0, atol=0.25)


def test_the_covariance_does_not_depend_on_the_exposure():
    image = picture(8, 2.0)
    noisy = shifted(image, 0.1, 0.2) + np.random.default_rng(3).normal(0.0, 0.03, image.shape)
    found, brighter = refined(noisy, image), refined(3.0 * noisy, image)
    np.testing.assert_allclose(brighter.shift_px, found.shift_px, atol=1e-4)
    np.testing.assert_allclose(brighter.covariance_px2, found.covariance_px2, rtol=1e-3)


def test_pixels_beside_a_shadow_of_either_image_are_unused():
    lit, spotted = np.full((9, 12), 0.5, dtype=np.float32), np.full((9, 12), 0.5, dtype=np.float32)
    spotted[4, 6] = 0.05
    expected = np.ones((9, 12), dtype=bool)
    expected[3:6, 5:8] = False
    for pair in ((spotted, lit), (lit, spotted)):
        np.testing.assert_array_equal(make_pair(*pair, np.ones((9, 12), dtype=bool), 0.7, 0.12).usable, expected)


@pytest.mark.parametrize("depth_m", [50.0, 2000.0])
def test_the_mask_has_no_holes_between_vertices_of_near_ground(depth_m):
    """At a depth of 50 m and a range of 500 m vertices 5 m apart are 159 px apart, and 16 px by the range."""
    x, y = np.meshgrid(np.arange(-800.0, 801.0, 5.0), np.arange(-800.0, 801.0, 5.0))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 450.0)])
    pose = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, depth_m + 450.0]))
    assert body_mask(vertices, CAMERA, pose, 5.0, 0).all()


def plates(centres_m, turns=None):
    """Flat maplets of 9 x 9 heights 5 m apart, with a bump of 2 m in their middle."""
    axes = np.repeat(np.eye(3)[None], len(centres_m), axis=0) if turns is None else turns.as_matrix()
    heights = np.zeros((len(centres_m), 9, 9))
    heights[:, 4, 4] = 2.0
    return MapletDatabase(np.array(centres_m, dtype=float), axes, heights, 5.0)


def seen_from_above(database, x_m=0.0):
    """What is rendered from 2 km above, the camera at ``x_m``."""
    pose = Pose(np.diag([1.0, -1.0, -1.0]), np.array([-x_m, 0.0, 2000.0]))
    vertices = database.nodes_m.reshape(-1, 3)
    windows = visible_windows(database, CAMERA, pose, vertices, (4, 32))
    whole = np.ones((512, 512), dtype=bool)
    return MapletRendering(database, CAMERA, pose, whole.astype(np.float32), whole, windows)


def test_a_maplet_behind_another_is_hidden_and_windows_end_with_the_image():
    near, far, beside = [0.0, 0.0, 0.0], [0.0, 0.0, -100.0], [200.0, 0.0, -100.0]
    np.testing.assert_array_equal(seen_from_above(plates([far, beside])).windows.maplet, [0, 1])
    np.testing.assert_array_equal(seen_from_above(plates([near, far, beside])).windows.maplet, [0, 2])
    # 317 m to the side the anchor is 4 px from the edge, and the window would begin 12 px outside.
    edge = seen_from_above(plates([near]), 317.0).windows
    assert edge.uv_px[0, 0] == pytest.approx(4.0, abs=2.0)
    assert edge.first[0, 0] == 0
    assert edge.last[0, 0] > 10


def test_an_anchor_is_the_middle_of_the_heights():
    database = plates([[10.0, 20.0, 30.0]], Rotation.random(1, rng=np.random.default_rng(1)))
    np.testing.assert_allclose(database.anchors_m, database.nodes_m[:, 4, 4])


def test_a_wrong_height_moves_an_anchor_along_the_normal():
    """Differences of projections, of maplets that are tilted by some 20 deg."""
    rng = np.random.default_rng(2)
    turns = Rotation.from_rotvec(0.35 * rng.normal(size=(6, 3)))
    seen = seen_from_above(plates(np.c_[80.0 * rng.normal(size=(6, 2)), np.zeros(6)], turns))
    options = MatchingOptions(height_sigma_m=1.5, systematic_px=0.1)

    def exact(index, window):
        return Displacement(np.zeros(2), 0.04 * np.eye(2), 1.0)

    found = _collect(seen, seen.on_body, exact, options)
    assert len(found) == 6
    for row, maplet in enumerate(found.maplet):
        up = seen.database.anchors_m[maplet] + np.outer([1e-3, -1e-3], seen.database.axes[maplet, 2])
        moved = np.subtract(*CAMERA.project(seen.T_cam_body.transform(up))) / 2e-3
        expected = 1.5**2 * np.outer(moved, moved) + (0.1**2 + 0.04) * np.eye(2)
        np.testing.assert_allclose(found.covariances_px2[row], expected, rtol=1e-6, atol=1e-9)


def test_the_search_reaches_three_deviations_of_the_anchors():
    """Of 4000 drawn positions of the camera that is uncertain along x; a pixel more is for the fit of the peak."""
    seen = seen_from_above(plates([[60.0 * k, 40.0, 0.0] for k in range(-2, 3)]))
    sigmas = np.array([1e-9, 1e-9, 1e-9, 10.0, 1e-6, 1e-6])
    steps = sigmas * np.random.default_rng(3).normal(size=(4000, 6))
    points = seen.T_cam_body.transform(seen.anchors_m)
    drawn = CAMERA.project(points + steps[:, None, 3:])
    reach = _reach_px(seen, np.diag(sigmas**2), MatchingOptions(search_sigma=3.0))
    np.testing.assert_allclose(reach, 3.0 * drawn.std(axis=0) + 1.5, atol=1.0)


def test_the_covariance_of_a_place_on_the_body_is_that_of_rays_that_meet_its_plane():
    """Rays through 40,000 drawn pixels, met with planes of drawn heights; the image's covariance is scaled by 2."""
    rng = np.random.default_rng(4)
    turns = Rotation.from_rotvec([[0.4, -0.3, 0.2], [0.0, 0.5, 0.0]])
    seen = seen_from_above(plates([[50.0, -60.0, 0.0], [-90.0, 30.0, 10.0]], turns))
    pixels = np.array([[[0.09, 0.03], [0.03, 0.04]], [[0.04, 0.0], [0.0, 0.16]]])
    matches = MapletMatches(np.arange(2), seen.windows.uv_px, pixels, np.ones(2), np.eye(2), 0.3)
    fit = MapletFit(matches, Posterior(seen.T_cam_body, np.eye(6), np.eye(6), np.zeros(2), 2.0, 0.0))
    position = seen.T_cam_body.camera_position_m
    for row, found in enumerate(surface_covariances(fit, seen.database, CAMERA)):
        anchor, normal = seen.database.anchors_m[row], seen.database.axes[row, 2]
        uv = rng.multivariate_normal(seen.windows.uv_px[row], 2.0 * pixels[row], 40_000)
        rays = CAMERA.unproject(uv) @ seen.T_cam_body.rotation
        along = (anchor - position) @ normal / (rays @ normal)
        points = position + along[:, None] * rays + 0.3 * rng.normal(size=(40_000, 1)) * normal
        np.testing.assert_allclose(found, np.cov(points.T), atol=0.03 * np.trace(found))


def test_shift_covariance_of_a_known_peak():
    found = shift_covariance(0.8, np.diag([-0.1, -0.4]), 50.0)
    np.testing.assert_allclose(found, np.diag([0.36 / (50 * 0.8 * 0.1), 0.36 / (50 * 0.8 * 0.4)]))


CAMERA = Camera.from_fov(512, 512, np.radians(18.3))
TRUE = look_at(np.array([1500.0, 900.0, 970.0]), 0.4)
PRIOR_COVARIANCE = np.diag([0.02] * 3 + [25.0, 25.0, 3.0]) ** 2


def scene(rng, n=40):
    """Points about the body, seen with errors of known covariances, and a prior that is wrong by its covariance."""
    points = rng.normal(size=(n, 3))
    points *= 150.0 / np.linalg.norm(points, axis=1, keepdims=True)
    roots = rng.normal(0.0, 0.2, (n, 2, 2)) + 0.3 * np.eye(2)
    covariances = roots @ np.swapaxes(roots, 1, 2) + 0.01 * np.eye(2)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(n, 2)))
    problem = PoseProblem(points, CAMERA.project(TRUE.transform(points)) + noise, np.linalg.inv(covariances), CAMERA)
    error = np.sqrt(np.diag(PRIOR_COVARIANCE)) * rng.normal(size=6)
    return problem, GaussianPose(TRUE.perturbed(error[:3], error[3:]), PRIOR_COVARIANCE)


def parts_of(problem):
    return problem.points_body_m, problem.uv_px, problem.information_px2


def test_the_offset_of_a_pose_is_its_perturbation():
    step = np.array([0.01, -0.02, 0.03, 4.0, -5.0, 6.0])
    prior = GaussianPose(TRUE, PRIOR_COVARIANCE)
    np.testing.assert_allclose(prior.offset(TRUE.perturbed(step[:3], step[3:])), step, atol=1e-12)


def test_the_solution_maximises_the_posterior():
    problem, prior = scene(np.random.default_rng(4))
    found = solve_map(problem, prior, prior.T_cam_body, np.eye(40))
    turn = cv2.Rodrigues(found.T_cam_body.rotation)[0]
    seen = cv2.projectPoints(problem.points_body_m, turn, found.T_cam_body.translation_m, CAMERA.matrix, None)[0][:, 0]
    off = problem.uv_px - seen
    assert found.quality["residual_px"] == pytest.approx(np.sqrt((off**2).mean()), rel=1e-6)
    squares = sum(row @ w @ row for row, w in zip(off, problem.information_px2, strict=True))
    assert found.quality["chi2_dof"] == pytest.approx(squares / (2 * 40 - 6), rel=1e-6)
    scale = np.sqrt(np.diag(PRIOR_COVARIANCE))
    white = np.linalg.cholesky(np.swapaxes(problem.information_px2, 1, 2) / found.scale2)

    def residuals(step):
        pose = prior.T_cam_body.perturbed(step[:3], step[3:])
        d2 = (np.einsum("nji,nj->ni", white, problem.residuals_px(pose)) ** 2).sum(axis=1)
        # -2 log of Student's t in two dimensions with 4 degrees of freedom.
        return np.concatenate([np.sqrt(6.0 * np.log1p(d2 / 4.0)), step / scale])

    best = least_squares(
        lambda x: residuals(x * scale), np.zeros(6), jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    expected = prior.T_cam_body.perturbed(*np.split(best.x * scale, 2))
    assert found.T_cam_body.angle_to(expected) < 1e-7
    np.testing.assert_allclose(found.T_cam_body.translation_m, expected.translation_m, atol=1e-3)


def test_the_covariance_is_consistent_and_the_bound_below_it():
    squares, ratios = [], []
    for seed in range(80):
        problem, prior = scene(np.random.default_rng(100 + seed))
        found = solve_map(problem, prior, prior.T_cam_body, np.eye(40))
        error = GaussianPose(TRUE, PRIOR_COVARIANCE).offset(found.T_cam_body)
        squares.append(error @ np.linalg.solve(found.covariance, error))
        ratios.append(np.trace(found.covariance[3:, 3:]) / np.trace(found.bound[3:, 3:]))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(squares)) / len(squares)
    assert low < np.mean(squares) < 1.1 * high  # the scale of the noise is estimated, from 40 points
    # Student's t with 4 degrees of freedom costs 9 % of variance under Gaussian noise, less the fit of 6 unknowns.
    assert np.median(ratios) == pytest.approx(1.06, abs=0.06)


def test_wrong_maplets_hardly_count():
    problem, prior = scene(np.random.default_rng(5))
    clean = solve_map(problem, prior, prior.T_cam_body, np.eye(40))
    wrong_px = problem.uv_px.copy()
    wrong_px[:6] += 25.0
    wrong = PoseProblem(problem.points_body_m, wrong_px, problem.information_px2, CAMERA)
    found = solve_map(wrong, prior, prior.T_cam_body, np.eye(40))
    sigma = np.sqrt(np.diag(clean.covariance))
    shift = GaussianPose(clean.T_cam_body, clean.covariance).offset(found.T_cam_body)
    assert np.abs(shift / sigma).max() < 1.5
    assert found.d2[:6].min() > 20.0 * found.d2[6:].max()


def test_windows_share_what_their_pixels_share():
    first = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0], [20.0, 0.0], [0.0, 0.0]])
    last = first + np.array([[10.0, 10.0]] * 4 + [[20.0, 10.0]])
    shared = window_overlap(first, last)
    expected = [1.0, 0.5, 0.25, 0.0, 100.0 / np.sqrt(100.0 * 200.0)]
    np.testing.assert_allclose(shared[0], expected)
    np.testing.assert_allclose(np.diag(shared), 1.0)
    # Of white noise in the pixels, means over the windows correlate just so.
    noise = np.random.default_rng(1).normal(size=(10_000, 30, 20))
    corners = np.concatenate([first, last], axis=1).astype(int)
    means = [noise[:, left:right, top:bottom].mean(axis=(1, 2)) for left, top, right, bottom in corners]
    np.testing.assert_allclose(np.corrcoef(means), shared, atol=0.04)


def test_observations_that_are_one_count_once():
    problem, prior = scene(np.random.default_rng(6))
    vague = GaussianPose(prior.T_cam_body, 1e6 * PRIOR_COVARIANCE)
    doubled = PoseProblem(*(np.repeat(part, 2, axis=0) for part in parts_of(problem)), CAMERA)
    pairs = np.kron(np.eye(40), np.ones((2, 2)))
    once, twice = solve_map(problem, vague, TRUE, np.eye(40)), solve_map(doubled, vague, TRUE, pairs)
    np.testing.assert_allclose(np.diag(twice.covariance), np.diag(once.covariance), rtol=1e-3)
    np.testing.assert_allclose(np.diag(twice.bound), np.diag(once.bound), rtol=1e-3)
    np.testing.assert_allclose(twice.T_cam_body.translation_m, once.T_cam_body.translation_m, atol=1e-3)


def test_the_covariance_is_consistent_where_errors_hold_together():
    """Neighbours on the body, with the errors of windows that overlap."""
    squares = []
    for seed in range(80):
        rng = np.random.default_rng(300 + seed)
        problem, prior = scene(rng)
        exact_px = CAMERA.project(TRUE.transform(problem.points_body_m))
        shared = window_overlap(exact_px - 12.0, exact_px + 12.0)
        white = np.linalg.cholesky(shared + 1e-9 * np.eye(40)) @ rng.normal(size=(40, 2))
        root = np.linalg.cholesky(np.linalg.inv(problem.information_px2))
        held = PoseProblem(
            problem.points_body_m, exact_px + np.einsum("nij,nj->ni", root, white), problem.information_px2, CAMERA
        )
        found = solve_map(held, prior, prior.T_cam_body, shared)
        error = GaussianPose(TRUE, PRIOR_COVARIANCE).offset(found.T_cam_body)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(squares)) / len(squares)
    assert low < np.mean(squares) < 1.2 * high
