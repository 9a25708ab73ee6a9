"""Innovation gates: false-alarm rates, and outliers found with a wrong predicted position."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.stats import binom

from boresight.estimators.slam.association.gating import gate_pixels

COMMON_PX = 30.0
OWN_PX = 0.7


def covariance(n: int) -> np.ndarray:
    """All pixels move together with the camera, and each has an error of its own."""
    common = np.kron(np.ones((n, n)), COMMON_PX**2 * np.eye(2))
    return common + OWN_PX**2 * np.eye(2 * n)


def drawn(rng: np.random.Generator, n: int) -> np.ndarray:
    return COMMON_PX * rng.standard_normal(2) + OWN_PX * rng.standard_normal((n, 2))


@pytest.mark.parametrize("gate", ["individual", "one-point"])
def test_right_pixels_are_refused_as_often_as_asked(gate: Literal["individual", "one-point"]) -> None:
    """One pixel a time is chi-square of two degrees; the bounds are left by chance once in a thousand."""
    rng = np.random.default_rng(1)
    refused = sum(not gate_pixels(drawn(rng, 1), covariance(1), gate, 0.05)[0] for _ in range(2000))
    assert binom.ppf(0.0005, 2000, 0.05) <= refused <= binom.ppf(0.9995, 2000, 0.05)


def test_consensus_refuses_few_right_pixels_of_many() -> None:
    """Each is refused with at most the given probability, sometimes because the hypothesis itself is poor."""
    rng = np.random.default_rng(2)
    kept = [gate_pixels(drawn(rng, 20), covariance(20), "one-point", 0.001) for _ in range(200)]
    assert np.mean(kept) > 0.997


@pytest.mark.parametrize("wrong", [1, 3, 7])
def test_consensus_finds_what_gates_one_by_one_let_pass(wrong: int) -> None:
    """Outliers of up to 20 px within a common error of 30 px: each pixel passes its individual gate."""
    rng = np.random.default_rng(wrong)
    missed_alone = 0
    for _ in range(50):
        residual = drawn(rng, 15)
        residual[:wrong] += 8.0 * np.sign(rng.standard_normal((wrong, 2))) * rng.uniform(1.0, 2.0, (wrong, 2))
        alone = gate_pixels(residual, covariance(15), "individual", 0.001)
        together = gate_pixels(residual, covariance(15), "one-point", 0.001)
        missed_alone += int(alone[:wrong].sum())
        assert not together[:wrong].any()
        assert together[wrong:].sum() >= 15 - wrong - 1
    assert missed_alone > 25 * wrong


def test_no_gate_believes_all() -> None:
    assert gate_pixels(np.full((3, 2), 1e6), covariance(3), "none", 0.001).all()
    assert gate_pixels(np.zeros((0, 2)), np.zeros((0, 0)), "one-point", 0.001).shape == (0,)
