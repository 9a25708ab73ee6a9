"""The vision layer: features of a known image, epipolar geometry against OpenCV, registration against SciPy."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
from scipy.ndimage import affine_transform, gaussian_filter
from scipy.spatial import cKDTree

from boresight.estimators.landmark.corners import CornerOptions, detect_corners, determinant, fast_hessian
from boresight.estimators.slam.vision.matching import (
    direction_inliers,
    find_features,
    fitted_direction,
    fundamental_inliers,
    match_descriptors,
)
from boresight.estimators.slam.vision.point_trackers import (
    AffineWarps,
    MatchedImage,
    Spline,
    cut_patches,
    local_flow,
    register_patches,
)
from boresight.estimators.slam.vision.tracker import Tracker
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.vision import ImageVisionSpec

CAMERA = Camera.from_fov(256, 256, np.radians(30.0))
LINEAR = np.array([[1.03, 0.04], [-0.05, 0.96]])
SHIFT = np.array([4.3, -6.7])
EVERYWHERE = np.array([[0.0, 0.0], [256.0, 256.0]])


def texture(rng, size=256):
    """Blobs of many sizes on a lit disk."""
    noise = sum(s * gaussian_filter(rng.standard_normal((size, size)), s) for s in (1.5, 3.0, 6.0))
    rows, columns = np.mgrid[:size, :size] - size / 2 + 0.5
    disk = np.hypot(rows, columns) < 0.47 * size
    return np.where(disk, 1000.0 + 250.0 * noise / noise.std(), 0.0).clip(0.0).astype(np.float32)


def moved(image):
    """Move the point (u, v) about the middle to LINEAR (u, v) + SHIFT: SciPy resamples by the inverse."""
    middle = 0.5 * (np.array(image.shape) - 1.0)
    inverse = np.linalg.inv(LINEAR[::-1, ::-1])
    offset = middle - inverse @ (middle + SHIFT[::-1])
    return affine_transform(image.astype(np.float64), inverse, offset, order=3).astype(np.float32)


def where_moved(uv_px):
    return (uv_px - 128.0) @ LINEAR.T + 128.0 + SHIFT


@pytest.mark.parametrize(
    ("detector", "share", "error_px"), [("surf", 0.3, 0.35), ("sift", 0.25, 0.35), ("orb", 0.25, 0.9)]
)
def test_features_move_with_the_image(detector, share, error_px):
    image = texture(np.random.default_rng(3))
    first, second = find_features(image, detector, 400), find_features(moved(image), detector, 400)
    assert len(first) > 60
    assert np.all(np.diff(first.strength) <= 0.0)
    pairs = match_descriptors(first, second, 0.8)
    error = np.linalg.norm(where_moved(first.uv_px[pairs[:, 0]]) - second.uv_px[pairs[:, 1]], axis=1)
    right = error < 3.0
    assert right.sum() > share * min(len(first), len(second))
    assert right.mean() > 0.8
    assert np.median(error[right]) < error_px
    assert len(set(pairs[:, 1].tolist())) == len(pairs)


def test_no_feature_lies_at_the_edge_of_the_body_and_a_black_image_has_none():
    image = texture(np.random.default_rng(4))
    uv = find_features(image, "surf", 1000).uv_px
    assert np.linalg.norm(uv - 128.0, axis=1).max() < 0.47 * 256 - 5.0
    assert len(find_features(np.zeros_like(image), "surf", 10)) == 0
    assert len(find_features(np.zeros_like(image), "orb", 10)) == 0


def epipolar_world(rng, count=120, wrong=40):
    """Matches of two cameras with the same attitude, the last of them wrong."""
    points = np.column_stack([rng.uniform(-120, 120, (count, 2)), rng.uniform(550, 750, count)])
    motion = np.array([60.0, 8.0, -15.0])
    uv = [CAMERA.project(points - place) + 0.2 * rng.standard_normal((count, 2)) for place in (0.0, motion)]
    uv[1][-wrong:] = rng.uniform(0, 256, (wrong, 2))
    return uv, motion / np.linalg.norm(motion)


def test_matches_that_agree_on_one_motion_are_told_apart_as_by_opencv():
    rng = np.random.default_rng(5)
    (before, after), motion = epipolar_world(rng)
    rays = CAMERA.unproject(before), CAMERA.unproject(after)
    kept = direction_inliers(*rays, 1.0 * CAMERA.pixel_angle_rad, np.random.default_rng(0))
    assert kept[:80].mean() > 0.97
    assert kept[80:].mean() < 0.3  # a wrong match may lie near its epipolar line by chance
    found = fitted_direction(rays[0][kept], rays[1][kept])
    assert np.degrees(np.arccos(abs(found @ motion))) < 2.0
    # OpenCV from the essential matrix of the same matches, without the attitude.
    matrix, mask = cv2.findEssentialMat(before, after, CAMERA.matrix, cv2.RANSAC, 0.999, 1.0)
    _, _, direction, _ = cv2.recoverPose(matrix, before, after, CAMERA.matrix, mask=mask)
    ours, theirs = (np.degrees(np.arccos(abs(float(d.ravel() @ motion)))) for d in (found, direction))
    assert ours <= theirs
    by_matrix = fundamental_inliers(before, after, 1.0)
    assert by_matrix[:80].mean() > 0.8
    assert by_matrix[80:].mean() < 0.3


def test_too_few_matches_agree_on_nothing():
    rng = np.random.default_rng(0)
    rays = np.eye(3)[:2]
    assert not direction_inliers(rays, rays, 1e-3, rng).any()
    assert not fundamental_inliers(np.zeros((5, 2)), np.zeros((5, 2)), 1.0).any()


def test_matches_on_which_opencv_fails_an_assertion_have_inliers_all_the_same():
    """Eight of an image whose MAGSAC ended in an empty model: an error that would end a run."""
    matches = np.array(
        [
            *(
                [97.0, 34.0, 173.0, 74.5],
                [89.5, 82.0, 79.3, 82.1],
                [130.1, 64.5, 121.0, 64.3],
                [41.0, 74.7, 34.0, 74.8],
            ),
            *([100.0, 78.0, 120.0, 55.3], [86.8, 59.3, 77.7, 59.4], [150.8, 81.5, 142.1, 81.4]),
            [118.7, 84.5, 108.6, 84.6],
        ]
    )
    for limit_px in (1.0, 2.0):
        assert fundamental_inliers(matches[:, :2], matches[:, 2:], limit_px).shape == (8,)


def test_the_local_flow_is_the_affine_map_that_was_applied():
    rng = np.random.default_rng(6)
    before = rng.uniform(20, 236, (200, 2))
    after = where_moved(before)
    after[::10] += 30.0
    at = rng.uniform(60, 200, (7, 2))
    place, change = local_flow(before, after, at)
    np.testing.assert_allclose(place, where_moved(at), atol=1e-5)
    np.testing.assert_allclose(change, np.broadcast_to(LINEAR, (7, 2, 2)), atol=1e-5)


def test_a_patch_is_registered_to_hundredths_of_a_pixel_whatever_gain_and_offset():
    image = texture(np.random.default_rng(7))
    rng = np.random.default_rng(8)
    places = rng.uniform(90, 166, (12, 2))
    other = 1.7 * moved(image) + 40.0 + 2.0 * rng.standard_normal(image.shape).astype(np.float32)
    start = AffineWarps(np.tile(np.eye(2), (12, 1, 1)), where_moved(places) + rng.uniform(-1, 1, (12, 2)))
    found, correlation = register_patches(
        Spline(other, EVERYWHERE), cut_patches(Spline(image, EVERYWHERE), places), start
    )
    error = np.linalg.norm(found.place_px - where_moved(places), axis=1)
    assert np.median(error) < 0.02
    assert (correlation > 0.98).all()
    assert np.abs(found.linear - LINEAR).max() < 0.05
    strange, correlation = register_patches(
        Spline(texture(np.random.default_rng(9)), EVERYWHERE), cut_patches(Spline(image, EVERYWHERE), places), start
    )
    assert np.median(correlation) < 0.8
    assert np.isfinite(strange.place_px).all()


@pytest.mark.parametrize(("carry", "error_px"), [("feature", 0.5), ("patch", 0.03)])
def test_tracks_follow_the_image_and_a_lost_one_never_returns(carry, error_px):
    """A plane seen from the side: the shift of the image is that of a camera that moves along it."""
    rng = np.random.default_rng(10)
    wide = texture(rng, 512)[:256, 90:]
    spec = ImageVisionSpec(carry=carry, epipolar="known-attitude", tracks=25, spacing_px=8.0)
    tracker = Tracker(CAMERA, spec, np.random.default_rng(0))
    before, seen = None, []
    for step in range(4):
        image = wide[:, 20 * step : 20 * step + 256]
        features = find_features(image, "surf", 500)
        pairs = np.empty((0, 2), dtype=np.int64) if before is None else match_descriptors(before, features, 0.8)
        seen.append(tracker.advance(MatchedImage(image, features, pairs), np.eye(3)))
        before = features
    assert [len(frame.tracks) for frame in seen] == [25] * 4
    for first, second in itertools.pairwise(seen):
        common, a, b = np.intersect1d(first.tracks, second.tracks, return_indices=True)
        assert len(common) > 10
        shift = second.uv_px[b] - first.uv_px[a]
        assert np.median(np.abs(shift - [-20.0, 0.0])) < error_px
        assert np.all(np.diff(second.tracks) > 0)
        assert cKDTree(second.uv_px).query(second.uv_px, k=2)[0][:, 1].min() > 3.0
    alive = [set(frame.tracks.tolist()) for frame in seen]
    assert not (alive[0] - alive[1]) & (alive[2] | alive[3])


# --- SURF's detector against Gaussian blobs in closed form and second derivatives by scipy ---------------------------


BLOBS = ((80.3, 70.8, 3.0), (170.6, 90.1, 2.4), (110.0, 170.45, 4.0))


def blob_image(sign=1.0, side=256):
    """Gaussian blobs (u, v, sigma), u and v in OpenCV's pixels, on a grey ground."""
    v, u = np.mgrid[:side, :side]
    bumps = sum(np.exp(-0.5 * ((u - x) ** 2 + (v - y) ** 2) / s**2) for x, y, s in BLOBS)
    return (0.5 + 0.4 * sign * bumps).astype(np.float32)


