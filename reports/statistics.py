"""Statistics of errors, with bootstrap intervals that respect shared images.

The interval is the percentile bootstrap: a median is not smooth, so the jackknife that BCa needs is of no
help. Whole clusters are resampled (a trial, or every noise realisation of one real image), because the
realisations of one image share its difficulty and are not independent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RESAMPLES = 2000
LEVEL = 0.95
_CHUNK = 4_000_000  # numbers held at a time while resampling


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
    draws = bootstrap(values, codes, statistics, content_rng(values, codes))
    tail = 50.0 * (1.0 - LEVEL)
    bounds = np.percentile(draws, [tail, 100.0 - tail], axis=1)
    return [Measured(p, float(low), float(high)) for p, low, high in zip(points, *bounds, strict=True)]


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
    order = np.argsort(np.abs(values), kind="stable")  # sorts the squares
    ordered = np.argsort(values, kind="stable")
    parts = []
    for counts in _resampled_counts(int(codes.max()) + 1, len(values), resamples, rng):
        part = []
        for statistic in statistics:
            index = order if statistic.power == 2 else ordered
            part.append(weighted_statistic(values[index], counts[:, codes[index]], statistic))
        parts.append(part)
    return np.concatenate(parts, axis=1)


def _resampled_counts(
    n_clusters: int, n_values: int, resamples: int, rng: np.random.Generator
) -> Iterator[NDArray[np.int64]]:
    """Yield (b, C) numbers of times that each cluster was drawn, in blocks that fit in memory."""
    block = max(1, min(resamples, _CHUNK // max(n_values, n_clusters)))
    for start in range(0, resamples, block):
        size = min(block, resamples - start)
        drawn = rng.integers(0, n_clusters, size=(size, n_clusters)) + n_clusters * np.arange(size)[:, None]
        yield np.bincount(drawn.ravel(), minlength=size * n_clusters).reshape(size, n_clusters)


def weighted_statistic(values: FloatArray, counts: NDArray[np.integer], statistic: Statistic) -> FloatArray:
    """Evaluate a statistic of samples in which ``values[i]`` occurs ``counts[b, i]`` times.

    Parameters
    ----------
    values
        (n,) sorted so that ``values ** power`` ascends.
    counts
        (b, n) occurrences, at least one in each row.
    statistic
        Evaluated as `Statistic.of` would on each repeated sample.

    Returns
    -------
    evaluated
        (b,).
    """
    powers = values**statistic.power
    if statistic.quantile is None:
        reduced = (counts @ powers) / counts.sum(axis=1)
    else:
        reduced = _weighted_quantile(powers, counts, statistic.quantile)
    return np.asarray(reduced ** (1 / statistic.power), dtype=np.float64)


def _weighted_quantile(ascending: FloatArray, counts: NDArray[np.integer], quantile: float) -> FloatArray:
    """Quantiles of repeated samples by numpy's linear rule, without repeating them."""
    cumulative = np.cumsum(counts, axis=1)
    position = (cumulative[:, -1] - 1) * quantile
    below = np.floor(position).astype(np.int64)
    ranks = np.stack([below, np.ceil(position).astype(np.int64)], axis=1)
    index = np.array([np.searchsorted(c, r, side="right") for c, r in zip(cumulative, ranks, strict=True)])
    low, high = ascending[index].T
    return np.asarray(low + (high - low) * (position - below), dtype=np.float64)
