"""Positions of stars in images with noise against the Cramer-Rao bound, and what is no star."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from boresight.estimators.stars.detection import detect_stars, sky_level
from boresight.estimators.stars.identification import Sky, identify
from boresight.renderers.detector import Detector
from boresight.renderers.stars import point_sources, star_pixels
from boresight.scenarios.geometry import Camera
from boresight.scenarios.spec.camera import DetectorSpec
from boresight.scenarios.stars import artificial_sky

FALSE_ALARM, GAIN = 1e-4, 5.0
CAMERA = Camera.from_fov(512, 512, np.radians(12.0))


def spec(psf=0.6):
    return DetectorSpec(psf_sigma_px=psf, exposure_s=1.0, gain_e_per_dn=GAIN, bits=16, full_well_e=2e5)


def expose(rng, uv, electrons, psf=0.6, scene=None):
    image = np.zeros((512, 512), np.float32) if scene is None else scene
    return Detector(spec(psf)).expose(image, rng, point_sources(CAMERA, uv, electrons, psf))


def spread_out(rng, count):
    """Draw places in cells of their own, 30 pixels apart at least."""
    cells = rng.permutation(14 * 14)[:count]
    return np.stack([cells % 14, cells // 14], axis=-1) * 34.0 + 30.0 + rng.uniform(-2.0, 2.0, (count, 2))


def paired(uv, found):
    away = np.linalg.norm(uv[:, None] - found.uv_px, axis=2)
    return away.argmin(axis=1), away.min(axis=1)


def fisher_sigma_px(uv, electrons, psf):
    """Cramer-Rao bound of a coordinate, flux and place unknown, by differences of the model's image."""

    window = Camera(32, 32, 1.0, 1.0, 0.0, 0.0)

    def pixels(u, v, e):
        return point_sources(window, np.array([[u, v]]), np.array([e]), psf).ravel()

    u, v, e = *(uv % 1.0 + 15.0), electrons
    variance = pixels(u, v, e) + 10.0 + 10.0**2 + GAIN**2 / 12.0
    by = [
        (pixels(u + 1e-4, v, e) - pixels(u - 1e-4, v, e)) / 2e-4,
        (pixels(u, v + 1e-4, e) - pixels(u, v - 1e-4, e)) / 2e-4,
        pixels(u, v, e + 1.0) - pixels(u, v, e),
    ]
    information = np.array([[np.sum(a * b / variance) for b in by] for a in by])
    return np.sqrt(np.diag(np.linalg.inv(information))[:2])


@pytest.mark.parametrize("psf", [0.4, 0.6, 1.3])
@pytest.mark.parametrize("known", [True, False])
def test_errors_of_positions_are_at_the_cramer_rao_bound(psf, known):
    rng = np.random.default_rng(1)
    pulls, ratios = [], []
    for _ in range(6):
        uv, electrons = spread_out(rng, 40), 10.0 ** rng.uniform(3.2, 5.0, 40)
        found = detect_stars(expose(rng, uv, electrons, psf), GAIN, psf if known else None)
        assert found.psf_sigma_px == pytest.approx(psf, rel=0.04)
        nearest, away = paired(uv, found)
        assert (away < 0.5).all()
        pulls.append((found.uv_px[nearest] - uv) / found.sigma_px[nearest, None])
        bound = [np.sqrt(np.mean(fisher_sigma_px(*one, psf) ** 2)) for one in zip(uv[:8], electrons[:8], strict=True)]
        ratios.append(found.sigma_px[nearest[:8]] / bound)
    pulls = np.concatenate(pulls)
    low, high = stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], pulls.size) / pulls.size
    assert low < np.mean(pulls**2) < high * 1.1  # the width measured of a few stars is not exact
    assert np.abs(pulls.mean(axis=0)).max() < 4.0 / np.sqrt(len(pulls))
    np.testing.assert_allclose(ratios, 1.0, atol=0.1)


