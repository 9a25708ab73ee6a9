"""Artefacts of a camera against closed forms, to 0.02 px or 0.1 %, and against Pillow, another writer of JPEG.

Statistical tests have a false-alarm level of 1e-4 under the model; seeds are fixed, so that a pass repeats.
"""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image as Pillow
from pydantic import ValidationError
from scipy import stats
from scipy.special import ive

from boresight.renderers.artefacts import Motion, cosmic_rays, pixel_pattern
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
    """A turn about x moves along v, by 6 px, and a flight along x along u, by 8 px."""
    motion = {"rate_deg_s": still((np.degrees(6.0 / 1000.0 / EXPOSURE_S), 0.0, 0.0)), "trajectory": True}
    velocity = T_CAM_BODY.rotation.T @ np.array([8.0, 0.0, 0.0])
    near = electrons(spot(), motion=motion, velocity=velocity)
    far = electrons(
        np.zeros((SIZE, SIZE)), points=spot() / EXPOSURE_S, motion=motion, velocity=velocity, gain_e_per_dn=9
    )
    turned, flown = np.array([0, 36 / 12]), np.array([64 / 12, 0])
    assert np.sqrt(variance(near)) == pytest.approx(np.sqrt(variance(spot()) + turned + flown), abs=PX)
    assert np.sqrt(variance(far)) == pytest.approx(np.sqrt(variance(spot()) + turned), abs=PX)


@pytest.mark.parametrize(("u", "sigma_px"), [(32.3, 0.3), (32.5, 0.5), (4.5, 0.5), (60.5, 0.5), (0.7, 0.5)])
def test_a_star_that_moves_20_px_leaves_in_the_frame_its_share_of_the_path(u, sigma_px):
    """A cubic spline overshoots beside a sharp star: the sum stays. No light comes from beyond the edge."""
    motion = {"rate_deg_s": still((0.0, np.degrees(20.0 / 1000.0 / EXPOSURE_S), 0.0))}
    star = spot((u, 32.6), sigma_px)
    seen = electrons(np.zeros((SIZE, SIZE)), points=star / EXPOSURE_S, motion=motion, gain_e_per_dn=2.0)
    at = centroid(star)[0]
    share = min(1.0, (10.0 + at) / 20.0, (10.0 + SIZE - at) / 20.0)
    assert seen.sum() == pytest.approx(star.sum() * share, rel=SHARE if share == 1.0 else 5 * SHARE)
    if sigma_px == 0.5:
        along = seen[32, max(int(u) - 8, 1) : int(u) + 8]
        assert along.min() == pytest.approx(along.max(), rel=0.02), "an even trail"


@pytest.mark.parametrize("u", [0.5, 64.5, 32.5])
def test_the_wings_of_a_star_end_at_the_edge(u):
    """A star in the middle of an edge pixel: the discrete Gaussian has half of its light, and of its middle, inside."""
    spec = DetectorSpec(**QUIET, psf_wings=({"share": 0.5, "sigma_px": 2.0},))
    seen = Detector(spec).rate_e_per_s(np.zeros((SIZE, SIZE)), 1.0, points_e_per_s=spot((u, 32.5), 0.0))
    middle = ive(0, 4.0)
    inside = 1.0 if u == 32.5 else 0.5 + 0.5 * middle
    assert seen.sum() == pytest.approx(1e6 * (0.5 + 0.5 * inside), rel=1e-6)


def test_a_long_trail_is_even_and_a_longer_one_is_refused():
    """150 px in steps of half a pixel; of 360 deg about the boresight the chord is 0, but not the path."""
    camera = Camera(401, 11, 2000.0, 2000.0, 200.5, 5.5)
    star = point_sources(camera, np.array([[200.5, 5.5]]), np.ones(1), 0.5)
    turned = Motion(view(camera), 1.0, np.array([0.0, 150.0 / 2000.0, 0.0]), np.zeros(3))
    flown = Motion(view(camera), 1.0, np.zeros(3), np.array([150.0 / 2000.0 * 500.0, 0.0, 0.0]))
    for motion in (turned, flown):
        trail = motion.smeared(star, "constant")[5, 130:271]
        assert trail.min() > 0.98 * trail.max()
    with pytest.raises(BoresightError, match=r"detector\.motion: the image moves by 1260 px in an exposure"):
        Motion(view(camera), 1.0, np.array([0.0, 0.0, 2 * np.pi]), np.zeros(3)).smeared(star)
    rolled = Motion(view(CAMERA), 1.0, np.array([0.0, 0.0, 2 * np.pi]), np.zeros(3)).smeared(spot((42.5, 32.5)))
    assert rolled[32, 22] == pytest.approx(rolled[22, 32], rel=0.01)
    assert rolled[32, 22] == pytest.approx(rolled[32, 42], rel=0.01), "a whole turn makes a ring"


