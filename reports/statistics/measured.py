"""Statistics of errors with 95 % intervals, also where few trials are independent.

A whole cluster counts as one unit (a trial, every noise realisation of one real image, every start on one set of
images, or every trial with one data base), because its trials depend on each other. A quantile lies between two
order statistics, a mean is bounded by the bootstrap of its studentised value; `intervals` describes both, and how often
each interval held the truth in simulations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import units_of
from boresight.reports.schema.records import Record
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.intervals import has_quantile, interval_of_sums, quantile_interval, wilson
from boresight.scenarios.arrays import FloatArray

WORST = 1e150
"""Error assigned to a failure: above every error, and its square does not overflow."""


def bounded(value: float) -> float:
    """Return infinity for a quantile that lies among failures, or between a failure and an error."""
    return math.inf if value > 1e-6 * WORST else value


@dataclass(frozen=True, slots=True)
class Statistic:
    """A power mean or a power quantile: (reduce(x ** power)) ** (1 / power).

    ``name`` is printed in tables and in published values. ``quantile`` is in [0, 1], None for the mean; ``power`` is 1,
    or 2 for statistics of squares.
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
"""Name of the standard deviation of a sample, which is not a power mean."""
LEAST_SPREAD = 20
"""Clusters from which on a deviation has an interval."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A statistic, None where no value was measured, with the bounds of its 95 % interval.

    The bounds are None where there are too few independent units, and equal to the value for a counted fact.
    """

    value: float | None
    low: float | None = None
    high: float | None = None

    def each(self, of: Callable[[float], float]) -> Measured:
        """Apply a function that ascends to the value and to the ends of its interval."""
        return Measured(*(None if end is None else of(end) for end in (self.value, self.low, self.high)))

    @property
    def bar(self) -> tuple[float, float, float]:
        """Value and ends of its bar in a figure: the value itself without an interval, NaN without a value."""
        value = math.nan if self.value is None else self.value
        return value, value if self.low is None else self.low, value if self.high is None else self.high


def measure(values: FloatArray, clusters: NDArray[np.generic], statistics: Sequence[Statistic]) -> list[Measured]:
    """Evaluate statistics of finite values (n,) with their 95 % intervals; n may be 0.

    ``clusters`` (n,) label the unit that is independent of all others. A quantile beyond which less than one of the n
    values is expected has no value.
    """
    if len(values) == 0:
        return [Measured(None) for _ in statistics]
    codes, found = np.unique(clusters, return_inverse=True)[1], []
    for statistic in statistics:
        powers = values**statistic.power
        if statistic.quantile is None:
            sums, positive = np.column_stack([powers, np.ones(len(powers))]), bool((powers > 0).all())
            ends = interval_of_sums(sums, codes, lambda totals: totals[:, 0] / totals[:, 1], positive=positive)
        elif has_quantile(len(values), statistic.quantile):
            ends = quantile_interval(powers, codes, statistic.quantile)
        else:
            found.append(Measured(None))
            continue
        root = 1 / statistic.power
        roots = (end if end is None or root == 1 else float(max(end, 0.0) ** root) for end in ends)
        found.append(Measured(statistic.of(values), *roots))
    return found


def share_of(marked: NDArray[np.bool_], clusters: NDArray[np.generic] | None = None) -> Measured:
    """Share of marked trials with Wilson's interval, or with that of the clusters that they form if it is wider.

    Where none or all are marked, the correlation within clusters is unknown: the number is that of `units_of`.
    """
    if not len(marked):
        return Measured(None)
    share, alike = float(marked.mean()), clusters is not None and len(np.unique(marked)) == 1
    n = units_of(clusters) if clusters is not None and alike else len(marked)
    alone = Measured(share, *wilson(round(share * n), n))
    return widened(alone, marked.astype(np.float64), clusters, (0.0, 1.0))


def widened(
    alone: Measured, values: FloatArray, clusters: NDArray[np.generic] | None, ends: tuple[float, float]
) -> Measured:
    """Widen the interval of independent trials to that of their clusters; none where there is a single cluster."""
    if clusters is None or len(np.unique(clusters)) == len(values):
        return alone
    found = measure(values, clusters, (MEAN,))[0]
    if found.low is None or found.high is None or alone.low is None or alone.high is None:
        return Measured(alone.value)
    return Measured(alone.value, max(min(found.low, alone.low), ends[0]), min(max(found.high, alone.high), ends[1]))


