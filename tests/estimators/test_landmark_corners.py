"""Harris corners against drawn images whose corners are known."""

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from boresight.estimators.landmark.corners import (
    CornerOptions,
    detect_corners,
    harris_response,
    response_peaks,
    self_similarity,
)
from boresight.estimators.landmark.signal import background_level, extract_signal
from boresight.scenarios.errors import BoresightError

ANY = CornerOptions(self_similarity_max=1.0, min_relative_strength=0.01)


def rectangle(top_left=(60, 50), size=(40, 30), side=160):
    """A bright rectangle with one corner cut off, so that no corner repeats another's shape."""
    image = np.zeros((side, side), dtype=np.float32)
    u, v = top_left
    image[v : v + size[1], u : u + size[0]] = 1.0
    return image


def lit_disc(side=160, radius=45.0, spots=(), teeth=0):
    """A disc on black with dark round spots, (u, v, radius) from its centre, and a limb of ``teeth`` bumps."""
    u, v = np.meshgrid(np.arange(side) + 0.5 - side / 2, np.arange(side) + 0.5 - side / 2)
    radius = radius + (1.5 * np.cos(teeth * np.arctan2(v, u)) if teeth else 0.0)
    image = np.clip(radius - np.hypot(u, v) + 0.5, 0.0, 1.0) * (0.7 + 0.004 * u)
    for su, sv, sr in spots:
        image *= 1.0 - 0.9 * np.clip(sr - np.hypot(u - su, v - sv) + 0.5, 0.0, 1.0)
    return image.astype(np.float32)


def textured(side=160, seed=1):
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(size=(side, side)).astype(np.float32), (0, 0), 2.0)
    return (lit_disc(side) * (1.0 + 2.0 * noise)).clip(0.0).astype(np.float32)


def test_the_corners_of_a_rectangle_are_found_in_continuous_pixels():
    corners = detect_corners(rectangle(), ANY)
    # The rectangle fills pixels 60..99 by 50..79: its outline runs through (60, 50) and (100, 80), corner to corner.
    outline = np.array([(60.0, 50.0), (100.0, 50.0), (60.0, 80.0), (100.0, 80.0)])
    assert len(corners) == 4
    distance = np.linalg.norm(corners.uv_px[:, None] - outline[None], axis=2)
    assert sorted(distance.argmin(axis=1)) == [0, 1, 2, 3]
    assert distance.min(axis=1).max() < 1.5
    # Whatever the detector's pull inward is, it is symmetric: the mean has no half-pixel left in it.
    np.testing.assert_allclose(corners.uv_px.mean(axis=0), outline.mean(axis=0), atol=0.02)


