"""Measured numbers of a run: statistics with 95 % intervals, also where few trials are independent, as tidy records.

A whole cluster counts as one unit (a trial, every noise realisation of one real image, every start on one set of
images, or every trial with one data base), because its trials depend on each other. A quantile lies between two
order statistics, a mean is bounded by the bootstrap of its studentised value; `intervals` describes both, and how often
each interval held the truth in simulations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of, groups, units_of
from boresight.reports.run.data import RunData
from boresight.reports.run.outcomes import errors_by_stage, final_stage, succeeded
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.records import CONTROL, DIAGNOSTICS, FAILURES_AT_PRIOR, Record
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.intervals import has_quantile, interval_of_sums, quantile_interval, wilson
from boresight.scenarios.arrays import FloatArray

_FEW_VALUES = 100
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
    numbers, codes = np.asarray(values, dtype=np.float64), np.unique(clusters, return_inverse=True)[1]
    if len(numbers) > _FEW_VALUES:
        return _measure(numbers, codes, tuple(statistics))
    return list(_measured_before(numbers.tobytes(), codes.astype(np.int64).tobytes(), tuple(statistics)))


@lru_cache(maxsize=4096)
def _measured_before(values: bytes, codes: bytes, statistics: tuple[Statistic, ...]) -> list[Measured]:
    """Measure values that may have been measured before: a scenario's prior is that of all its estimators."""
    return _measure(np.frombuffer(values), np.frombuffer(codes, dtype=np.int64), statistics)


def _measure(values: FloatArray, codes: NDArray[np.integer], statistics: tuple[Statistic, ...]) -> list[Measured]:
    found = []
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


MIN_LANDMARKS = 4
"""Landmarks that fix a pose."""
_REDUCTIONS = {"position_reduction_m": POSE_COLUMNS[0], "attitude_reduction_deg": POSE_COLUMNS[1]}
_STATISTICS = {
    **dict.fromkeys(POSE_COLUMNS[:2], (MEDIAN, RMS, P75, P95)),
    **dict.fromkeys(POSE_COLUMNS[2:], (ROOT_MEDIAN_SQUARE, RMS)),
}


def measure_run(run: RunData) -> tuple[Record, ...]:
    """Measure what trials of all kinds may have, in the order of the report."""
    parts = (
        pose_measures, reference_measures, improvement_measures, landmark_measures, database_measures,
        diagnostic_measures, timing_measures,
    )  # fmt: skip
    return tuple(chain.from_iterable(part(run) for part in parts))


def table_records(
    run: RunData,
    table: pd.DataFrame,
    stage: str,
    statistics: Mapping[str, Sequence[Statistic]],
    pairs: Iterable[tuple[str, str]] | None = None,
) -> Iterator[Record]:
    """Measure columns of a table that has at most one row for each trial; n counts all trials.

    The table is of all scenarios and estimators, ``stage`` that of the records. ``statistics`` are by columns, in the
    order of the records. ``pairs`` are scenarios and estimators; without them all of the run.
    """
    of_pair = dict(list(table.groupby(["scenario", "estimator"], sort=False)))
    for scenario, estimator in run.pairs() if pairs is None else pairs:
        own = of_pair.get((scenario, estimator), table.iloc[:0])
        sample = Sample(scenario, estimator, stage, len(run.of(scenario, estimator)))
        clusters = clusters_of(run, own)
        for name, chosen in statistics.items():
            yield from sample.records(name, own[name], clusters, chosen)


def _pose_records(run: RunData, sample: Sample, errors: pd.DataFrame) -> Iterator[Record]:
    """Evaluate the statistics of the five pose errors of some trials."""
    clusters = clusters_of(run, errors)
    for name, statistics in _STATISTICS.items():
        yield from sample.records(name, errors[name], clusters, statistics)


def pose_measures(run: RunData) -> Iterator[Record]:
    """Measure pose errors after each stage, those with failures counted at the error of their prior, and success."""
    for scenario, estimator in run.posed_pairs():
        rows = run.of(scenario, estimator)
        stages = errors_by_stage(run, scenario, estimator)
        if estimator != CONTROL:
            ok, prior = (rows["status"] == "ok").to_numpy(), stages[CONTROL]
            at_prior = {name: np.where(ok, rows[name].to_numpy(), prior[name].to_numpy()) for name in POSE_COLUMNS}
            stages[FAILURES_AT_PRIOR] = pd.DataFrame({"estimator": estimator, "trial": prior["trial"], **at_prior})
        for stage, errors in stages.items():
            sample = Sample(scenario, estimator, stage, len(rows))
            yield from _pose_records(run, sample, errors.assign(scenario=scenario))
        if estimator != CONTROL:
            sample = Sample(scenario, estimator, final_stage(run, scenario, estimator), len(rows))
            yield sample.share("success_share", succeeded(rows), clusters_of(run, rows))


def _final_samples(run: RunData, pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[Sample, pd.DataFrame]]:
    """Yield the rows of each scenario and estimator, and what records on their final stage are of."""
    for scenario, estimator in pairs:
        rows = run.of(scenario, estimator)
        yield Sample(scenario, estimator, final_stage(run, scenario, estimator), len(rows)), rows


