"""Artefacts of a camera against closed forms, to 0.02 px or 0.1 %, and against Pillow.

Statistical tests have a false-alarm level of 1e-4 under the model; seeds are fixed, so that a pass repeats.
"""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image as Pillow
from pydantic import ValidationError
from scipy import stats

from boresight.renderers.artefacts import cosmic_rays, pixel_pattern
from boresight.renderers.detector import Detector
from boresight.renderers.stars import point_sources
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera, Pose, View, look_at
from boresight.scenarios.geometry.lens import RadialDistortion
from boresight.scenarios.spec.artefacts import CosmicRaysSpec, PixelsSpec
from boresight.scenarios.spec.camera import DetectorSpec

FALSE_ALARM = 1e-4
PX, SHARE = 0.02, 1e-3  # what a position and a level may be off
SIZE, EXPOSURE_S, WHITE_E_PER_S = 65, 0.5, 1e6
# A digital number is 0.001 electrons: rounding is far below what is tested.
QUIET = {
    "psf_sigma_px": 0, "exposure_s": EXPOSURE_S, "white_e_per_s": WHITE_E_PER_S, "dark_e_per_s": 0, "read_noise_e": 0,
    "shot_noise": False, "full_well_e": 1e12, "offset_dn": 0, "bits": 16,
}  # fmt: skip
CAMERA = Camera(SIZE, SIZE, 1000.0, 1000.0, 0.5 * SIZE, 0.5 * SIZE)
LENS = Camera(SIZE, SIZE, 300.0, 300.0, 0.5 * SIZE, 0.5 * SIZE, RadialDistortion(1.5, 0.0))
T_CAM_BODY = Pose(look_at(np.array([0.0, 0.0, 500.0]), 0.4).rotation, np.array([0.0, 0.0, 500.0]))


def view(camera=CAMERA, sun_cam=(1.0, 0.0, 0.0)):
    return View(camera, T_CAM_BODY, T_CAM_BODY.rotation.T @ np.array(sun_cam))


def electrons(light, seed=0, camera=CAMERA, points=None, velocity=None, sun_cam=(1.0, 0.0, 0.0), **changes):
    """Expose light, as electrons of the exposure, and return electrons."""
    light = np.asarray(light, dtype=np.float32)
    gain = max(float(light.max(initial=0.0)), 1.0) / 60_000.0
    spec = DetectorSpec(**{**QUIET, "gain_e_per_dn": gain, **changes})
    shown = light / np.float32(WHITE_E_PER_S * EXPOSURE_S)
    rng = np.random.default_rng(seed)
    return spec.gain_e_per_dn * Detector(spec).expose(shown, rng, points, view(camera, sun_cam), velocity)


def spot(uv=(32.5, 32.5), sigma_px=1.2, camera=CAMERA):
    return 1e6 * point_sources(camera, np.array([uv]), np.ones(1), sigma_px)


def centroid(image):
    v, u = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    return np.array([(image * u).sum(), (image * v).sum()]) / image.sum()


def variance(image):
    v, u = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    at = centroid(image)
    return np.array([(image * (u - at[0]) ** 2).sum(), (image * (v - at[1]) ** 2).sum()]) / image.sum()


def flat(level=20_000.0):
    return np.full((SIZE, SIZE), level)


def still(rate):
    return {"choice": (rate,)}


def pose_at(t_s, rate_rad_s, velocity_cam_m_s):
    """Pose of a camera that turns with a rate and flies with a velocity, both in the axes of time 0."""
    from scipy.spatial.transform import Rotation

    position_m = T_CAM_BODY.camera_position_m + t_s * T_CAM_BODY.rotation.T @ velocity_cam_m_s
    turned = Rotation.from_rotvec(-t_s * np.asarray(rate_rad_s)).as_matrix() @ T_CAM_BODY.rotation
    return Pose(turned, -turned @ position_m)


