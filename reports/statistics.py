"""Statistics of errors, with bootstrap intervals that respect shared images.

The interval is the percentile bootstrap: a median is not smooth, so the jackknife that BCa needs is of no
help. Whole clusters are resampled (a trial, every noise realisation of one real image, or every start on one set of
images), because what they share makes their trials depend on each other. A percentile bootstrap of few clusters is
narrow: of ten it holds about 90 % where it says 95 %.

From 10,000 independent numbers on, resampling brings nothing and costs minutes: the interval of a quantile then
lies between two order statistics, that of a mean is its standard error's.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

FloatArray = NDArray[np.float64]

RESAMPLES = 2000
LEVEL = 0.95
LARGE = 10_000
_FEW = 500  # values, among which all are looked through sooner than they are searched
_CHUNK = 4_000_000  # numbers held at a time while resampling


WORST = 1e150
"""Stands for the error of a failure that has none: above every error, and its square is still a number."""


def bounded(value: float) -> float:
    """Call a quantile infinite that lies among failures, or between one and an error."""
    return math.inf if value > 1e-6 * WORST else value


@dataclass(frozen=True, slots=True)
class Statistic:
    """A power mean or a power quantile: (reduce(x ** power)) ** (1 / power).

    Parameters
    ----------
    name
        As printed in tables and in published values.
    quantile
        In [0, 1]; None for the mean.
    power
        1, or 2 for statistics of squares.
    """

    name: str
    quantile: float | None
    power: int = 1

    def of(self, values: FloatArray) -> float:
        """Evaluate over ``values`` (n,), n >= 1, all finite."""
        powers = values**self.power
        reduced = np.mean(powers) if self.quantile is None else np.quantile(powers, self.quantile)
        return float(reduced ** (1 / self.power))


MEDIAN = Statistic("median", 0.5)
MEAN = Statistic("mean", None)
RMS = Statistic("RMS", None, power=2)
ROOT_MEDIAN_SQUARE = Statistic("root-median-square", 0.5, power=2)
P75 = Statistic("75th percentile", 0.75)
P95 = Statistic("95th percentile", 0.95)
P99 = Statistic("99th percentile", 0.99)
DEVIATION = "deviation"
"""Name of the standard deviation of a sample, which is no power mean."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A statistic with its interval.

    Parameters
    ----------
    value
        None where no value was measured.
    low, high
        Bounds of the 95 % interval; None below two clusters. Equal to ``value`` for a counted fact.
    """

    value: float | None
    low: float | None = None
    high: float | None = None


def measure(values: FloatArray, clusters: NDArray[np.generic], statistics: Sequence[Statistic]) -> list[Measured]:
    """Evaluate statistics with their 95 % percentile-bootstrap intervals.

    Parameters
    ----------
    values
        (n,) finite numbers; n may be 0.
    clusters
        (n,) label of the unit that is resampled as a whole.
    statistics
        What to evaluate; all share the same resamples.
    """
    if len(values) == 0:
        return [Measured(None) for _ in statistics]
    points = [statistic.of(values) for statistic in statistics]
    codes = np.unique(clusters, return_inverse=True)[1]
    if codes.max() == 0:
        return [Measured(point) for point in points]
    if codes.max() + 1 == len(values) >= LARGE:
        return [Measured(p, *large_sample_interval(values, s)) for p, s in zip(points, statistics, strict=True)]
    draws = bootstrap(values, codes, statistics, content_rng(values, codes))
    tail = 50.0 * (1.0 - LEVEL)
    bounds = np.percentile(draws, [tail, 100.0 - tail], axis=1)
    return [Measured(p, float(low), float(high)) for p, low, high in zip(points, *bounds, strict=True)]


def measure_deviation(values: FloatArray, clusters: NDArray[np.generic]) -> Measured:
    """Return the standard deviation (with n - 1) of ``values`` (n,) with its interval, as `measure` does."""
    if len(values) < 2:
        return Measured(None)
    deviation = float(values.std(ddof=1))
    centred = values - values.mean()
    interval = cluster_interval(
        np.stack([np.ones_like(centred), centred, centred**2], axis=1),
        clusters,
        lambda sums: np.sqrt(np.maximum(sums[:, 2] - sums[:, 1] ** 2 / sums[:, 0], 0.0) / (sums[:, 0] - 1.0)),
    )
    return Measured(deviation, *interval)


def cluster_interval(
    numbers: FloatArray, clusters: NDArray[np.generic], of_sums: Callable[[FloatArray], FloatArray]
) -> tuple[float, float] | tuple[None, None]:
    """Bound a function of sums at the 95 % level by the percentile bootstrap of whole clusters.

    Parameters
    ----------
    numbers
        (n, k) finite numbers.
    clusters
        (n,) label of the unit that is resampled as a whole.
    of_sums
        Takes the sums (B, k) of resamples to (B,).

    Returns
    -------
    low, high
        None below two clusters.
    """
    codes = np.unique(clusters, return_inverse=True)[1]
    if not len(codes) or codes.max() == 0:
        return None, None
    sums = np.zeros((int(codes.max()) + 1, numbers.shape[1]))
    np.add.at(sums, codes, numbers)
    counts = draw_counts(len(sums), RESAMPLES, content_rng(numbers, codes))
    low, high = np.percentile(of_sums(counts @ sums), [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)])
    return float(low), float(high)


def large_sample_interval(values: FloatArray, statistic: Statistic) -> tuple[float, float]:
    """Bound a statistic of many independent ``values`` (n,) at the 95 % level, without resampling.

    The rank of a quantile q is binomial, nearly normal with variance n q (1 - q); a mean is nearly normal.
    """
    powers, n, wide = values**statistic.power, len(values), float(ndtri(0.5 * (1.0 + LEVEL)))
    if statistic.quantile is None:
        half = wide * float(np.std(powers, ddof=1)) / np.sqrt(n)
        low, high = float(powers.mean()) - half, float(powers.mean()) + half
    else:
        spread = wide * np.sqrt(n * statistic.quantile * (1.0 - statistic.quantile))
        ranks = np.array([np.floor(n * statistic.quantile - spread) - 1.0, np.ceil(n * statistic.quantile + spread)])
        below, above = np.clip(ranks, 0, n - 1).astype(np.intp)
        ordered = np.partition(powers, [below, above])
        low, high = float(ordered[below]), float(ordered[above])
    if statistic.power == 1:
        return low, high
    return max(low, 0.0) ** (1 / statistic.power), high ** (1 / statistic.power)


def content_rng(*arrays: NDArray[np.generic]) -> np.random.Generator:
    """Seed a generator by the bytes of ``arrays``, so that the same rows give the same interval."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return np.random.default_rng(int.from_bytes(digest.digest(), "little"))


