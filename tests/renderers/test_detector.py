"""The detector against the photon transfer curve and analytic point spreads.

Statistical tests have a false-alarm level of 1e-4 under the model; seeds are fixed, so that a pass repeats.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.ndimage import gaussian_filter

from boresight.renderers.detector import Detector, blurred, point_spread
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.spec.camera import DetectorSpec

FALSE_ALARM = 1e-4
QUIET = {
    "psf_sigma_px": 0, "exposure_s": 0.5, "white_e_per_s": 10_000, "dark_e_per_s": 0, "read_noise_e": 0,
    "shot_noise": False, "gain_e_per_dn": 1, "offset_dn": 0, "bits": 16,
}  # fmt: skip


def expose(image, seed=0, **changes):
    spec = DetectorSpec(**{**QUIET, **changes})
    return Detector(spec).expose(np.asarray(image, dtype=np.float32), np.random.default_rng(seed))


def flat(level, size=256):
    return np.full((size, size), level, dtype=np.float32)


def assert_variance(sample, expected) -> None:
    """Chi-square interval of the variance of a normal sample."""
    ratio = sample.var(ddof=1) * (sample.size - 1) / expected
    low, high = stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], sample.size - 1)
    assert low < ratio < high


def test_the_chain_without_noise_is_arithmetic():
    """0.25 x 10000 e/s x 0.5 s = 1250 e, + 100 e/s x 0.5 s = 1300 e, / 4 e/DN = 325 DN, + 10 DN."""
    assert expose([[0.25]], dark_e_per_s=100, gain_e_per_dn=4, offset_dn=10)[0, 0] == 335.0


def test_an_exposure_that_is_drawn_scales_the_image_and_draws_no_noise():
    law = {"exposure_s": {"uniform": (0.2, 0.8)}}
    exposures = [expose([[1.0]], seed, **law)[0, 0] / 10_000 for seed in range(400)]
    assert stats.kstest(exposures, stats.uniform(0.2, 0.6).cdf).pvalue > FALSE_ALARM
    noise = [expose(flat(0.0, 4), 3, read_noise_e=9.0, offset_dn=99, **more) for more in ({}, law)]
    assert np.array_equal(*noise)


def test_numbers_are_whole_and_rounded_to_the_nearest():
    image = np.array([[0.2, 0.4, 0.6, 1.2]]) / 5000
    assert expose(image).tolist() == [[0, 0, 1, 1]]


def test_numbers_stop_at_the_top_of_the_bits_and_wells_at_their_depth():
    assert expose([[1.0]], bits=8)[0, 0] == 255
    assert expose([[1.0]], full_well_e=3000)[0, 0] == 3000
    assert expose([[1.0]], full_well_e=3000, gain_e_per_dn=2, offset_dn=7)[0, 0] == 1507


def test_shot_noise_is_poisson():
    """Mean and variance agree, and the histogram is the law's."""
    electrons = expose(flat(0.004), shot_noise=True)
    assert_variance(electrons.ravel(), 20)
    values = np.arange(8, 33)
    observed = [np.sum(electrons == value) for value in values]
    expected = stats.poisson(20).pmf(values) * electrons.size
    rest = [electrons.size - sum(observed), electrons.size - sum(expected)]
    assert stats.chisquare([*observed, rest[0]], [*expected, rest[1]]).pvalue > FALSE_ALARM


def test_the_photon_transfer_curve_gives_gain_and_read_noise():
    """Variance in DN against mean in DN is a line: slope 1 / gain, intercept (read noise / gain)^2 + 1/12.

    Slope and intercept must lie within 4 standard errors of the fit, which come from the variances' own errors.
    """
    gain, read = 3.0, 12.0
    levels = np.linspace(0.02, 0.9, 12)
    frames = [
        expose(flat(level), seed, shot_noise=True, read_noise_e=read, gain_e_per_dn=gain, offset_dn=50)
        for seed, level in enumerate(levels)
    ]
    means = np.array([frame.mean(dtype=np.float64) - 50 for frame in frames])
    variances = np.array([frame.var(dtype=np.float64) for frame in frames])
    errors = variances * np.sqrt(2 / frames[0].size)
    (slope, intercept), covariance = np.polyfit(means, variances, 1, w=1 / errors, cov="unscaled")
    assert abs(slope - 1 / gain) < 4 * np.sqrt(covariance[0, 0])
    assert abs(intercept - ((read / gain) ** 2 + 1 / 12)) < 4 * np.sqrt(covariance[1, 1])