def measure_share(part: FloatArray, whole: FloatArray, clusters: NDArray[np.generic]) -> Measured:
    """Return 100 sum(part) / sum(whole) with its interval, in percent; no value where there is nothing to share.

    For counts in images, such as craters, with images as the clusters; for trials use `share_of`.

    The interval is Wilson's for independent yes-or-no trials. It is also Wilson's, by the number of clusters, where
    none or all are a yes: what never happened in n clusters may happen in 3 / n of them (the rule of three).
    """
    if whole.sum() == 0.0:
        return Measured(None)
    share = float(part.sum() / whole.sum())
    n_clusters = len(np.unique(clusters))
    alike = n_clusters == len(whole) and bool((whole == 1.0).all())
    if alike or share in (0.0, 1.0):
        return Measured(100.0 * share, *(100.0 * end for end in wilson(round(share * n_clusters), n_clusters)))
    with np.errstate(divide="ignore", invalid="ignore"):
        counts = np.column_stack([part, whole])
        ends = interval_of_sums(counts, clusters, lambda sums: 100.0 * sums[:, 0] / sums[:, 1])
    return Measured(100.0 * share, *(None if end is None else min(max(end, 0.0), 100.0) for end in ends))


def measure_deviation(values: FloatArray, clusters: NDArray[np.generic]) -> Measured:
    """Return the standard deviation (with n - 1) of ``values`` (n,) with its interval, as `measure` does.

    There is no interval below `LEAST_SPREAD` clusters: of eight skewed errors it would hold the truth in 60 to 75 %
    of cases.
    """
    if len(values) < 2:
        return Measured(None)
    deviation = float(values.std(ddof=1))
    if len(np.unique(clusters)) < LEAST_SPREAD:
        return Measured(deviation)
    centred = values - values.mean()
    interval = interval_of_sums(
        np.stack([np.ones_like(centred), centred, centred**2], axis=1),
        clusters,
        lambda sums: np.sqrt(np.maximum(sums[:, 2] - sums[:, 1] ** 2 / sums[:, 0], 0.0) / (sums[:, 0] - 1.0)),
        positive=deviation > 0.0,
    )
    return Measured(deviation, *interval)


@dataclass(frozen=True, slots=True)
class Sample:
    """What some records are of, and the number n of its trials or other samples; ``unit`` None: that of a measure."""

    scenario: str
    estimator: str
    stage: str
    n: int
    reference: str = ""
    unit: str | None = None

    def record(self, name: str, statistic: str, measured: Measured, n_ok: int | None = None) -> Record:
        """Record a measured statistic; ``n_ok`` samples are behind it, without it all."""
        unit = unit_of(name) if self.unit is None else self.unit
        return Record(
            self.scenario, self.estimator, self.stage, self.reference, name, unit, statistic, measured.value,
            measured.low, measured.high, self.n if n_ok is None else n_ok, self.n,
        )  # fmt: skip

    def records(
        self, name: str, values: pd.Series | FloatArray, clusters: NDArray[np.generic], statistics: Sequence[Statistic]
    ) -> list[Record]:
        """Evaluate statistics over the finite ones of ``values`` (k,) in clusters (k,)."""
        numbers = np.asarray(values, dtype=np.float64)
        known = np.isfinite(numbers)
        measured = measure(numbers[known], clusters[known], statistics)
        n_ok = int(known.sum())
        return [self.record(name, s.name, m, n_ok) for s, m in zip(statistics, measured, strict=True)]

    def share(self, name: str, yes: NDArray[np.bool_], clusters: NDArray[np.generic]) -> Record:
        """Measure the share of the marked trials (k,), in percent."""
        return self.record(name, MEAN.name, percent(share_of(yes, clusters)), len(yes))


def percent(share: Measured) -> Measured:
    """Return a share in percent."""
    return share.each(lambda end: 100.0 * end)