def bootstrap(
    values: FloatArray,
    codes: NDArray[np.integer],
    statistics: Sequence[Statistic],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> FloatArray:
    """Draw the bootstrap distribution of statistics under resampling of clusters.

    Parameters
    ----------
    values, codes
        (n,) numbers and their cluster numbers 0..C-1.
    statistics
        S of them.
    rng
        Source of the resamples.
    resamples
        B.

    Returns
    -------
    draws
        (S, B) values of each statistic.
    """
    n_clusters = int(codes.max()) + 1
    sample = ClusteredSample(values, codes)
    block = max(1, min(resamples, _CHUNK // max(len(values), n_clusters)))
    parts = []
    for start in range(0, resamples, block):
        counts = draw_counts(n_clusters, min(block, resamples - start), rng)
        parts.append(sample.evaluate(counts, statistics))
    return np.concatenate(parts, axis=1)


def draw_counts(n_clusters: int, resamples: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """Draw (b, C) numbers of times that each cluster is in a resample of C clusters."""
    drawn = rng.integers(0, n_clusters, size=(resamples, n_clusters))
    drawn += n_clusters * np.arange(resamples)[:, None]
    counts = np.bincount(drawn.ravel(), minlength=resamples * n_clusters)
    return counts.reshape(resamples, n_clusters).astype(np.int32)


class ClusteredSample:
    """Numbers in clusters, sorted once, so that statistics of many resamples cost no sorting and no copying.

    Parameters
    ----------
    values, codes
        (n,) numbers and their cluster numbers 0..C-1.
    """

    def __init__(self, values: FloatArray, codes: NDArray[np.integer]) -> None:
        self._values = values
        self._codes = codes
        self._orders = {1: np.argsort(values, kind="stable"), 2: np.argsort(np.abs(values), kind="stable")}
        # Without negative numbers the squares ascend in the same order, and one pass serves both.
        self._order_of = {1: 1, 2: 2 if np.any(values < 0) else 1}

    def evaluate(self, counts: NDArray[np.int32], statistics: Sequence[Statistic]) -> FloatArray:
        """Evaluate statistics of samples in which cluster c occurs ``counts[b, c]`` times.

        Parameters
        ----------
        counts
            (b, C), at least one value in each row.
        statistics
            S of them, each evaluated as `Statistic.of` would on the repeated sample.

        Returns
        -------
        evaluated
            (S, b).
        """
        cumulative: dict[int, NDArray[np.int32]] = {}
        evaluated = []
        for statistic in statistics:
            if statistic.quantile is None:
                reduced = self._mean(counts, statistic.power)
            else:
                key = self._order_of[statistic.power]
                order = self._orders[key]
                if key not in cumulative:
                    # An index in brackets would lay out columns, along which sums take three times as long.
                    cumulative[key] = np.cumsum(np.take(counts, self._codes[order], axis=1), axis=1, dtype=np.int32)
                ascending = self._values[order] ** statistic.power
                reduced = _quantile_of_counted(ascending, cumulative[key], statistic.quantile)
            evaluated.append(reduced ** (1 / statistic.power))
        return np.array(evaluated, dtype=np.float64)

    def _mean(self, counts: NDArray[np.int32], power: int) -> FloatArray:
        sums = np.bincount(self._codes, self._values**power, minlength=counts.shape[1])
        sizes = np.bincount(self._codes, minlength=counts.shape[1])
        weights = counts.astype(np.float64)  # products of whole numbers of another type have no fast path
        return np.asarray((weights @ sums) / (weights @ sizes.astype(np.float64)), dtype=np.float64)


def _quantile_of_counted(ascending: FloatArray, cumulative: NDArray[np.int32], quantile: float) -> FloatArray:
    """Quantiles, by numpy's linear rule, of samples given by the cumulative counts (b, n) of their sorted values."""
    position = (cumulative[:, -1] - 1) * quantile
    below = np.floor(position)
    # Of the type of the counts: searchsorted would copy each row to another type.
    ranks = np.stack([below, np.ceil(position)], axis=1).astype(cumulative.dtype)
    low, high = ascending[_rank_places(cumulative, ranks)].T
    return np.asarray(low + (high - low) * (position - below), dtype=np.float64)


def _rank_places(cumulative: NDArray[np.int32], ranks: NDArray[np.int32]) -> NDArray[np.intp]:
    """Places (b, k) of ranks (b, k), from 0, in samples given by cumulative counts (b, n) of their sorted values."""
    if cumulative.shape[1] < _FEW:
        return np.asarray(np.count_nonzero(cumulative[:, None] <= ranks[..., None], axis=2))
    return np.array([np.searchsorted(row, rank, side="right") for row, rank in zip(cumulative, ranks, strict=True)])
