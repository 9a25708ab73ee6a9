"""The lit body in an image: its groups of pixels, and those of other bodies."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from test_approach_estimators import CAMERA, observed

from boresight.estimators.approach.body import LitBody, find_body, lit_area_px, of_one_body, sky_slope
from boresight.scenarios.bodies.embedded import icosphere
from boresight.scenarios.geometry import look_at
from boresight.scenarios.observation import Frame


def found_in(image: np.ndarray, diameter_px: float, frame: Frame | None = None) -> LitBody | str:
    """What is found of a ball that is lit from the side in an image; the prior is that of a frame."""
    frame = replace(frame or observed(1)[1].frame, image=image)
    return find_body(frame, CAMERA, diameter_px, np.pi / 8.0 * diameter_px**2, 0.5)


def test_only_the_body_is_found():
    """Shadows divide a body; a star, and a hot pixel, are no part of it. Most pixels of the sky are equal."""
    image = np.full((128, 160), 10.0, np.float32)
    image[np.random.default_rng(9).uniform(size=image.shape) < 0.1] = 11.0
    image[np.random.default_rng(10).uniform(size=image.shape) < 0.1] = 9.0
    image[40:50, 60:70], image[52:60, 60:70] = 200.0, 150.0  # divided by two dark rows
    image[100:102, 20:22] = 900.0
    image[45, 100] = 4000.0
    found = found_in(image, 30.0)
    rows, columns = np.nonzero(found.lit)
    assert len(rows) == 180
    assert (found.patch.row + rows.min(), found.patch.column + columns.max()) == (40, 69)
    assert found.noise == pytest.approx(np.sqrt(0.2), rel=0.25)
    assert not found.cut


@pytest.mark.parametrize(("rows_px", "cut"), [(0, False), (1, False), (2, True)])
def test_a_track_at_the_border_does_not_cut_the_body(rows_px, cut):
    """A cosmic ray of 10 px, 0.35 % of the body's area, is no part of it; 20 px are: a shadow may divide the body."""
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    disc = np.hypot(columns - 80, rows - 35) < 30.0
    image = np.where(disc, 200.0, 10.0).astype(np.float32)
    image[:rows_px, 75:85] = 900.0
    found = found_in(image, 65.0)
    assert found.cut == cut
    assert np.count_nonzero(found.lit) == disc.sum() + (10 * rows_px if cut else 0)


def two_discs(frame: Frame, apart_px: float, radius_px: float = 12.0) -> np.ndarray:
    """A disc of 30 px at the prior's place, lit from the right on its half, and a second one at an angle from it."""
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5
    u, v = CAMERA.project(frame.prior_T_cam_body.translation_m)
    first = (np.hypot(columns - u, rows - v) < 30.0) & (columns > u)
    second = np.hypot(columns - u, rows - v - apart_px) < radius_px
    return np.where(first | second, 200.0, 10.0).astype(np.float32), first, second


def ahead(frame: Frame) -> Frame:
    """A frame whose prior has the body in the middle."""
    return replace(frame, prior_T_cam_body=look_at(np.array([0.0, 0.0, 10_000.0])))


@pytest.mark.parametrize("diameter_px", [60.0, 45.0], ids=["range", "wrong-range"])
@pytest.mark.parametrize("apart_px", [45.0, 50.0])
def test_a_second_body_is_no_part_of_the_body(apart_px, diameter_px):
    """It lies within a diameter of the middle of the lit part, as one in the image of a moon does."""
    frame = ahead(observed(1)[1].frame)
    image, first, _ = two_discs(frame, apart_px)
    found = found_in(image, diameter_px, frame)
    assert found.lit.sum() == first.sum()
    assert found.extent_px == 60.0


def test_parts_of_a_body_that_is_nearer_than_the_prior_says_stay_together():
    """A shadow divides it; the larger part is wider than the prior has the body."""
    frame = ahead(observed(1)[1].frame)
    image, first, _ = two_discs(frame, 500.0)
    columns = np.arange(CAMERA.width_px) + 0.5 - CAMERA.project(frame.prior_T_cam_body.translation_m)[0]
    image[:, (columns > 18.0) & (columns < 21.0)] = 10.0
    found = found_in(image, 45.0, frame)
    assert found.lit.sum() == (first & (image > 100.0)).sum()
    assert found.extent_px == 60.0


@pytest.mark.parametrize(("sigma", "kept"), [(0.0, 1), (0.2, 2)])
def test_lobes_stay_together_as_far_as_the_range_may_be_wrong(sigma, kept):
    """Two lobes of 28 px, 60 px in all, with a shadow between them; the prior has the body as 45 px wide."""
    frame = ahead(observed(1)[1].frame)
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5
    u, v = CAMERA.project(frame.prior_T_cam_body.translation_m)
    lobes = [np.hypot(columns - u - side, rows - v) < radius for side, radius in ((-16.0, 14.0), (16.0, 13.5))]
    image = np.where(lobes[0] | lobes[1], 200.0, 10.0).astype(np.float32)
    covariance = np.diag([1e-6] * 3 + [1.0, 1.0, (sigma * 10_000.0) ** 2])
    found = found_in(image, 45.0, replace(frame, prior_covariance=covariance))
    assert found.lit.sum() == sum(lobe.sum() for lobe in lobes[:kept])


def test_a_larger_body_beside_it_is_passed_over():
    """A moon of 24 px, and the limb and the other half of a disc of 60 px with a shadow between them."""
    frame = ahead(observed(1)[1].frame)
    image, _, second = two_discs(frame, 50.0)
    found = found_in(image, 24.0, frame)
    assert (found.lit.sum(), found.extent_px) == (second.sum(), 24.0)