def test_a_spot_is_smeared_by_the_length_of_its_path_about_its_place():
    """A path of f w t = 8 px adds 8^2 / 12 to the variance along it."""
    rate = np.degrees(8.0 / 1000.0 / EXPOSURE_S)
    sharp, smeared = spot(), electrons(spot(), motion={"rate_deg_s": still((rate, 0.0, 0.0))})
    assert np.abs(centroid(smeared) - 32.5).max() < PX
    assert smeared.sum() == pytest.approx(1e6, rel=SHARE)
    assert np.sqrt(variance(smeared)) == pytest.approx(np.sqrt(variance(sharp) + np.array([0, 64 / 12])), abs=PX)


@pytest.mark.parametrize("camera", [CAMERA, LENS])
@pytest.mark.parametrize("row_delay_s", [None, 0.008])
def test_a_smeared_point_is_where_its_projections_are(camera, row_delay_s):
    """Mean of the pixels of one point, projected at the times at which its row is exposed, for a turn and a flight."""
    rate_rad_s, velocity_cam = np.array([0.004, -0.006, 0.3]), np.array([2.0, 1.0, 3.0])
    point_m = T_CAM_BODY.inverse().transform(np.array([500.0 * 9 / camera.fx_px, 500.0 * -14 / camera.fy_px, 500.0]))
    motion = {"rate_deg_s": still(tuple(np.degrees(rate_rad_s))), "trajectory": True}
    motion |= {} if row_delay_s is None else {"row_delay_s": row_delay_s}
    start = camera.project(T_CAM_BODY.transform(point_m))
    paths = []
    for share in (np.arange(200) + 0.5) / 200 - 0.5:
        at = start
        for _ in range(20):  # the time follows from the row where the point is seen
            t_s = share * EXPOSURE_S + (at[1] - 0.5 * SIZE) * (row_delay_s or 0.0)
            at = camera.project(pose_at(t_s, rate_rad_s, velocity_cam).transform(point_m))
        paths.append(at)
    velocity = T_CAM_BODY.rotation.T @ velocity_cam
    seen = electrons(spot(start, camera=camera), camera=camera, motion=motion, velocity=velocity)
    assert np.linalg.norm(np.mean(paths, axis=0) - start) > (0.2 if row_delay_s else 0.01)
    assert np.abs(centroid(seen) - np.mean(paths, axis=0)).max() < PX


def test_rows_of_a_rolling_shutter_are_shifted_by_their_time():
    """A vertical line under a turn about y leans: f w dt a row, none in the middle one."""
    light = np.tile(spot()[32] / spot()[32].sum() * 1e6, (SIZE, 1))
    rate, delay_s = 0.02, 0.004
    motion = {"rate_deg_s": still((0.0, np.degrees(rate), 0.0)), "row_delay_s": delay_s}
    seen = electrons(light, motion=motion, exposure_s=1e-6, white_e_per_s=WHITE_E_PER_S * EXPOSURE_S * 1e6)
    columns = seen @ (np.arange(SIZE) + 0.5) / seen.sum(axis=1)
    expected = 32.5 - 1000.0 * rate * delay_s * (np.arange(SIZE) - 32)
    assert np.abs(columns - expected).max() < PX


def test_stars_are_smeared_by_the_turn_and_not_by_the_flight():
    motion = {"rate_deg_s": still((0.0, 0.0, 1e-6)), "trajectory": True}
    velocity = T_CAM_BODY.rotation.T @ np.array([8.0, 0.0, 0.0])
    near = electrons(spot(), motion=motion, velocity=velocity)
    far = electrons(
        np.zeros((SIZE, SIZE)), points=spot() / EXPOSURE_S, motion=motion, velocity=velocity, gain_e_per_dn=9
    )
    assert np.sqrt(variance(near)[0]) == pytest.approx(np.sqrt(variance(spot())[0] + 64 / 12), abs=PX)
    assert np.sqrt(variance(far)[0]) == pytest.approx(np.sqrt(variance(spot())[0]), abs=PX)