def test_a_dark_frame_holds_offset_dark_current_and_read_noise():
    frame = expose(flat(0), shot_noise=True, dark_e_per_s=800, read_noise_e=9, offset_dn=100)
    assert frame.mean(dtype=np.float64) == pytest.approx(500, abs=4 * np.sqrt(481 / frame.size))
    assert_variance(frame.ravel().astype(np.float64), 400 + 81 + 1 / 12)


def test_read_noise_is_gaussian():
    frame = expose(flat(0.5), read_noise_e=1000, gain_e_per_dn=0.2, offset_dn=25_000)
    electrons = (frame.ravel().astype(np.float64) - 25_000) * 0.2 - 2500
    clipped = (frame == 0) | (frame == 65535)
    assert not clipped.any()
    assert stats.kstest(electrons, stats.norm(0, 1000).cdf).pvalue > FALSE_ALARM


def test_noise_of_neighbours_is_independent():
    frame = expose(flat(0.5), shot_noise=True, psf_sigma_px=2, read_noise_e=5).astype(np.float64)
    noise = frame - frame.mean()
    for shift in ((0, 1), (1, 0), (1, 1)):
        correlation = np.mean(noise * np.roll(noise, shift, (0, 1))) / noise.var()
        assert abs(correlation) < 4 / np.sqrt(frame.size)


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0, 3.7])
def test_the_point_spread_has_the_stated_width(sigma):
    """Unit sum, no shift, variance sigma**2 exactly, also below a pixel."""
    kernel = point_spread(sigma)
    x = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1, abs=1e-12)
    assert kernel @ x == pytest.approx(0, abs=1e-12)
    assert kernel @ x**2 == pytest.approx(sigma**2, rel=1e-6)


def test_a_wide_point_spread_is_the_gaussian_of_scipy():
    image = np.zeros((65, 65))
    image[32, 32] = 1.0
    ours, theirs = blurred(image, 4.0), gaussian_filter(image, 4.0, truncate=7)
    assert np.abs(ours - theirs).max() < 0.02 * theirs.max()


def test_two_spreads_make_one_of_the_summed_variance():
    image = np.random.default_rng(0).random((64, 64))
    inner = (slice(20, -20), slice(20, -20))
    assert np.allclose(blurred(blurred(image, 0.6), 0.8)[inner], blurred(image, 1.0)[inner], rtol=1e-9)


def test_the_edge_of_a_bright_field_stays_bright():
    assert np.allclose(blurred(np.ones((20, 30)), 2.0), 1.0, atol=1e-12)


def test_the_same_generator_state_gives_the_same_frame_and_inputs_stay():
    image = np.random.default_rng(3).random((32, 32)).astype(np.float32)
    before = image.copy()
    first, second = (expose(image, 5, shot_noise=True, read_noise_e=3, psf_sigma_px=1) for _ in range(2))
    assert np.array_equal(first, second)
    assert first.dtype == np.float32
    assert np.array_equal(image, before)
    assert not np.array_equal(first, expose(image, 6, shot_noise=True, read_noise_e=3, psf_sigma_px=1))


@pytest.mark.parametrize("image", [np.zeros(4), np.full((2, 2), np.nan), np.full((2, 2), -0.1)])
def test_an_image_that_is_none_is_refused(image):
    with pytest.raises(BoresightError, match="the detector needs an"):
        Detector(DetectorSpec()).expose(image.astype(np.float32), np.random.default_rng(0))
