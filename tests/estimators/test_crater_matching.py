"""Matching of craters against OpenCV, closed forms and known scenes."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from crater_looks import CAMERA, counts, ellipsoid, look, pair, population, turned
from scipy.optimize import least_squares, minimize
from scipy.stats import multivariate_normal, norm

from boresight.estimators.craters.contract import CraterDetections, CraterImage
from boresight.estimators.craters.matching.association import (
    Association,
    CraterAssociationOptions,
    ExpectedCraters,
    PairHypotheses,
    _shape_ratios,
    adjust_robustly,
    associate,
    centre_noise,
)
from boresight.estimators.craters.matching.context import (
    ContextOptions,
    epipolar_offsets,
    linear_transforms,
    match_constellations,
)
from boresight.estimators.craters.matching.correlation import CorrelationOptions, pseudo_normalised, rectify_template
from boresight.estimators.craters.matching.invariants import conic_invariants, unambiguous_pairs, vote_matrix
from boresight.estimators.craters.matching.preliminary import preliminary_pairs
from boresight.estimators.craters.matching.transfer import (
    LocatedCraters,
    joint_covariance,
    locate_craters,
    map_ellipses,
    occluded,
    plane_homographies,
    transfer_craters,
)
from boresight.estimators.registry import crater_matcher_class, crater_matcher_names
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Ellipses, Pose, look_at
from boresight.scenarios.geometry.camera import pixel_to_opencv
from boresight.scenarios.spec.craters import DetectionErrorSpec

EXACT = DetectionErrorSpec(
    centre_px=0.0,
    centre_radii=0.0,
    axes_ratio=1e-9,
    recall=0.999999,
    false_share=0.0,
    least_radius_px=4.0,
    height_m=0.0,
)


@pytest.fixture(scope="module")
def ground():
    return ellipsoid()


@pytest.fixture(scope="module")
def craters(ground):
    return population(ground, 3)


def _ellipses(rng: np.random.Generator, count: int) -> Ellipses:
    axes = np.sort(rng.uniform(6.0, 30.0, (count, 2)), axis=1)[:, ::-1]
    return Ellipses(rng.uniform(40.0, 360.0, (count, 2)), axes, rng.uniform(0.0, np.pi, count))


def _homography(rng: np.random.Generator) -> FloatArray:
    matrix = np.eye(3) + rng.uniform(-0.2, 0.2, (3, 3)) * [[1, 1, 50], [1, 1, 50], [1e-3, 1e-3, 0]]
    return np.asarray(matrix)


def test_plane_homography_is_that_which_opencv_finds_from_points_of_the_plane() -> None:
    rng = np.random.default_rng(1)
    one, other = (look_at(turned(np.array([0.6, 0.0, 0.8]), angle, 1.0) * 2e5) for angle in (0.0, 20.0))
    point, normal = np.array([3e3, 500.0, 7e3]), np.array([0.5, 0.1, 0.86])
    normal /= np.linalg.norm(normal)
    plane = LocatedCraters(point[None], normal[None], one)
    across = np.linalg.svd(normal[None])[2][1:]
    points = point + rng.uniform(-2e3, 2e3, (20, 2)) @ across
    here, there = (CAMERA.project(pose.transform(points)) for pose in (one, other))
    found, _ = cv2.findHomography(here, there)
    ours = plane_homographies(plane, CAMERA, CAMERA, other)[0]
    np.testing.assert_allclose(ours / ours[2, 2], found / found[2, 2], rtol=1e-5, atol=1e-7)


def test_mapped_rims_are_those_of_mapped_points() -> None:
    rng = np.random.default_rng(2)
    rims, maps = _ellipses(rng, 5), np.stack([_homography(rng) for _ in range(5)])
    found, real = map_ellipses(rims, maps)
    assert real.all()
    points = np.concatenate([rims.points(40)[0], np.ones((5, 40, 1))], axis=2) @ np.swapaxes(maps, 1, 2)
    for k in range(5):
        fitted = cv2.fitEllipseDirect((points[k, :, :2] / points[k, :, 2:]).astype(np.float32))
        np.testing.assert_allclose(found.centre_px[k], fitted[0], atol=2e-2)
        np.testing.assert_allclose(found.semi_axes_px[k], np.sort(fitted[1])[::-1] / 2.0, rtol=2e-3)


def test_located_craters_move_with_the_pose_as_differences_say(ground, craters) -> None:
    image = pair(ground, craters, 4, 5.0, 5.0)[0].image
    located = locate_craters(image, ground)
    rows = np.flatnonzero(located.on_body)[:3]
    sights = CAMERA.unproject(image.detections.ellipses.centre_px[rows])
    pose, analytic = located.T_cam_body, located.by_pose()[rows]

    def met(error: FloatArray) -> FloatArray:
        other = pose.perturbed(error[:3], error[3:])
        rays, origin = other.inverse().rotate(sights), other.camera_position_m
        normals, points = located.normals_body[rows], located.points_body_m[rows]
        along = np.einsum("ni,ni->n", normals, points - origin) / np.einsum("ni,ni->n", normals, rays)
        return np.asarray(origin + along[:, None] * rays)

    for k, step in enumerate([1e-6] * 3 + [1.0] * 3):
        error = np.zeros(6)
        error[k] = step
        difference = (met(error) - met(-error)) / (2.0 * step)
        np.testing.assert_allclose(analytic[:, :, k], difference, rtol=1e-4, atol=1e-4 * np.abs(difference).max())


def test_predicted_places_move_with_both_poses_as_differences_say(ground, craters) -> None:
    first, second = (one.image for one in pair(ground, craters, 4, 10.0, 5.0))
    expected = transfer_craters(first, second, locate_craters(first, ground), ground)
    planes = locate_craters(first, ground)
    planes = LocatedCraters(planes.points_body_m[expected.rows], planes.normals_body[expected.rows], planes.T_cam_body)
    for k in (0, 4, 6, 8, 10):
        step = 1e-6 if k % 6 < 3 else 1.0
        places = []
        for sign in (1.0, -1.0):
            error = np.zeros(12)
            error[k] = sign * step
            one = planes.T_cam_body.perturbed(error[:3], error[3:6])
            other = second.frame.prior_T_cam_body.perturbed(error[6:9], error[9:])
            moved = LocatedCraters(planes.points_body_m, planes.normals_body, one)
            maps = plane_homographies(moved, CAMERA, CAMERA, other)
            centres = np.column_stack([first.detections.ellipses.centre_px[expected.rows], np.ones(len(maps))])
            seen = np.einsum("nij,nj->ni", maps, centres)
            places.append(seen[:, :2] / seen[:, 2:])
        difference = (places[0] - places[1]) / (2.0 * step)
        scale = np.abs(difference).max()
        np.testing.assert_allclose(expected.by_error[:, :, k], difference, rtol=1e-3, atol=1e-3 * scale)


def test_pseudo_normalised_correlation_is_that_of_numpys_covariances() -> None:
    rng = np.random.default_rng(3)
    template, windows = rng.normal(size=(7, 9)), rng.normal(2.0, 3.0, size=(4, 7, 9))
    for window, ours in zip(windows, pseudo_normalised(template, windows), strict=True):
        both = np.cov(template.ravel(), window.ravel())
        assert ours == pytest.approx(2.0 * both[0, 1] / (both[0, 0] + both[1, 1]), rel=1e-12)
    assert pseudo_normalised(template, template + 5.0) == pytest.approx(1.0)
    assert pseudo_normalised(template, 3.0 * template) == pytest.approx(0.6)  # a gain counts against it


def test_a_rectified_template_samples_the_first_image_where_the_homography_says() -> None:
    rng = np.random.default_rng(5)
    v, u = np.mgrid[0:412, 0:537] + 0.5
    image = (0.3 * u + 0.2 * v).astype(np.float32)  # bilinear interpolation is exact on it
    homography = _homography(rng)
    rim = Ellipses(np.array([[230.3, 190.8]]), np.array([[8.0, 6.0]]), np.zeros(1))
    template = rectify_template(image, homography, rim, CorrelationOptions())
    half = len(template) // 2
    rows, columns = np.mgrid[-half : half + 1, -half : half + 1]
    places = np.stack([230.3 + columns, 190.8 + rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(homography).T
    places = places[..., :2] / places[..., 2:]
    np.testing.assert_allclose(template, 0.3 * places[..., 0] + 0.2 * places[..., 1], atol=0.05)
    np.testing.assert_allclose(
        template[half, half], 0.3 * places[half, half, 0] + 0.2 * places[half, half, 1], atol=2e-2
    )


def test_conic_invariants_of_circles_have_their_closed_form() -> None:
    r1, r2, d = 10.0, 4.0, 33.0
    circles = Ellipses(np.array([[100.0, 50.0], [100.0 + d, 50.0]]), np.array([[r1, r1], [r2, r2]]), np.zeros(2))
    invariants = conic_invariants(circles.conics())
    assert invariants[0, 1] == pytest.approx((r1 / r2) ** (2 / 3) * (2.0 + (r2**2 - d**2) / r1**2))
    assert invariants[1, 0] == pytest.approx((r2 / r1) ** (2 / 3) * (2.0 + (r1**2 - d**2) / r2**2))
    np.testing.assert_allclose(np.diag(invariants), 3.0)


def test_conic_invariants_stand_under_random_homographies() -> None:
    rng = np.random.default_rng(6)
    rims = _ellipses(rng, 6)
    before = conic_invariants(rims.conics())
    for _ in range(20):
        after, real = map_ellipses(rims, np.broadcast_to(_homography(rng), (6, 3, 3)))
        assert real.all()
        np.testing.assert_allclose(conic_invariants(after.conics()), before, rtol=1e-6, atol=1e-6)


def test_invariants_match_a_plane_of_exact_rims_and_leave_ambiguous_ones_out() -> None:
    rng = np.random.default_rng(7)
    rims, order = _ellipses(rng, 9), rng.permutation(9)
    seen, _ = map_ellipses(rims[order], np.broadcast_to(_homography(rng), (9, 3, 3)))
    pairs = unambiguous_pairs(vote_matrix(rims, seen, 1e-3), 4)
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])
    assert len(pairs) == 9
    # Each agreement counts twice: more than 4 votes are more than 8.
    np.testing.assert_array_equal(unambiguous_pairs(np.array([[8, 0], [0, 9]]), 4), [[1, 1]])
    votes = np.array([[20, 0, 0], [0, 20, 20], [0, 0, 20]])
    np.testing.assert_array_equal(unambiguous_pairs(votes, 4), [[0, 0]])
    # With a margin the couple stays that outvotes its rivals, be they over the threshold or not.
    votes = np.array([[30, 12, 0], [14, 25, 0], [0, 19, 18]])
    np.testing.assert_array_equal(unambiguous_pairs(votes, 4), np.zeros((0, 2)))
    np.testing.assert_array_equal(unambiguous_pairs(votes, 4, 1.3), [[0, 0], [1, 1]])
    np.testing.assert_array_equal(unambiguous_pairs(votes, 4, 1.5), [[0, 0]])


def test_the_linear_transform_of_three_points_is_opencvs() -> None:
    rng = np.random.default_rng(8)
    here, there = rng.uniform(0.0, 400.0, (3, 2)), rng.uniform(0.0, 400.0, (2, 3, 2))
    for ours, points in zip(linear_transforms(here, there), there, strict=True):
        found = cv2.getAffineTransform(here.astype(np.float32), points.astype(np.float32))
        np.testing.assert_allclose(ours[:2], found, rtol=1e-3, atol=1e-2)
        np.testing.assert_allclose(ours[2], [0.0, 0.0, 1.0], atol=1e-9)


def test_context_finds_a_constellation_among_others_and_none_where_there_is_none() -> None:
    rng = np.random.default_rng(9)
    rims = _ellipses(rng, 12)
    transform = np.array([[0.9, -0.3, 60.0], [0.2, 1.1, -20.0], [0.0, 0.0, 1.0]])
    seen, _ = map_ellipses(rims, np.broadcast_to(transform, (12, 3, 3)))
    strangers = _ellipses(rng, 8)
    both = Ellipses(
        np.concatenate([seen.centre_px, strangers.centre_px]),
        np.concatenate([seen.semi_axes_px, strangers.semi_axes_px]),
        np.concatenate([seen.angle_rad, strangers.angle_rad]),
    )
    candidates = rng.uniform(size=(12, 20)) < 0.2
    candidates[np.arange(12), np.arange(12)] = True
    pairs, votes = match_constellations(rims, both, candidates, ContextOptions(), (0, 1))
    np.testing.assert_array_equal(pairs[np.argsort(pairs[:, 0])], np.column_stack([np.arange(12)] * 2))
    assert (votes == 12).all()
    nothing, _ = match_constellations(rims, _ellipses(rng, 8), candidates[:, 12:], ContextOptions(), (0, 1))
    assert len(nothing) == 0


def test_context_never_takes_a_mirror_image() -> None:
    """The far side of a surface is never seen, however well its craters agree."""
    rims, candidates = _ellipses(np.random.default_rng(4), 12), np.ones((12, 12), dtype=np.bool_)
    for turned_by, found in (([1.0, 1.0, 1.0], 12), ([-1.0, 1.0, 1.0], 0)):
        seen, _ = map_ellipses(rims, np.tile(np.diag(turned_by), (12, 1, 1)))
        assert len(match_constellations(rims, seen, candidates, ContextOptions(), (0, 1))[0]) == found


def test_epipolar_offsets_are_distances_to_opencvs_lines(ground, craters) -> None:
    first, second = (one.image for one in pair(ground, craters, 10, 15.0, 5.0))
    one, other = first.frame.prior_T_cam_body, second.frame.prior_T_cam_body
    rotation = other.rotation @ one.rotation.T
    t = other.translation_m - rotation @ one.translation_m
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    matrix = CAMERA.matrix
    matrix[:2, 2] = pixel_to_opencv(matrix[:2, 2])
    fundamental = np.linalg.inv(matrix).T @ cross @ rotation @ np.linalg.inv(matrix)
    here, there = (pixel_to_opencv(image.detections.ellipses.centre_px) for image in (first, second))
    lines = cv2.computeCorrespondEpilines(here.reshape(-1, 1, 2), 1, fundamental)[:, 0]
    expected = np.abs(lines[:, :2] @ there.T + lines[:, 2:])
    np.testing.assert_allclose(epipolar_offsets(first, second), expected, rtol=1e-4, atol=1e-2)


def test_the_common_error_is_that_of_a_least_squares_solver() -> None:
    rng = np.random.default_rng(11)
    rims, H = _ellipses(rng, 8), rng.normal(size=(8, 2, 3))
    P, noise = np.diag([4.0, 1.0, 9.0]), centre_noise(rims, CraterAssociationOptions())
    error = rng.normal(size=3) * [2.0, 1.0, 3.0]
    seen = Ellipses(rims.centre_px + H @ error + rng.normal(0.0, 0.3, (8, 2)), rims.semi_axes_px, rims.angle_rad)
    found = associate(ExpectedCraters(rims, H, P, noise, np.zeros(3)), seen, 1e5, CraterAssociationOptions())
    np.testing.assert_array_equal(found.pairs, np.column_stack([np.arange(8)] * 2))

    def residuals(x: FloatArray) -> FloatArray:
        left = seen.centre_px - rims.centre_px - H @ x
        return np.concatenate([(left / np.sqrt(noise[:, :1, 0])).ravel(), x / np.sqrt(np.diag(P))])

    solved = least_squares(residuals, np.zeros(3))
    np.testing.assert_allclose(found.error, solved.x, rtol=1e-6)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(solved.jac.T @ solved.jac), rtol=1e-6)


def _lone(options: CraterAssociationOptions, rims: Ellipses, prior: FloatArray) -> ExpectedCraters:
    """Expected rims that move together by an error of the prior, px."""
    return ExpectedCraters(rims, np.tile(np.eye(2), (len(rims), 1, 1)), prior, centre_noise(rims, options), np.zeros(2))


def _moved(rims: Ellipses, shift_px: FloatArray) -> Ellipses:
    return Ellipses(rims.centre_px + shift_px, rims.semi_axes_px, rims.angle_rad)


def test_likelihoods_of_pairs_are_those_of_scipy() -> None:
    """The densities of offset and shape over those of clutter, and the odds of a detection."""
    rng, options = np.random.default_rng(8), CraterAssociationOptions(redetected=0.3)
    first, second = _ellipses(rng, 3), _ellipses(rng, 4)
    shapes = [
        np.column_stack([np.log(e.semi_axes_px).mean(axis=1), np.diff(np.log(e.semi_axes_px))]) for e in (first, second)
    ]
    own = norm.logpdf(shapes[0][:, None], shapes[1], [options.size_sigma, options.axes_sigma]).sum(axis=2)
    clutter = np.log(norm.pdf(shapes[1][:, None], shapes[1], 0.3).prod(axis=2).mean(axis=1))
    found = _shape_ratios(first, second, options)
    np.testing.assert_allclose(found, own - clutter, rtol=1e-9)
    residuals, root = rng.normal(size=(3, 4, 2)), rng.normal(size=(3, 2, 2))
    spread = root @ np.swapaxes(root, 1, 2) + np.eye(2)
    place = [multivariate_normal(np.zeros(2), spread[i]).logpdf(residuals[i]) for i in range(3)]
    nowhere = ExpectedCraters(first, np.zeros((3, 2, 0)), np.zeros((0, 0)), np.zeros((3, 2, 2)), np.zeros(0))
    ratios = PairHypotheses(nowhere, residuals, found, 1e-4, options).log_ratios(residuals, spread)
    np.testing.assert_allclose(ratios, np.array(place) - np.log(1e-4) + found + np.log(0.3 / 0.7), rtol=1e-9)


def test_of_two_equal_constellations_the_one_nearer_to_the_prior_is_taken() -> None:
    rims, options = _ellipses(np.random.default_rng(3), 4), CraterAssociationOptions()
    near, far = np.array([10.0, -5.0]), np.array([-30.0, 25.0])
    both = [_moved(rims, shift) for shift in (far, near)]
    seen = Ellipses(
        *(np.concatenate([getattr(e, name) for e in both]) for name in ("centre_px", "semi_axes_px", "angle_rad"))
    )
    found = associate(_lone(options, rims, 100.0 * np.eye(2)), seen, 2e5, options)
    np.testing.assert_array_equal(found.pairs, np.column_stack([np.arange(4), np.arange(4, 8)]))
    np.testing.assert_allclose(found.error, near, atol=0.5)


def test_detection_that_two_expected_craters_claim_is_of_neither() -> None:
    rim, options = (
        Ellipses(np.array([[200.0, 200.0]]), np.array([[12.0, 9.0]]), np.array([0.3])),
        CraterAssociationOptions(),
    )
    two = Ellipses(
        np.array([[200.0, 200.0], [200.5, 200.0]]), np.tile(rim.semi_axes_px, (2, 1)), np.tile(rim.angle_rad, 2)
    )
    seen = _moved(rim, np.array([0.25, 0.0]))
    assert len(associate(_lone(options, rim, np.eye(2)), seen, 2e5, options).pairs) == 1
    assert len(associate(_lone(options, two, np.eye(2)), seen, 2e5, options).pairs) == 0


def test_pair_less_likely_than_clutter_is_none() -> None:
    """Given the first pair, the offset of the second is too large by some sigmas."""
    options = CraterAssociationOptions()
    rims = Ellipses(np.array([[100.0, 200.0], [300.0, 200.0]]), np.array([[12.0, 9.0], [24.0, 22.0]]), np.zeros(2))
    seen = Ellipses(rims.centre_px + np.array([[5.0, 5.0], [5.0, 14.2]]), rims.semi_axes_px, rims.angle_rad)
    found = associate(_lone(options, rims, 1e4 * np.eye(2)), seen, 2e5, options)
    assert found.reason == "of 1 possible matches none is sure"


def test_robust_error_is_the_minimum_of_hubers_loss() -> None:
    """With the prior; scipy minimises the loss of the lengths in sigmas, one pair is an outlier."""
    rng, options = np.random.default_rng(5), CraterAssociationOptions()
    rims, prior = _ellipses(rng, 6), np.diag([9.0, 4.0])
    offsets = np.array([2.0, -1.0]) + rng.normal(0.0, 0.7, (6, 2))
    offsets[2] += 6.0
    field, pairs = _lone(options, rims, prior), np.column_stack([np.arange(6)] * 2)
    start = Association(pairs, np.ones(6), np.zeros(2), prior)
    found = adjust_robustly(field, _moved(rims, offsets), start)

    def cost(error: FloatArray) -> float:
        lengths = np.linalg.norm(offsets - error, axis=1) / np.sqrt(field.noise_px2[:, 0, 0])
        loss = np.where(lengths < 2.0, 0.5 * lengths**2, 2.0 * lengths - 2.0)
        return float(loss.sum() + 0.5 * error @ np.linalg.solve(prior, error))

    np.testing.assert_allclose(found.error, minimize(cost, np.zeros(2), tol=1e-12).x, atol=1e-3)


def test_a_lone_couple_counts_only_as_far_as_the_prior_foretells_it() -> None:
    rim = Ellipses(np.array([[200.0, 200.0]]), np.array([[12.0, 9.0]]), np.array([0.3]))
    near = Ellipses(rim.centre_px + 1.0, rim.semi_axes_px, rim.angle_rad)
    options, noise = CraterAssociationOptions(), centre_noise(rim, CraterAssociationOptions())
    H = np.eye(2)[None]
    known = associate(ExpectedCraters(rim, H, np.eye(2), noise, np.zeros(2)), near, 2e5, options)
    assert len(known.pairs) == 1
    unknown = associate(ExpectedCraters(rim, H, 1e6 * np.eye(2), noise, np.zeros(2)), near, 2e5, options)
    assert len(unknown.pairs) == 0
    assert "none is sure" in unknown.reason


def test_what_is_hidden_is_what_the_far_side_of_an_ellipsoid_hides(ground) -> None:
    rng = np.random.default_rng(12)
    points, normals = ground.sample(200, rng)
    camera = np.array([0.0, 0.0, 2e5])
    away = np.einsum("ni,ni->n", normals, camera - points) < 0.0
    np.testing.assert_array_equal(occluded(points, camera, ground, np.full(200, 1.0)), away)


@pytest.mark.parametrize(("name", "view_deg", "sun_deg", "recall", "wrong"), [
    ("vote", 5.0, 5.0, 0.93, 0.01),
    ("vote", 20.0, 30.0, 0.9, 0.01),
    ("vote", 15.0, 60.0, 0.9, 0.01),
    ("hybrid", 15.0, 5.0, 0.7, 0.02),
    ("context", 5.0, 5.0, 0.2, 0.1),
])  # fmt: skip
def test_matchers_on_scenes_with_detection_errors(ground, craters, name, view_deg, sun_deg, recall, wrong) -> None:
    matcher = crater_matcher_class(name).from_options({})
    total = np.zeros(3)
    for seed in range(6):
        first, second = pair(ground, craters, seed, view_deg, sun_deg)
        total += counts(matcher.match(first.image, second.image, ground), first, second)
    assert total[0] > 40
    assert total[1] >= recall * total[0]
    assert total[2] <= max(1.0, wrong * (total[1] + total[2]))


def test_the_vote_takes_a_prior_a_kilometre_off(ground, craters) -> None:
    matcher = crater_matcher_class("vote").from_options({})
    total = np.zeros(3)
    for seed in range(6):
        first, second = pair(ground, craters, seed, 10.0, 20.0, position_sigma_m=1000.0)
        total += counts(matcher.match(first.image, second.image, ground), first, second)
    assert total[1] >= 0.85 * total[0]
    assert total[2] <= 1


def test_each_pass_of_the_vote_uses_the_prior_once(ground, craters) -> None:
    """About the estimate of the first pass the second finds nearly the same, and the same covariance."""
    first, second = pair(ground, craters, 2, 10.0, 20.0)
    matcher = crater_matcher_class("vote").from_options({})
    _, once = matcher._associated(first.image, second.image, ground, np.zeros(12))
    _, again = matcher._associated(first.image, second.image, ground, once.error)
    sigmas = np.sqrt(np.diag(once.covariance))
    assert (np.abs(once.error) > 0.3 * np.sqrt(np.diag(joint_covariance(first.image, second.image)))).any()
    assert np.abs((again.error - once.error) / sigmas).max() < 0.5


def test_unknown_heights_make_the_vote_less_certain(ground, craters) -> None:
    first, second = pair(ground, craters, 2, 10.0, 20.0)
    sure, unsure = (
        crater_matcher_class("vote")
        .from_options({"height_sigma_m": sigma})
        ._associated(first.image, second.image, ground, np.zeros(12))[1]
        for sigma in (0.0, 100.0)
    )
    assert np.trace(unsure.covariance[3:, 3:]) > 1.05 * np.trace(sure.covariance[3:, 3:])


def test_correlation_confirms_craters_where_the_pixels_agree(ground, craters) -> None:
    first, second = pair(ground, craters, 13, 0.0, 0.0, EXACT, position_sigma_m=20.0)
    first, second = (replace(one, image=_painted(one.image)) for one in (first, second))
    matcher = crater_matcher_class("correlation").from_options({})
    common, right, wrong = counts(matcher.match(first.image, second.image, ground), first, second)
    assert common >= 5
    assert right >= 0.6 * common
    assert wrong == 0
    sun = turned(second.image.frame.sun_dir_cam, 30.0, 0.0)
    elsewhere = replace(second.image, frame=replace(second.image.frame, sun_dir_cam=sun))
    assert "to correlate" in matcher.match(first.image, elsewhere, ground).reason


def _painted(image: CraterImage) -> CraterImage:
    """Paint each rim as a bowl with a brightness gradient along the direction of the Sun on the ground."""
    v, u = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px] + 0.5
    sun = image.frame.sun_dir_cam[:2] / np.linalg.norm(image.frame.sun_dir_cam[:2])
    pixels = np.full(u.shape, 100.0)
    homogeneous = np.stack([u, v, np.ones_like(u)], axis=-1)
    for conic, centre, radius in zip(
        image.detections.ellipses.conics(),
        image.detections.ellipses.centre_px,
        image.detections.ellipses.radius_px,
        strict=True,
    ):
        inside = np.clip(-np.einsum("hwi,ij,hwj->hw", homogeneous, conic, homogeneous), 0.0, 1.0)
        pixels -= 60.0 * inside * ((u - centre[0]) * sun[0] + (v - centre[1]) * sun[1]) / radius
    return replace(image, frame=replace(image.frame, image=pixels.astype(np.float32)))


def _without(image: CraterImage, keep: int) -> CraterImage:
    kept = CraterDetections(image.detections.ellipses[:keep], image.detections.confidence[:keep])
    return replace(image, detections=kept)


@pytest.mark.parametrize("name", ["context", "correlation", "hybrid", "invariants", "vote"])
def test_images_without_craters_and_without_overlap_match_nothing_and_say_why(ground, craters, name) -> None:
    matcher = crater_matcher_class(name).from_options({})
    first, second = (one.image for one in pair(ground, craters, 14, 10.0, 5.0))
    for one, other in ((_without(first, 0), second), (first, _without(second, 0))):
        matches = matcher.match(one, other, ground)
        assert matches.pairs.shape == (0, 2)
        assert "has no crater" in matches.reason
    lone = matcher.match(_without(first, 1), _without(second, 1), ground)
    assert len(lone.pairs) <= 1
    sun = np.array([0.0, 0.6, 0.8])
    rng = np.random.default_rng(0)
    north = look(2, ground, craters, np.array([0.0, 0.0, 6e3]), (np.array([0.0, 0.0, 1.0]), sun), rng).image
    south = look(3, ground, craters, np.array([0.0, 0.0, -6e3]), (np.array([0.0, 0.0, -1.0]), sun), rng).image
    lit = look(4, ground, craters, np.array([0.0, 0.0, -6e3]), (np.array([0.0, 0.0, -1.0]), -sun), rng).image
    assert len(south.detections.ellipses) == 0
    matches = matcher.match(north, lit, ground)
    assert len(matches.pairs) == 0
    assert matches.reason


def test_preliminary_matching_pairs_images_of_one_place_alone(ground, craters) -> None:
    first, second = (one.image for one in pair(ground, craters, 15, 10.0, 5.0))
    towards = -first.frame.prior_T_cam_body.rotation[2]
    rng = np.random.default_rng(1)
    far = look(2, ground, craters, -6e3 * towards, (-towards, turned(-towards, 40.0, 0.0)), rng).image
    images = [first, far, _without(first, 0), second]
    found = preliminary_pairs(images, ground)
    np.testing.assert_array_equal(found.pairs, [[0, 3]])
    assert found.landmarks[0] >= 3
    assert 0.3 < found.overlap[0] <= 1.0
    assert len(preliminary_pairs([], ground).pairs) == 0
    assert len(preliminary_pairs([_without(first, 0)], ground).pairs) == 0


def test_every_matcher_keeps_the_contract() -> None:
    assert crater_matcher_names() == ("context", "correlation", "hybrid", "invariants", "vote")
    for name in crater_matcher_names():
        found = crater_matcher_class(name)
        assert (found.name, found.version >= 1) == (name, True)
        with pytest.raises(BoresightError, match="colour"):
            found.from_options({"colour": 1})


def test_a_pose_that_is_set_right_by_its_error_predicts_the_true_places(ground, craters) -> None:
    first, second = pair(ground, craters, 16, 10.0, 10.0, EXACT, position_sigma_m=0.001)
    expected = transfer_craters(first.image, second.image, locate_craters(first.image, ground), ground)
    crater = first.crater[expected.rows]
    common, here, there = np.intersect1d(crater, second.crater, return_indices=True)
    assert len(common) >= 5
    seen = second.image.detections.ellipses
    offsets = expected.ellipses.centre_px[here] - seen.centre_px[there]
    # The plane under a rim is not the facet of its centre: within a tenth of the radius.
    assert (np.linalg.norm(offsets, axis=1) < 0.1 * seen.radius_px[there] + 0.2).all()
    assert isinstance(first.image.frame.prior_T_cam_body, Pose)