def test_the_path_of_a_small_motion_is_a_parabola():
    camera = Camera(1201, 5, 20_000.0, 20_000.0, 600.5, 2.5)
    rate, velocity = np.array([0.0, 0.012, 0.001]), np.array([0.0, 0.0, 2.0])
    motion = Motion(view(camera), 1.0, rate, velocity, 1e-4)
    for share in (-0.4, -0.1, 0.3):
        assert np.abs(motion._path()(share) - motion._sources(share)).max() < 0.001
    middle = 0.5 * (motion._sources(-0.5) + motion._sources(0.5))
    assert np.abs(middle - motion._sources(0.0)).max() > 0.02, "a straight line is not enough"


def test_a_pixel_that_shows_what_was_behind_the_camera_is_refused():
    wide = Camera(SIZE, SIZE, 30.0, 30.0, 0.5 * SIZE, 0.5 * SIZE)
    with pytest.raises(BoresightError, match=r"detector\.motion: a pixel shows"):
        Motion(view(wide), 1.0, np.radians([0.0, 120.0, 0.0]), np.zeros(3)).smeared(flat())


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
    for px in (6, 20):  # there the wings are alone; the discrete Gaussian of Lindeberg (1990)
        wide, widest = (ive(0, t) * ive(px, t) for t in (9.0, 64.0))
        assert seen[100, 100 + px] == pytest.approx(1e6 * (0.2 * wide + 0.1 * widest), rel=SHARE)


def test_stars_have_the_wings_of_surfaces():
    wings = ({"share": 0.2, "sigma_px": 3.0},)
    detector = Detector(DetectorSpec(**{**QUIET, "psf_sigma_px": 1.2}, psf_wings=wings))
    seen = detector.rate_e_per_s(np.zeros((SIZE, SIZE)), EXPOSURE_S, points_e_per_s=spot())
    sharp = variance(spot())
    assert variance(seen) == pytest.approx(0.8 * sharp + 0.2 * (sharp + 9.0 - 1.44), rel=SHARE)


def test_a_veil_keeps_the_light_and_is_even():
    detector = Detector(DetectorSpec(**QUIET, stray_light={"veil_share": 0.25}))
    seen = detector.rate_e_per_s(spot() / WHITE_E_PER_S, EXPOSURE_S, view=view())
    assert seen == pytest.approx(0.75 * spot() + 0.25 * 1e6 / SIZE**2, rel=SHARE)
    assert electrons(spot(), stray_light={"veil_share": 0.25}).sum() == pytest.approx(1e6, rel=SHARE)


def test_the_background_falls_linearly_from_the_side_of_the_sun():
    gradient = {"stray_light": {"gradient_e_per_s": 1e5}, "gain_e_per_dn": 1.0}
    seen = electrons(flat(0.0), **gradient)
    u = np.arange(SIZE) + 0.5
    assert np.abs(seen - 1e5 * EXPOSURE_S * u / SIZE).max() <= 0.5
    down = electrons(flat(0.0), sun_cam=(0.0, 1.0, 0.3), **gradient)
    assert np.abs(down - seen.T).max() <= 1.0
    assert (electrons(flat(0.0), sun_cam=(0.0, 0.0, -1.0), **gradient) == 25_000).all()


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
    response, hot = pixel_pattern(PixelsSpec(dead_share=0.5, hot_share=0.5), (SIZE, SIZE))
    assert ((response == 0.0) ^ (hot > 0.0)).all(), "of an odd number of pixels too"


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
    "stray_light": {"veil_share": 0.1, "gradient_e_per_s": 1e3},
    "motion": {"rate_deg_s": {"normal": (0.5, 0.5, 0.5)}},
    "pixels": {"response_sigma": 0.02, "hot_share": 0.01, "dead_share": 0.01},
    "row_shift_s": 1e-4,
    "cosmic_rays": {"hits_per_s": 20.0},
    "jpeg_quality": 60,
    "bits": 8,
    "gain_e_per_dn": 300.0,
    "shot_noise": True,
}