def test_the_mixed_derivative_weighs_nine_tenths():
    """Of u v, a box filter of side 9 has four lobes of 9 pixels two pixels off both axes: 4 x 9 x 2 x 2 = 144."""
    v, u = np.mgrid[-20:21, -20:21].astype(np.float32)
    found = determinant(u * v, 9)
    np.testing.assert_allclose(found[15:26, 15:26], -((0.9 * 144.0) ** 2) / 9.0**4, rtol=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["bright", "dark"])
def test_position_and_scale_of_gaussian_blobs_are_recovered(sign):
    """The nominal scale is a fixed part of the true one.

    The moments of the second derivative of side 9, [1 1 1 -2 -2 -2 1 1 1] over 5 rows, are those of a Gaussian's of
    1.47 px along and 1.41 px across, not of 1.2 px, and wider sides have relatively longer lobes: 0.82 at most.
    """
    blobs = fast_hessian(blob_image(sign))
    ratios = []
    for u, v, sigma in BLOBS:
        gap = np.hypot(blobs.peaks[:, 1] - u, blobs.peaks[:, 0] - v)
        near = np.flatnonzero(gap < 2.0)
        best = near[np.argmax(blobs.strength[near])]
        place = blobs.peaks[best, ::-1] + blobs.offsets_px[best]
        np.testing.assert_allclose(place, (u, v), atol=0.1)
        ratios.append(blobs.scale_px[best] / sigma)
    assert min(ratios) > 0.68
    assert max(ratios) < 0.82


