"""The pose by all recognised craters at once, none of which decides alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.craters.matching.association import Association, Expected, given
from estimators.craters.robust import huber_weights
from scenarios.geometry import Ellipses

FloatArray = NDArray[np.float64]

_PASSES = 10


def adjusted(expected: Expected, seen: Ellipses, found: Association) -> Association:
    """Adjust the common error anew by Huber's loss: centres of rims have heavier tails than a Gaussian.

    The noise of each couple is divided by its weight until the weights stand still; the prior keeps its weight.
    """
    foretold = expected.ellipses.centre_px + expected.by_error @ expected.mean
    offsets = seen.centre_px[None] - foretold[:, None]
    i, k = found.pairs.T
    error, noise = found.error - expected.mean, expected.noise_px2[i]
    for _ in range(_PASSES):
        left = offsets[i, k] - expected.by_error[i] @ error
        sigmas = np.sqrt(np.einsum("ni,nij,nj->n", left, np.linalg.inv(noise), left))
        weighed = expected.noise_px2.copy()
        weighed[i] = noise / huber_weights(sigmas)[:, None, None]
        error, covariance = given(replace(expected, noise_px2=weighed), offsets, found.pairs)
    return replace(found, error=expected.mean + error, covariance=covariance)