def reference_measures(run: RunData) -> Iterator[Record]:
    """Measure final pose errors against each further reference pose; those against the truth are measured elsewhere."""
    for sample, _ in _final_samples(run, run.pairs()):
        table = run.of(sample.scenario, sample.estimator, "references")
        # An estimator's errors against the truth are measured from its stages; the control has no stages.
        known = set() if sample.estimator == CONTROL else {run.truth_name(sample.scenario)}
        for reference in sorted(set(table["reference"]) - known):
            of_reference = replace(sample, reference=str(reference))
            yield from _pose_records(run, of_reference, table[table["reference"] == reference])


def improvement_measures(run: RunData) -> Iterator[Record]:
    """Measure prior error minus final error, trial by trial, over the trials that are ok (positive is better).

    Against the truth, and for real images against each further reference pose as well.
    """
    for sample, _ in _final_samples(run, (pair for pair in run.posed_pairs() if pair[1] != CONTROL)):
        ok = run.solved(sample.scenario, sample.estimator)
        prior = ok[["trial"]].assign(**{name: ok[f"prior_{name}"] for name in _REDUCTIONS.values()})
        yield from _reductions(run, sample, prior, ok)
        mine, control = (run.of(sample.scenario, name, "references") for name in (sample.estimator, CONTROL))
        for reference in sorted(set(mine["reference"]) - {run.truth_name(sample.scenario)}):
            final, before = (table[table["reference"] == reference] for table in (mine, control))
            yield from _reductions(run, replace(sample, reference=str(reference)), before, final)


def _reductions(run: RunData, sample: Sample, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Record]:
    """Measure how much smaller the errors of ``after`` are than those of ``before`` in the same trials."""
    prior = before.set_index("trial")
    for name, error in _REDUCTIONS.items():
        reduction = prior[error].reindex(after["trial"]).to_numpy() - after[error]
        yield from sample.records(name, reduction, clusters_of(run, after), (MEDIAN, MEAN))


def landmark_measures(run: RunData) -> Iterator[Record]:
    """Measure the number of landmarks an image, and the error of each recognised landmark."""
    for sample, rows in _final_samples(run, (pair for pair in run.pairs() if pair[1] != CONTROL)):
        if (run.solved(sample.scenario, sample.estimator)["n_landmarks"].to_numpy() > 0).any():
            ok = rows[(rows["status"] == "ok") & rows["n_landmarks"].notna()]
            yield from sample.records("n_landmarks", ok["n_landmarks"], clusters_of(run, ok), (MEDIAN, MEAN))
            enough = (rows["n_landmarks"].fillna(0.0) >= MIN_LANDMARKS).to_numpy()
            yield sample.share("four_landmarks_share", enough, clusters_of(run, rows))
        marks = run.of(sample.scenario, sample.estimator, "landmarks")
        if len(marks):
            sample, clusters = replace(sample, n=len(marks)), clusters_of(run, marks)
            yield sample.record("landmark_observations", "count", Measured(*3 * (len(marks),)))
            yield from sample.records("landmark_error_m", marks["error_m"], clusters, (MEDIAN, RMS, P95))
            yield from sample.records("chi_square", marks["chi_square"], clusters, (MEDIAN, MEAN))


def database_measures(run: RunData) -> Iterator[Record]:
    """Count the landmarks and facets of each data base, and its bytes as it is stored; of several, of the first.

    A single data base belongs to the single estimator of a run (the control apart), even if the manifest names none.
    """
    pairs = [pair for pair in run.pairs() if pair[1] != CONTROL]
    only = pairs[0] if len(pairs) == len(run.manifest.products) == 1 else ("", "")
    for product in (one for one in run.manifest.products if one.database == 0):
        sample = Sample(*((product.scenario, product.estimator) if product.scenario else only), "database", 1)
        counts = {"landmarks": product.n_landmarks, "facets": product.n_facets, "bytes": product.bytes}
        for name, count in counts.items():
            if count is not None:
                yield sample.record(f"database_{name}", "count", Measured(count, count, count))


def diagnostic_measures(run: RunData) -> Iterator[Record]:
    """Measure each number that an estimator reports of its trials, under the stage ``diagnostics``."""
    if run.table("diagnostics").empty:
        return
    for group, members in groups(run):
        own = run.table("diagnostics")[run.table("diagnostics")["scenario"].isin(members)]
        for (estimator, name), table in own.groupby(["estimator", "name"], sort=False):
            n = int((run.rows["scenario"].isin(members) & (run.rows["estimator"] == estimator)).sum())
            sample = Sample(group, str(estimator), DIAGNOSTICS, n)
            yield from sample.records(str(name), table["value"], clusters_of(run, table), (MEDIAN, MEAN, RMS, P95))


def timing_measures(run: RunData) -> Iterator[Record]:
    """Measure the wall time of each stage of a trial; n_ok counts the trials that have a time of it."""
    keys = ["scenario", "estimator", "stage", "trial"]
    totals = run.table("timings").groupby(keys, sort=False)[["seconds"]].sum().reset_index()
    places = totals.groupby("scenario", sort=False).indices
    counted = run.rows.groupby(["scenario", "estimator"], sort=False).size()
    for group, members in groups(run):
        own = totals.iloc[np.sort(np.concatenate([places.get(name, []) for name in members]).astype(int))]
        rows = counted.loc[list(members)].groupby("estimator").sum()
        for (estimator, stage), total in own.groupby(["estimator", "stage"], sort=False):
            sample = Sample(group, str(estimator), str(stage), int(rows.get(estimator, len(total))))
            yield from sample.records("seconds", total["seconds"], clusters_of(run, total), (MEDIAN, MEAN, P95))