def test_the_wings_have_their_share_and_variance():
    """Variances of a sum of Gaussians about one centre add by their shares; the light stays."""
    size = 201
    light = np.zeros((size, size))
    light[100, 100] = 1e6
    wings = ({"share": 0.2, "sigma_px": 3.0}, {"share": 0.1, "sigma_px": 8.0})
    # Before read-out, whose rounding cuts the wings.
    seen = Detector(DetectorSpec(**{**QUIET, "psf_sigma_px": 0.8}, psf_wings=wings)).rate_e_per_s(
        light / WHITE_E_PER_S, 1.0
    )
    assert seen.sum() == pytest.approx(1e6, rel=1e-9)
    assert variance(seen) == pytest.approx(np.full(2, 0.7 * 0.64 + 0.2 * 9 + 0.1 * 64), rel=SHARE)
    # There the wings are alone, and where the wide one has light its discrete Gaussian is within 1 % of the Gaussian.
    for px in (6, 20):
        wide, widest = 0.2 / (2 * np.pi * 9) * np.exp(-(px**2) / 18), 0.1 / (2 * np.pi * 64) * np.exp(-(px**2) / 128)
        assert seen[100, 100 + px] == pytest.approx(1e6 * (wide + widest), rel=0.01)


def test_stars_have_the_wings_of_surfaces():
    wings = ({"share": 0.2, "sigma_px": 3.0},)
    seen = electrons(
        np.zeros((SIZE, SIZE)), points=spot() / EXPOSURE_S, psf_sigma_px=1.2, psf_wings=wings, gain_e_per_dn=4
    )
    sharp = variance(spot())
    assert variance(seen) == pytest.approx(0.8 * sharp + 0.2 * (sharp + 9.0 - 1.44), rel=0.002)


def test_a_veil_keeps_the_light_and_is_even():
    seen = electrons(spot(), stray_light={"veil_share": 0.25})
    assert seen.sum() == pytest.approx(1e6, rel=SHARE)
    assert seen[0, 0] == pytest.approx(0.25 * 1e6 / SIZE**2, rel=0.02)
    assert seen[32, 32] == pytest.approx(0.75 * spot()[32, 32] + seen[0, 0], rel=SHARE)


def test_the_glow_falls_from_the_edge_at_the_sun_to_the_other():
    glow = {"stray_light": {"glow_e_per_s": 1e5}, "gain_e_per_dn": 1.0}
    seen = electrons(flat(0.0), **glow)
    u = np.arange(SIZE) + 0.5
    assert np.abs(seen - 1e5 * EXPOSURE_S * u / SIZE).max() <= 0.5
    down = electrons(flat(0.0), sun_cam=(0.0, 1.0, 0.3), **glow)
    assert np.abs(down - seen.T).max() <= 1.0
    assert (electrons(flat(0.0), sun_cam=(0.0, 0.0, -1.0), **glow) == 25_000).all()


def test_frame_transfer_adds_the_sum_of_the_column_by_the_times():
    """Streak: t_shift / t_exposure x column sum, above and below the spot alike."""
    # Before read-out, whose rounding is 0.6 % of the streak.
    exact = Detector(DetectorSpec(**QUIET, row_shift_s=2e-4)).rate_e_per_s(spot() / WHITE_E_PER_S, EXPOSURE_S)
    streak = 2e-4 / EXPOSURE_S * spot().sum(axis=0)
    assert exact - spot() == pytest.approx(np.tile(streak, (SIZE, 1)), rel=SHARE, abs=1e-6)
    seen = electrons(spot(), row_shift_s=2e-4)
    assert (seen[0] == seen[-1]).all()
    assert seen.sum() == pytest.approx(1e6 * (1 + SIZE * 2e-4 / EXPOSURE_S), rel=SHARE)
    even = electrons(flat(), row_shift_s=2e-4)[9, 9]
    assert even == pytest.approx(20_000 * (1 + SIZE * 2e-4 / EXPOSURE_S), rel=SHARE)


def test_the_flat_field_has_its_rms_and_is_the_same_in_every_image():
    first, second = (electrons(flat(), seed, pixels={"response_sigma": 0.03}, gain_e_per_dn=0.5) for seed in (1, 2))
    assert np.array_equal(first, second)
    relative = first.ravel() / 20_000
    low, high = stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], relative.size - 1) / (relative.size - 1)
    assert low < relative.var(ddof=1) / 0.03**2 < high
    assert not np.array_equal(
        first, electrons(flat(), 1, pixels={"response_sigma": 0.03, "seed": 1}, gain_e_per_dn=0.5)
    )