def test_a_larger_body_close_to_it_is_no_part_of_it():
    """Balls of 20 and 26 px, 25 px apart: less than the body's diameter and the margin."""
    frame = ahead(observed(1)[1].frame)
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5
    u, v = CAMERA.project(frame.prior_T_cam_body.translation_m)
    first, other = (np.hypot(columns - u - side, rows - v) < radius for side, radius in ((0.0, 10.0), (24.9, 13.0)))
    found = found_in(np.where(first | other, 200.0, 10.0).astype(np.float32), 20.0, frame)
    assert found.lit.sum() == first.sum()


@pytest.mark.parametrize(("diameter_px", "reason"), [(24.0, "the body at most"), (300.0, "the body at least")])
def test_another_body_alone_is_not_taken_for_it(diameter_px, reason):
    """A half disc of 60 px; with an error of the range of half of it, it may be the body."""
    frame = ahead(observed(1)[1].frame)
    image = two_discs(frame, 500.0)[0]
    assert reason in found_in(image, diameter_px, frame)
    covariance = np.diag([1e-6] * 3 + [1.0, 1.0, 5_000.0**2])
    assert isinstance(found_in(image, diameter_px, replace(frame, prior_covariance=covariance)), LitBody)


def test_light_around_the_body_does_not_make_it_another_one():
    """Dust or a veil of a tenth of its brightness, on four times its area."""
    frame = ahead(observed(1)[1].frame)
    image, first, _ = two_discs(frame, 500.0)
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px] + 0.5
    u, v = CAMERA.project(frame.prior_T_cam_body.translation_m)
    image[(np.hypot(columns - u, rows - v) < 45.0) & ~first] = 29.0
    assert isinstance(found_in(image, 60.0, frame), LitBody)


@pytest.mark.parametrize("phase_rad", [0.0, 1.0, 2.0])
def test_the_lit_area_of_a_ball_is_that_of_its_phase(phase_rad):
    pose, sun = look_at(np.array([0.0, -1e5, 0.0])), np.array([np.sin(phase_rad), 0.0, -np.cos(phase_rad)])
    expected = 0.5 * np.pi * (100.0 * CAMERA.fx_px / 1e5) ** 2 * (1.0 + np.cos(phase_rad))
    assert lit_area_px(icosphere(5, 100.0).area_vectors_m2, pose, sun, CAMERA) == pytest.approx(expected, rel=0.02)


def test_many_groups_take_no_longer_than_their_pixels():
    """The pixels that are looked at are those of each group's box, not the image for each group."""
    image = np.full((CAMERA.height_px, CAMERA.width_px), 10.0, np.float32)
    for row in range(20, CAMERA.height_px - 20, 4):
        image[row : row + 2, 20:-20] = np.where(np.arange(CAMERA.width_px - 40) % 4 < 2, 200.0, 10.0)
    looked = []

    class Counted(np.ndarray):
        def __eq__(self, other):
            looked.append(self.size)
            return np.asarray(self) == other

    _, labels, stats, _ = cv2.connectedComponentsWithStats((image > 100.0).astype(np.uint8), connectivity=8)
    areas = np.where(np.arange(len(stats)) > 0, stats[:, cv2.CC_STAT_AREA], 0)
    of_one_body(labels.view(Counted), stats[:, :4], areas, 1000.0)
    assert len(looked) == len(stats) - 1 > 300
    assert sum(looked) == areas.sum()


def lit_ground(width_px: float, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """An image of a ball so wide in a sky with noise of 5, and a plane that falls by 200 across it."""
    rows, columns = np.mgrid[: CAMERA.height_px, : CAMERA.width_px].astype(np.float32)
    ball = np.clip(1.0 - ((columns - 80) ** 2 + (rows - 62) ** 2) / (0.5 * width_px) ** 2, 0.0, None) ** 0.5
    noise = np.random.default_rng(seed).normal(0.0, 5.0, rows.shape)
    plane = 150.0 * columns / CAMERA.width_px - 50.0 * rows / CAMERA.height_px
    return (40.0 + 900.0 * ball + noise).astype(np.float32), plane.astype(np.float32)


@pytest.mark.parametrize("width_px", [12.0, 60.0, 110.0])
def test_a_sky_that_falls_across_the_frame_is_made_even(width_px):
    """Its brighter side, a fifth of the body's light, was taken for a body that the frame cuts."""
    image, plane = lit_ground(width_px)
    slope = sky_slope(image + plane, 5.0)
    apart = slope - plane
    assert np.ptp(apart) < 4.0
    even, falling = (found_in(one, width_px) for one in (image, image + plane))
    assert not falling.cut
    assert abs(np.count_nonzero(falling.lit) - np.count_nonzero(even.lit)) < 0.04 * np.count_nonzero(even.lit)
    assert falling.noise == pytest.approx(5.0, rel=0.2)


def test_an_even_sky_is_left_as_it_is():
    for seed in range(20):
        assert sky_slope(lit_ground(60.0, seed)[0], 5.0) is None


def test_ground_without_sky_has_no_slope():
    """The ground grows brighter across the frame; sky in one corner tells nothing of the others."""
    rng = np.random.default_rng(5)
    ground = np.linspace(300.0, 900.0, 160) + rng.normal(0.0, 60.0, (128, 160))
    ground[:25, :30] = rng.normal(40.0, 5.0, (25, 30))
    assert sky_slope(ground.astype(np.float32), 5.0) is None
    assert sky_slope(ground.astype(np.float32), 0.0) is None