def test_the_attitude_of_images_is_within_a_fifth_of_the_bound_of_their_stars():
    """The root mean square over fields and axes, over the bound by Fisher's information of the noise-free images."""
    catalog, rng = artificial_sky(4, 7.5), np.random.default_rng(2)
    sky, zero = Sky.of(CAMERA, catalog), 1e6
    squares = []
    for _ in range(40):
        true = Rotation.random(random_state=rng).as_matrix()
        uv, light = star_pixels(CAMERA, true, catalog)
        result = identify(sky, detect_stars(expose(rng, uv, zero * light), GAIN), None, 1e-6)
        error = Rotation.from_matrix(result.attitude.R_cam_inertial @ true.T).as_rotvec()
        information = np.zeros((3, 3))
        for star in result.stars:
            towards = catalog.directions[star] @ true.T
            sigma_px = fisher_sigma_px(CAMERA.project(towards), zero * 10 ** (-0.4 * catalog.magnitudes[star]), 0.6)
            sigma_rad = np.sqrt(np.mean(sigma_px**2)) * CAMERA.pixel_angle_rad
            information += (np.eye(3) - np.outer(towards, towards)) / sigma_rad**2
        squares.append(error**2 / np.diag(np.linalg.inv(information)))
    ratio = np.sqrt(np.mean(squares))
    # 120 errors, correlated a little: the ratio has a standard deviation of about 0.07.
    assert 0.75 < ratio < 1.25


def test_the_body_its_limb_and_its_corners_are_no_stars():
    rng = np.random.default_rng(3)
    v, u = np.mgrid[0.5:512, 0.5:512]
    body = (np.hypot(u - 200, v - 220) < 150) & (u + 0.3 * v > 190)
    rough = gaussian_filter(rng.normal(size=(512, 512)), 1.5)
    scene = np.where(body, np.clip(0.03 + 0.03 * rough / rough.std(), 0.0, None), 0.0).astype(np.float32)
    stars = spread_out(rng, 60)
    stars = stars[np.hypot(*(stars - [200, 220]).T) > 175]
    found = detect_stars(expose(rng, stars, np.full(len(stars), 2e4), scene=scene), GAIN)
    nearest, away = paired(stars, found)
    assert (away < 0.3).all()
    off_body = np.hypot(*(found.uv_px - [200, 220]).T)
    assert len(found) == len(stars) and (off_body > 160).all()
    assert len(set(nearest)) == len(stars)


def test_the_level_of_the_sky_is_found_beside_a_body_of_most_of_the_image():
    rng = np.random.default_rng(4)
    image = rng.normal(12.0, 2.0, (512, 512)).astype(np.float32)
    image[:390] += rng.uniform(40.0, 900.0, (390, 512)).astype(np.float32)
    level, sigma = sky_level(image)
    assert level == pytest.approx(12.0, abs=0.2)
    assert sigma == pytest.approx(2.0, rel=0.05)


def test_noise_alone_has_no_stars_and_a_black_image_none():
    rng = np.random.default_rng(5)
    assert sum(len(detect_stars(expose(rng, np.zeros((0, 2)), np.zeros(0)), GAIN)) for _ in range(10)) == 0
    for level in (0.0, 100.0):
        assert len(detect_stars(np.full((512, 512), level, np.float32), GAIN)) == 0


def test_a_saturated_star_is_placed_by_its_wings_beside_a_saturated_body():
    rng = np.random.default_rng(6)
    scene = np.zeros((512, 512), np.float32)
    scene[300:, :] = 1.0
    uv = spread_out(rng, 60)
    uv = uv[uv[:, 1] < 270]
    found = detect_stars(expose(rng, uv, np.full(len(uv), 6e6), scene=scene), GAIN, 0.6)
    _, away = paired(uv, found)
    assert len(found) == len(uv) and away.max() < 0.01


@pytest.mark.parametrize("known", [True, False])
def test_saturated_patches_of_a_few_pixels_are_no_stars_and_do_not_widen_the_blur(known):
    """Boulders of the night side in the Sun: squares and bars of up to 5 pixels, far brighter than the full well."""
    rng = np.random.default_rng(8)
    uv = spread_out(rng, 80)
    scene = np.zeros((512, 512), np.float32)
    for u, v in uv[40:].astype(int):
        height, width = rng.integers(1, 6, 2)
        scene[v : v + height, u : u + max(width, 6 - height)] = 1.0
    stars = uv[:40]
    found = detect_stars(
        expose(rng, stars, 10.0 ** rng.uniform(3.5, 4.8, 40), scene=scene), GAIN, 0.6 if known else None
    )
    assert found.psf_sigma_px == pytest.approx(0.6, rel=0.05)
    assert paired(stars, found)[1].max() < 0.3
    assert len(found) <= 42