def test_vignetting_takes_its_share_at_the_corners_and_falls_with_the_square():
    seen = electrons(flat(), pixels={"vignetting": 0.3}) / 20_000
    assert seen[32, 32] == pytest.approx(1.0, rel=SHARE)
    assert seen[0, 0] == pytest.approx(1.0 - 0.3 * (32 / 32.5) ** 2, rel=SHARE)
    assert seen[32, 0] == pytest.approx(1.0 - 0.15 * (32 / 32.5) ** 2, rel=SHARE)


def test_dead_pixels_are_dark_and_hot_ones_add_charge():
    pixels = {"dead_share": 0.02, "hot_share": 0.05, "hot_e_per_s": 8_000.0}
    seen = electrons(flat(), pixels=pixels, gain_e_per_dn=1.0)
    response, hot = pixel_pattern(PixelsSpec(**pixels), (SIZE, SIZE))
    dead = seen == 0
    assert dead.sum() == np.ceil(0.02 * SIZE**2)
    assert np.array_equal(dead, response == 0.0)
    warm = seen > 20_001
    assert (warm & (hot > 0)).sum() == warm.sum()
    assert (hot > 0).sum() == np.ceil(0.05 * SIZE**2)
    assert not (dead & (hot > 0)).any()
    assert np.abs(seen[hot > 0] - 20_000 - EXPOSURE_S * hot[hot > 0]).max() <= 0.51
    assert stats.kstest(hot[hot > 0], stats.expon(scale=8_000).cdf).pvalue > FALSE_ALARM
    more = pixel_pattern(PixelsSpec(**{**pixels, "hot_share": 0.1}), (SIZE, SIZE))[1]
    assert np.array_equal(more[hot > 0], hot[hot > 0])


def test_cosmic_rays_have_their_number_and_their_charge():
    """Number of hits: Poisson. Charge: e_per_px times a mean length, less what leaves the frame (first order)."""
    rays = {"hits_per_s": 1.0 / EXPOSURE_S, "e_per_px": 500.0, "length_px": 0.5}
    charges = np.array([electrons(flat(0.0), seed, cosmic_rays=rays, gain_e_per_dn=0.05).sum() for seed in range(1500)])
    assert stats.binomtest(int((charges > 0).sum()), 1500, 1 - np.exp(-1)).pvalue > FALSE_ALARM
    assert charges.mean() == pytest.approx(250 * (1 - 0.5 * 4 / np.pi / SIZE), abs=4 * 250 * np.sqrt(2 / 1500))


def test_the_charge_of_a_track_is_its_length():
    """Single tracks inside the frame: charge over e_per_px is the distance of the end pixels, on average."""
    shape, spec, off = (1200, 1200), CosmicRaysSpec(hits_per_s=1.0, e_per_px=500.0, length_px=300.0), []
    for seed in range(200):
        if np.random.default_rng(seed).poisson(1.0) != 1:
            continue
        v, u = np.nonzero(seen := cosmic_rays(spec, shape, 1.0, np.random.default_rng(seed)))
        if min(u.min(), v.min()) > 0 and max(u.max(), v.max()) < 1199:
            off.append(seen.sum() / 500.0 - np.hypot(np.ptp(u), np.ptp(v)))
    assert len(off) > 25
    assert abs(np.mean(off)) < SHARE * 300.0


def test_a_track_is_a_straight_line():
    rays = {"hits_per_s": 1.0 / EXPOSURE_S, "e_per_px": 500.0, "length_px": 15.0}
    checked = 0
    for seed in range(60):
        seen = electrons(flat(0.0), seed, cosmic_rays=rays, gain_e_per_dn=0.05)
        if np.random.default_rng(seed).spawn(1)[0].spawn(2)[1].poisson(1.0) != 1 or (seen > 0).sum() < 8:
            continue
        v, u = np.nonzero(seen)
        across = np.linalg.svd(np.stack([u - u.mean(), v - v.mean()]))[1]
        assert across[1] / np.sqrt(len(u)) < 0.5, "an 8-connected line is within half a pixel of itself (RMS)"
        checked += 1
    assert checked > 5


