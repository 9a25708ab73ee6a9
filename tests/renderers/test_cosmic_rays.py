"""Tracks of charged particles: their number, charge, directions and shape.

Statistical tests have a false-alarm level of 1e-4 under the model; seeds are fixed, so that a pass repeats.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.ndimage import label

from boresight.renderers.artefacts import cosmic_rays
from boresight.renderers.detector import Detector
from boresight.scenarios.spec.artefacts import CosmicRaysSpec
from boresight.scenarios.spec.camera import DetectorSpec

FALSE_ALARM = 1e-4


def exposed(rays, seed, shape, exposure_s):
    """Return the electrons of a dark frame."""
    quiet = {"dark_e_per_s": 0, "read_noise_e": 0, "offset_dn": 0, "bits": 16, "gain_e_per_dn": 0.05}
    spec = DetectorSpec(cosmic_rays=rays, exposure_s=exposure_s, **quiet)
    return 0.05 * Detector(spec).expose(np.zeros(shape, dtype=np.float32), np.random.default_rng(seed))


@pytest.mark.parametrize("exposure_s", [0.4, 1.6])
def test_cosmic_rays_have_their_number_and_their_charge(exposure_s):
    """Tracks that touch the frame: Poisson, with a mean of 1 + 2 / pi (W + H) L / (W H) for each with its middle in it.

    Charge: e_per_px times the mean length; what leaves the frame enters from beyond.
    """
    rays = {"hits_per_s": 0.8, "e_per_px": 500.0, "length_px": 2.0}
    charges = np.array([exposed(rays, seed, (65, 31), exposure_s).sum() for seed in range(1500)])
    hits = 0.8 * exposure_s
    touching = hits * (1 + 2 / np.pi * (31 + 65) * 2.0 / (31 * 65))
    assert stats.binomtest(int((charges > 0).sum()), 1500, 1 - np.exp(-touching)).pvalue > FALSE_ALARM
    assert charges.mean() == pytest.approx(1000 * hits, abs=4 * 1000 * np.sqrt(2 * hits / 1500))


def test_cosmic_rays_fall_evenly_over_the_frame_in_all_directions():
    """Mean charge of the edge and of the middle, 1000 tracks each in 30 frames; slopes of single tracks."""
    spec = CosmicRaysSpec(hits_per_s=1000.0, e_per_px=1.0, length_px=10.0)
    seen = np.mean([cosmic_rays(spec, (80, 120), 1.0, np.random.default_rng(seed)) for seed in range(30)], axis=0)
    expected = 1000.0 * 10.0 / (80 * 120)
    # Of a track c <= l falls into a region of A pixels: its variance is at most n E[c l] = n A / (W H) 2 L^2.
    for edge in (seen[:2], seen[-2:], seen[:, :2], seen[:, -2:], seen[20:60, 30:90]):
        sigma = np.sqrt(2.0 * 80 * 120 / (30 * 1000 * edge.size))
        assert edge.mean() == pytest.approx(expected, rel=4 * sigma)
    single, rising = CosmicRaysSpec(hits_per_s=0.5, e_per_px=1.0, length_px=20.0), []
    for seed in range(400):
        v, u = np.nonzero(cosmic_rays(single, (200, 200), 1.0, np.random.default_rng(seed)))
        if u.size > 3 and min(np.ptp(u), np.ptp(v)) > 2:
            rising.append(np.cov(u, v)[0, 1] > 0)
    assert len(rising) > 60
    assert stats.binomtest(sum(rising), len(rising)).pvalue > FALSE_ALARM


def test_the_charge_of_a_track_is_its_length():
    """Single tracks inside the frame: charge over e_per_px is the distance of the end pixels, on average."""
    shape, spec, off = (1200, 1200), CosmicRaysSpec(hits_per_s=1.0, e_per_px=500.0, length_px=300.0), []
    for seed in range(300):
        if np.random.default_rng(seed).poisson(1.0 + 2400 * 300 / 1200**2 + 2 * 300**2 / 1200**2) != 1:
            continue  # the first draw is their number
        v, u = np.nonzero(seen := cosmic_rays(spec, shape, 1.0, np.random.default_rng(seed)))
        if len(u) and min(u.min(), v.min()) > 0 and max(u.max(), v.max()) < 1199:
            off.append(seen.sum() / 500.0 - np.hypot(np.ptp(u), np.ptp(v)))
    assert len(off) > 25
    assert abs(np.mean(off)) < 0.3


def test_a_track_is_a_straight_line():
    rays = {"hits_per_s": 0.4, "e_per_px": 500.0, "length_px": 15.0}
    checked = 0
    for seed in range(100):
        seen = exposed(rays, seed, (65, 65), 0.5)
        if label(seen > 0, np.ones((3, 3)))[1] != 1 or (seen > 0).sum() < 8:
            continue
        v, u = np.nonzero(seen)
        across = np.linalg.svd(np.stack([u - u.mean(), v - v.mean()]))[1]
        assert across[1] / np.sqrt(len(u)) < 0.5, "an 8-connected line is within half a pixel of itself (RMS)"
        checked += 1
    assert checked > 5