def test_response_agrees_with_a_structure_tensor_computed_by_hand():
    image = textured()
    options = CornerOptions()
    gx = cv2.Sobel(image, cv2.CV_64F, 1, 0, ksize=3) / 12.0
    gy = cv2.Sobel(image, cv2.CV_64F, 0, 1, ksize=3) / 12.0
    a, b, c = (cv2.boxFilter(g, -1, (3, 3), normalize=False) for g in (gx * gx, gx * gy, gy * gy))
    expected = a * c - b * b - options.k * (a + c) ** 2
    inner = (slice(5, -5), slice(5, -5))
    np.testing.assert_allclose(harris_response(image, options)[inner], expected[inner], rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize(("gain", "offset"), [(1000.0, 0.0), (1e-4, 0.0), (40.0, 12.0)])
def test_the_unit_of_the_image_does_not_matter(gain, offset):
    image = textured()
    reference = detect_corners(image, CornerOptions())
    scaled = detect_corners((gain * image + offset).astype(np.float32), CornerOptions())
    assert len(reference) > 80
    gap = np.linalg.norm(scaled.uv_px[:, None] - reference.uv_px[None], axis=2)
    # A corner on the very edge of the correlation threshold may go either way in single precision.
    assert (gap.min(axis=0) < 1e-2).mean() > 0.97
    assert (gap.min(axis=1) < 1e-2).mean() > 0.97


def test_black_constant_and_noise_only_images_have_no_corners():
    rng = np.random.default_rng(3)
    for image in (np.zeros((128, 128)), np.full((128, 128), 7.0), rng.normal(10.0, 2.0, (128, 128))):
        corners = detect_corners(image.astype(np.float32), CornerOptions())
        assert len(corners) == 0
        assert corners.uv_px.shape == (0, 2)


def test_the_limb_is_purged_and_spots_are_kept():
    spots = ((-20.0, 5.0, 3.0), (12.0, -14.0, 2.0), (18.0, 16.0, 4.0))
    image = lit_disc(spots=spots, teeth=40)
    all_corners = detect_corners(image, CornerOptions(self_similarity_max=1.0))
    kept = detect_corners(image, CornerOptions())
    radius_all = np.linalg.norm(all_corners.uv_px - 80.0, axis=1)
    radius_kept = np.linalg.norm(kept.uv_px - 80.0, axis=1)
    assert (np.abs(radius_all - 45.0) < 4.0).sum() > 10
    assert (np.abs(radius_kept - 45.0) < 4.0).sum() == 0
    near = np.linalg.norm(kept.uv_px[:, None] - 80.0 - np.array(spots)[None, :, :2], axis=2)
    assert (near.min(axis=0) < np.array(spots)[:, 2] + 2.0).all()


def test_self_similarity_of_a_straight_edge_is_one_and_of_noise_is_low():
    edge = np.zeros((64, 64), dtype=np.float32)
    edge[:, 32:] = 1.0
    assert self_similarity(edge, 32, 32, CornerOptions()) > 0.999
    noise = np.random.default_rng(5).normal(size=(64, 64)).astype(np.float32)
    assert self_similarity(noise, 32, 32, CornerOptions()) < 0.6
    assert self_similarity(np.ones((64, 64), dtype=np.float32), 32, 32, CornerOptions()) == 1.0


def test_strongest_first_and_no_more_than_count():
    image = textured()
    every = detect_corners(image, CornerOptions(count=1000))
    few = detect_corners(image, CornerOptions(count=10))
    assert len(few) == 10
    assert (np.diff(every.strength) <= 0.0).all()
    np.testing.assert_array_equal(few.uv_px, every.uv_px[:10])


def test_peaks_are_separated():
    response = harris_response(textured(), CornerOptions())
    peaks = response_peaks(response, CornerOptions(separation_px=6))
    gaps = np.abs(peaks[:, None] - peaks[None]).max(axis=2)
    np.fill_diagonal(gaps, 99)
    assert len(peaks) > 10
    assert gaps.min() > 6


def test_subpixel_positions_follow_a_shift_of_less_than_a_pixel():
    big = cv2.GaussianBlur(np.kron(textured(128), np.ones((4, 4), dtype=np.float32)), (0, 0), 4.0)
    shifted = np.roll(big, 2, axis=1)  # half a pixel after binning by four
    bins = [image.reshape(128, 4, 128, 4).mean(axis=(1, 3)) for image in (big, shifted)]
    first, second = (detect_corners(image, CornerOptions(count=30)) for image in bins)
    gap = np.linalg.norm(first.uv_px[:, None] + (0.5, 0.0) - second.uv_px[None], axis=2).min(axis=1)
    assert np.median(gap) < 0.2
    rough = [detect_corners(image, CornerOptions(count=30, subpixel=False)) for image in bins]
    assert set(np.unique(rough[0].uv_px % 1.0)) == {0.5}


CHANGES = {
    "count": 5,
    "block_px": 5,
    "aperture_px": 5,
    "k": 0.2,
    "blur_px": 2.0,
    "separation_px": 8,
    "min_relative_strength": 0.5,
    "subpixel": False,
    "patch_px": 5,
    "surroundings_px": 61,
    "self_similarity_max": 0.3,
}


def test_every_option_changes_the_corners():
    assert set(CHANGES) | {"detector"} == set(CornerOptions.model_fields)
    image = textured()
    reference = detect_corners(image, CornerOptions())
    for key, value in CHANGES.items():
        changed = detect_corners(image, CornerOptions(**{key: value}))
        assert changed.uv_px.shape != reference.uv_px.shape or not np.array_equal(changed.uv_px, reference.uv_px), key


@pytest.mark.parametrize("wrong", [{"patch_px": 10}, {"patch_px": 29}, {"detector": "fast"}, {"k": 0.3}, {"size": 3}])
def test_wrong_options_are_refused(wrong):
    with pytest.raises(ValidationError):
        CornerOptions(**wrong)


def test_a_wrong_image_is_refused_and_a_right_one_left_unchanged():
    image = textured()
    image.setflags(write=False)
    detect_corners(image, CornerOptions())
    broken = image.copy()
    broken[3, 4] = np.nan
    with pytest.raises(BoresightError, match="1 pixels that are NaN"):
        detect_corners(broken, CornerOptions())
    with pytest.raises(BoresightError, match=r"\(3, 160, 160\)"):
        detect_corners(np.zeros((3, 160, 160), dtype=np.float32), CornerOptions())


def test_background_is_measured_where_the_body_is_not():
    rng = np.random.default_rng(7)
    image = (500.0 * lit_disc(256, 100.0) + rng.normal(100.0, 5.0, (256, 256))).astype(np.float32)
    image[:60, :60] = 900.0  # a corner that the body fills
    level, noise = background_level(image)
    assert abs(level - 100.0) < 1.0
    assert abs(noise - 5.0) < 0.5
    signal = extract_signal(image)
    assert signal.image[-40:, :40].max() == 0.0
    assert 0.8 < np.percentile(signal.image[signal.image > 0], 99) < 1.2


@pytest.mark.parametrize("level", [10.1, 10.5, 10.8])
def test_noise_below_a_grey_level_is_not_taken_for_a_body(level):
    """Median and median deviation of whole numbers said 10 and 0: half of the sky was lit."""
    sky = np.rint(np.random.default_rng(8).normal(level, 0.45, (256, 256)))
    image = (sky + np.rint(60.0 * lit_disc(256, 6.0))).astype(np.float32)  # fewer than a hundredth of the pixels
    measured, noise = background_level(image)
    assert abs(measured - sky.mean()) < 0.1
    assert sky.std() * 0.9 < noise < 1.5
    assert np.count_nonzero(extract_signal(image).image[lit_disc(256, 6.0) == 0.0]) == 0


def test_ground_in_all_corners_is_not_taken_for_sky():
    """The darkest corner was, where shadows in it are darker than a hundredth of the image."""
    rng = np.random.default_rng(9)
    ground = 800.0 + 400.0 * cv2.GaussianBlur(rng.normal(size=(256, 256)), (0, 0), 4.0) / 0.07
    ground[:10, :10] = 12.0
    image = np.rint(ground.clip(12.0) + rng.normal(0.0, 5.0, ground.shape)).astype(np.float32)
    assert (extract_signal(image).image > 0.0).mean() > 0.95


def test_a_known_sky_is_not_measured_again():
    bright = np.full((64, 64), 0.5, dtype=np.float32)
    assert extract_signal(bright).empty
    assert not extract_signal(bright, (0.0, 0.0)).empty