def test_jpeg_is_that_of_pillow():
    image = np.clip(np.random.default_rng(4).normal(120, 30, (64, 64)), 0, 255).round()
    image[:, 30:] = 20.0
    spec = DetectorSpec(
        **{**QUIET, "white_e_per_s": 1e4, "exposure_s": 1.0, "gain_e_per_dn": 1, "bits": 8}, jpeg_quality=70
    )
    seen = Detector(spec).expose((image / 1e4).astype(np.float32), np.random.default_rng(0))
    buffer = io.BytesIO()
    Pillow.fromarray(image.astype(np.uint8)).save(buffer, "JPEG", quality=70)
    theirs = np.asarray(Pillow.open(buffer), dtype=np.float32)
    assert np.abs(seen - image).max() > 5
    assert np.abs(seen - theirs).max() <= 1
    assert np.abs(seen - theirs).mean() < 0.02


EVERYTHING = {
    "psf_wings": ({"share": 0.1, "sigma_px": 3.0},),
    "stray_light": {"veil_share": 0.1, "glow_e_per_s": 1e3},
    "motion": {"rate_deg_s": {"normal": (0.5, 0.5, 0.5)}},
    "pixels": {"response_sigma": 0.02, "hot_share": 0.01, "dead_share": 0.01},
    "row_shift_s": 1e-4,
    "cosmic_rays": {"hits_per_s": 20.0},
    "jpeg_quality": 60,
    "bits": 8,
    "gain_e_per_dn": 300.0,
    "shot_noise": True,
}


def test_the_same_seed_gives_the_same_image_and_another_another_one():
    first, second, other = (electrons(flat(), seed, **EVERYTHING) for seed in (5, 5, 6))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_noise_does_not_depend_on_the_draws_of_artefacts():
    """Far from the tracks the frames with and without cosmic rays are equal, bit for bit."""
    noisy = {"shot_noise": True, "read_noise_e": 9.0}
    plain, hit = (electrons(flat(), 3, **noisy, **more) for more in ({}, {"cosmic_rays": {"hits_per_s": 10.0}}))
    assert 0 < (plain != hit).sum() < 200


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"stray_light": {}}, "both are 0"),
        ({"motion": {}}, "nothing moves"),
        ({"motion": {"rate_deg_s": {"normal": (0, 0, 0)}}}, "nothing moves"),
        ({"motion": {"row_delay_s": 1e-4}}, "nothing moves"),
        ({"pixels": {"seed": 4}}, "all pixels are alike"),
        ({"pixels": {"vignetting": 0.1, "hot_e_per_s": 5.0}}, "hot_e_per_s has no part without hot_share"),
        ({"pixels": {"dead_share": 0.6, "hot_share": 0.6}}, "above 1 together"),
        ({"psf_wings": ({"share": 0.1, "sigma_px": 0.5},)}, "above psf_sigma_px"),
        ({"psf_wings": ({"share": 0.6, "sigma_px": 2.0},) * 2}, "leave light"),
        ({"psf_wings": ({"share": 0.0, "sigma_px": 2.0},)}, "greater than 0"),
        ({"row_shift_s": 0.0}, "greater than 0"),
        ({"cosmic_rays": {"hits_per_s": 0.0}}, "greater than 0"),
        ({"jpeg_quality": 80}, "JPEG has 8 bits and the detector 12"),
        (
            {"row_shift_s": 1e-5, "motion": {"rate_deg_s": {"normal": (1, 1, 1)}, "row_delay_s": 1e-4}},
            "frame transfer has no rolling shutter",
        ),
    ],
)
def test_what_would_do_nothing_is_refused(changes, told):
    with pytest.raises(ValidationError, match=told):
        DetectorSpec(**changes)


def test_motion_needs_a_view_and_a_velocity():
    turned = Detector(DetectorSpec(motion={"rate_deg_s": still((1.0, 0.0, 0.0))}))
    with pytest.raises(BoresightError, match="need the view"):
        turned.expose(np.zeros((8, 8), dtype=np.float32), np.random.default_rng(0))
    flown = Detector(DetectorSpec(motion={"trajectory": True}))
    with pytest.raises(BoresightError, match="no velocity"):
        flown.expose(np.zeros((SIZE, SIZE), dtype=np.float32), np.random.default_rng(0), view=view())
