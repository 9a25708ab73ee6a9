"""Which of several recognised landmarks agree with each other: joint compatibility (Neira and Tardos 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

FloatArray = NDArray[np.float64]

_SAME_PLACE_M = 1e-3


def agreeing(differences_m: FloatArray, covariance_m2: FloatArray, probability: float) -> list[int]:
    """List the largest set of pairs that may all be right at once.

    A right pair is one landmark estimated twice: the difference is noise, most of it common to all pairs, since it is
    what the path has drifted. Each pair that could be right by itself starts a set; the one that the set foretells best
    joins it, and tells the rest of the drift, until none is left that its chi-square of 3 degrees of freedom, given
    those in the set, lets in. That is greedy where Neira and Tardos search a tree.

    Parameters
    ----------
    differences_m
        (k, 3) second estimate less first.
    covariance_m2
        (3 k, 3 k) of all differences together.
    probability
        With which a right pair passes.
    """
    gate = 2.0 * float(gammaincinv(1.5, probability))  # the quantile of chi-square of 3 degrees of freedom
    best: tuple[int, float] = (0, 0.0)
    found: list[int] = []
    for seed in range(len(differences_m)):
        if seed in found:  # it would start the same set
            continue
        members, total = _grown(seed, differences_m.ravel(), covariance_m2, gate)
        if (len(members), -total) > best:
            best, found = (len(members), -total), members
    return sorted(found)


def _grown(seed: int, difference: FloatArray, covariance: FloatArray, gate: float) -> tuple[list[int], float]:
    """Grow a set from one pair; return it with its joint chi-square, or nothing where the pair is wrong by itself."""
    members: list[int] = []
    total, candidate = 0.0, seed
    squares = _squares(difference, covariance)
    while squares[candidate] <= gate:
        members.append(candidate)
        total += float(squares[candidate])
        difference, covariance = _given(candidate, difference, covariance)
        squares = _squares(difference, covariance)
        squares[members] = np.inf
        candidate = int(np.argmin(squares))
    return members, total


def _squares(difference: FloatArray, covariance: FloatArray) -> FloatArray:
    """(k,) squared differences over their covariances."""
    count = len(difference) // 3
    rows = np.arange(count)
    blocks = covariance.reshape(count, 3, count, 3)[rows, :, rows] + _SAME_PLACE_M**2 * np.eye(3)
    parts = difference.reshape(count, 3)
    return np.asarray(np.einsum("ki,ki->k", parts, np.linalg.solve(blocks, parts[:, :, None])[:, :, 0]))


def _given(pair: int, difference: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what is left of differences and covariance once a pair is known to be one landmark."""
    rows = slice(3 * pair, 3 * pair + 3)
    block = covariance[rows, rows] + _SAME_PLACE_M**2 * np.eye(3)
    gain = np.linalg.solve(block, covariance[rows]).T
    return difference - gain @ difference[rows], covariance - gain @ covariance[rows]