@pytest.mark.parametrize("side", [9, 15, 27])
def test_the_determinant_follows_that_of_gaussian_derivatives(side):
    rng = np.random.default_rng(2)
    image = cv2.GaussianBlur(rng.normal(size=(300, 300)).astype(np.float32), (0, 0), 2.4 * side / 9)
    sigma = 1.2 * side / 9
    xx, yy, xy = (gaussian_filter(image.astype(np.float64), sigma, order=o) for o in ((0, 2), (2, 0), (1, 1)))
    inner = (slice(60, -60), slice(60, -60))
    expected = (sigma**4 * (xx * yy - xy**2))[inner]
    assert np.corrcoef(determinant(image, side)[inner].ravel(), expected.ravel())[0, 1] > 0.95


def test_an_edge_and_a_plain_have_no_blobs():
    edge = np.zeros((128, 128), dtype=np.float32)
    edge[:, 64:] = 1.0
    assert len(fast_hessian(np.full((128, 128), 0.5, dtype=np.float32)).peaks) == 0
    blobs = fast_hessian(edge)
    assert (blobs.strength < 1e-9).all()


def test_blobs_are_corners_of_an_image_where_they_are_asked_for():
    image = np.clip(blob_image() - 0.5, 0.0, None)
    options = CornerOptions(detector="surf", self_similarity_max=1.0, min_relative_strength=0.05)
    found = detect_corners(image, options)
    truth = np.array([(u + 0.5, v + 0.5) for u, v, _ in BLOBS])
    assert (np.diff(found.strength) <= 0.0).all()
    gap = np.linalg.norm(found.uv_px[:, None] - truth, axis=2).min(axis=0)
    assert gap.max() < 0.15
