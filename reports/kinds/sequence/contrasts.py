"""Means of sequences against each other: ratios between estimators, and the reductions that a paper prints.

Trials are resampled whole, both errors of a trial together, so that what two estimators have in common cancels; where
sequences see images, whole sets of images are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.published import Comparison
from boresight.reports.run.clusters import clusters_of, groups, pooled_scenarios
from boresight.reports.run.data import RunData, select
from boresight.reports.schema.records import RATIO, REDUCTION, Record
from boresight.reports.statistics.intervals import interval_of_sums
from boresight.reports.statistics.measured import MEAN, MEDIAN, Measured, Sample
from boresight.reports.statistics.paired import BETTER, SIGN_TEST, sign_test
from boresight.scenarios.arrays import FloatArray

ERROR_RATIOS = {"error_after_1_ratio": "error_after_1_m", "error_after_2_ratio": "error_after_2_m"}
"""The error that each ratio of errors is of."""
_CYCLE_RATIO = {"cycle_seconds_ratio": "seconds"}
_ON = ["scenario", "trial"]


@dataclass(frozen=True, slots=True, eq=False)
class _PairedErrors:
    """Two errors (k, 2) of the same trials, where both are known, of the ``n`` trials that both have."""

    errors: FloatArray
    clusters: NDArray[np.generic]
    n: int

    @classmethod
    def of(cls, run: RunData, one: pd.DataFrame, other: pd.DataFrame, error: str, on: list[str]) -> _PairedErrors:
        """Join the rows of two estimators or scenarios, which have one for each trial."""
        # Not by pandas' merge, which takes 10 ms for a few rows: a run has hundreds of pairs.
        theirs = dict(zip(zip(*(other[name] for name in on), strict=True), other[error], strict=True))
        keys = list(zip(*(one[name] for name in on), strict=True))
        both = one.take([row for row, key in enumerate(keys) if key in theirs])
        errors = np.column_stack([both[error], [theirs[key] for key in keys if key in theirs]]).astype(np.float64)
        known = np.isfinite(errors).all(axis=1)
        return cls(errors[known], clusters_of(run, both.take(np.flatnonzero(known))), len(both))

    def measured(self, of_means: Callable[[FloatArray], FloatArray]) -> Measured:
        """Evaluate ``of_means`` of the two mean errors (..., 2)."""
        if len(self.errors) < 2:
            return Measured(None)
        numbers = np.column_stack([self.errors, np.ones(len(self.errors))])
        interval = interval_of_sums(numbers, self.clusters, lambda sums: of_means(sums[:, :2] / sums[:, 2:]))
        return Measured(float(of_means(self.errors.mean(axis=0))), *interval)


def _each_pair(
    run: RunData, table: pd.DataFrame, errors: Mapping[str, str]
) -> Iterator[tuple[Sample, str, _PairedErrors]]:
    """Yield the errors of every two estimators in each group of scenarios, by the names of their ratios.

    Scenarios that are pooled have none by themselves: the starts on one set of images say nothing of another.
    """
    pooled = pooled_scenarios(run)
    for name, members in groups(run):
        own = table[table["scenario"].isin(members if name not in pooled else ())]
        rows = {str(label): part[[*_ON, *errors.values()]] for label, part in own.groupby("estimator")}
        for one, other in permutations(rows, 2):
            for ratio, error in errors.items():
                both = _PairedErrors.of(run, rows[one], rows[other], error, _ON)
                yield Sample(name, one, RATIO, both.n, other), ratio, both


def ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean error of every estimator of sequences over that of every other one, on the same trials.

    Sign tests accompany it: each independent unit counts once, by the sign of its median difference.
    """
    for sample, name, both in _each_pair(run, run.rows, ERROR_RATIOS) if len(run.table("epochs")) else ():
        if len(both.errors):
            yield sample.record(name, MEAN.name, both.measured(_ratio), len(both.errors))
            share, chance, decided = sign_test(both.errors[:, 0] - both.errors[:, 1], both.clusters)
            yield sample.record(name, BETTER, share, decided)
            yield sample.record(name, SIGN_TEST, chance, decided)


def cycle_ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean cycle time of every estimator of sequences over that of every other one, trial by trial.

    The median over the trials: those in which a worker compiles a method take a hundred times as long.
    """
    cycles = run.table("timings")[run.table("timings")["stage"] == "cycle"]
    for sample, name, both in _each_pair(run, cycles, _CYCLE_RATIO) if len(run.table("epochs")) else ():
        if (both.errors > 0.0).all():  # a method tells its times itself, and may not measure them
            yield from sample.records(name, _ratio(both.errors), both.clusters, (MEDIAN,))


def reduction_records(run: RunData, comparison: Comparison) -> Iterator[Record]:
    """Work out the reductions that a paper prints: ``100 (1 - mean(e) / mean(e'))``.

    What is set against what: another scenario, or another estimator on the same one. The trials of two scenarios are
    not the same tracks: resampling them together is one way of pairing what is independent.
    """
    pairs = run.pairs()
    scenarios = {scenario for scenario, _ in pairs}
    for published in comparison.values:  # noqa: PD011  a tuple of published values, not a table
        for scenario, estimator in pairs if published.stage == REDUCTION else ():
            if estimator == published.estimator and published.scenario in ("", scenario):
                against = published.against
                other = (against, estimator) if against in scenarios else (scenario, against)
                if other in pairs:
                    mine, theirs = (select(run.rows, *pair) for pair in ((scenario, estimator), other))
                    error = f"{published.measure.removesuffix('_reduction')}_m"
                    both = _PairedErrors.of(run, mine, theirs, error, ["trial"])
                    sample = Sample(scenario, estimator, REDUCTION, both.n, against)
                    yield sample.record(published.measure, MEAN.name, both.measured(_reduction), len(both.errors))


def _ratio(means: FloatArray) -> FloatArray:
    return np.asarray(means[..., 0] / means[..., 1], dtype=np.float64)


def _reduction(means: FloatArray) -> FloatArray:
    return np.asarray(100.0 * (1.0 - _ratio(means)), dtype=np.float64)