def test_artefacts_act_in_their_order():
    """A frame of 48 x 30 with all that acts on single pixels, against the formula written out.

    The light is the same along rows, so that a turn about y leaves it as it is, but would smear the pattern of pixels.
    """
    width, height, exposure_s = 48, 30, 2.0
    camera = Camera(width, height, 2000.0, 2000.0, 0.5 * width, 0.5 * height)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    light = 10_000.0 + 4_000.0 * np.cos(2 * np.pi * v / height)
    pixels = {"response_sigma": 0.05, "dead_share": 0.01, "hot_share": 0.01, "hot_e_per_s": 2_000.0, "seed": 7}
    rays = {"hits_per_s": 20.0, "e_per_px": 2_000.0, "length_px": 6.0}
    spec = DetectorSpec(
        **{**QUIET, "exposure_s": exposure_s, "dark_e_per_s": 30.0, "full_well_e": 30_000.0, "offset_dn": 5},
        gain_e_per_dn=1.0,
        stray_light={"veil_share": 0.2, "gradient_e_per_s": 3_000.0},
        motion={"rate_deg_s": still((0.0, np.degrees(8.0 / 2000.0 / exposure_s), 0.0))},
        pixels={**pixels, "vignetting": 0.3},
        row_shift_s=2e-3,
        cosmic_rays=rays,
    )
    seen = Detector(spec).expose(
        (light / WHITE_E_PER_S).astype(np.float32), np.random.default_rng(9), view=view(camera, (1.0, 0.5, 0.3))
    )
    response, hot = pixel_pattern(PixelsSpec(**pixels), (height, width))
    vignetting = 1.0 - 0.3 * ((u - 24.0) ** 2 + (v - 15.0) ** 2) / (24.0**2 + 15.0**2)
    collected = (
        response * vignetting * (0.8 * light + 0.2 * light.mean() + 3_000.0 * (2 * u + v) / (2 * width + height))
    )
    collected += 2e-3 / exposure_s * collected.sum(axis=0)
    tracks = cosmic_rays(
        CosmicRaysSpec(**rays), light.shape, exposure_s, np.random.default_rng(9).spawn(1)[0].spawn(2)[1]
    )
    electrons_ = np.minimum(exposure_s * (collected + 30.0 + hot) + tracks, 30_000.0)
    assert ((tracks > 0) & (electrons_ == 30_000.0)).any(), "tracks that saturate"
    assert np.abs(seen - electrons_ - 5.0).max() < 1.0 + 2e-4 * electrons_.max(), "rounding, and the curvature of rows"


def test_the_same_seed_gives_the_same_image_and_another_another_one():
    first, second, other = (electrons(flat(), seed, **EVERYTHING) for seed in (5, 5, 6))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_noise_does_not_depend_on_the_draws_of_cosmic_rays():
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
        ({"pixels": {"vignetting": 0.1, "hot_e_per_s": 5.0}}, "hot_e_per_s: there are no hot pixels"),
        ({"pixels": {"vignetting": 0.1, "seed": 4}}, "seed: vignetting is not drawn"),
        ({"cosmic_rays": {"hits_per_s": 1e6}, "exposure_s": 1.0}, "more than 100000 tracks in an exposure"),
        ({"cosmic_rays": {"hits_per_s": 1.0, "length_px": 5e-324}}, "greater than or equal to 0.01"),
        ({"pixels": {"dead_share": 0.6, "hot_share": 0.6}}, "above 1 together"),
        ({"psf_wings": ({"share": 0.1, "sigma_px": 0.5},)}, "above psf_sigma_px"),
        ({"psf_wings": ({"share": 0.6, "sigma_px": 2.0},) * 2}, "leave light"),
        ({"psf_wings": ({"share": 0.0, "sigma_px": 2.0},)}, "greater than 0"),
        ({"psf_wings": ()}, "at least 1 item"),
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
