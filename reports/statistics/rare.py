"""The rate of misses among trials that are weighted by how probable they are: importance sampling of rare failures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from boresight.scenarios.arrays import BoolArray, FloatArray

_TAIL = 0.025


@dataclass(frozen=True, slots=True)
class WeightedRate:
    """The rate at which trials miss, from ``n`` weighted ones of which ``missed`` do.

    ``low`` and ``high`` are its 95 % interval. ``effective`` unweighted trials know a mean as well. ``weight`` is the
    mean of the weights, which is 1 but for chance if trials are drawn wherever they may be wanted, and ``weight_sigma``
    its standard deviation.
    """

    n: int
    missed: int
    rate: float
    low: float
    high: float
    effective: float
    weight: float
    weight_sigma: float


def weighted_rate(missed: BoolArray, weights: FloatArray) -> WeightedRate:
    """Return the rate of misses (n,) of trials with weights (n,), p / q of the wanted and the drawn density.

    The rate is the sum of the weights of misses over n, a weighted sum of Poisson counts. Its interval is that of
    M. P. Fay and E. J. Feuer (Statistics in Medicine 16, 791, 1997): the upper end is for one miss more, of the largest
    weight that a trial has. With that of the misses alone it would leave out misses whose causes larger errors make no
    more frequent, of which few are seen.
    """
    n = len(weights)
    shares = weights[missed] / n
    rate, variance = float(shares.sum()), float(np.square(shares).sum())

    one_more = float(weights.max()) / n
    mean, spread = rate + one_more, variance + one_more**2
    high = spread / (2.0 * mean) * chi2.ppf(1.0 - _TAIL, 2.0 * mean**2 / spread)
    return WeightedRate(
        n,
        int(missed.sum()),
        rate,
        float(variance / (2.0 * rate) * chi2.ppf(_TAIL, 2.0 * rate**2 / variance)) if rate > 0.0 else 0.0,
        min(1.0, float(high)),
        float(weights.sum() ** 2 / np.square(weights).sum()),
        float(weights.mean()),
        float(weights.std(ddof=1) / np.sqrt(n)) if n > 1 else np.inf,
    )
