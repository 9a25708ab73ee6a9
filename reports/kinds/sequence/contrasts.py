"""Means of sequences against each other: ratios between estimators, and the reductions that a paper prints.

Trials are resampled whole, both errors of a trial together, so that what two estimators have in common cancels; where
sequences see images, whole sets of images are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.published import Comparison, PublishedValue
from boresight.reports.run.clusters import clusters_of, groups, pooled_scenarios
from boresight.reports.run.data import RunData, select
from boresight.reports.schema.records import RATIO, REDUCTION, Record
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.measured import MEAN, MEDIAN, Measured, cluster_interval, measure
from boresight.reports.statistics.paired import BETTER, SIGN_TEST, sign_test
from boresight.scenarios.arrays import FloatArray

Pair = tuple[str, str]
"""Scenario and estimator."""

ERROR_RATIOS = {"error_after_1_ratio": "error_after_1_m", "error_after_2_ratio": "error_after_2_m"}
"""The error that each ratio of errors is of."""
_CYCLE, _CYCLE_RATIO = "cycle", "cycle_seconds_ratio"


@dataclass(frozen=True, slots=True, eq=False)
class _ErrorTable:
    """One error of all estimators in a group of scenarios, side by side.

    Parameters
    ----------
    estimators
        Their labels.
    errors
        (n, E) of n trials; NaN where there is none.
    there
        (n, E) whether the trial was run at all.
    clusters
        (n,) what of the trials is independent.
    """

    estimators: list[str]
    errors: FloatArray
    there: NDArray[np.bool_]
    clusters: NDArray[np.generic]

    @classmethod
    def of(cls, run: RunData, rows: pd.DataFrame, error: str) -> _ErrorTable:
        """Lay out rows; lines are in their order."""
        one_each = rows.assign(there=1.0).set_index(["trial", "scenario", "estimator"])[[error, "there"]]
        laid = one_each.unstack()  # noqa: PD010  pivot_table would leave out lines without an error
        clusters = clusters_of(run, laid.index.to_frame(index=False))
        errors, there = (np.asarray(laid[name], dtype=np.float64) for name in (error, "there"))
        return cls([str(label) for label in laid["there"]], errors, np.isfinite(there), clusters)

    def both(self, one: str, other: str) -> _PairedErrors:
        """Take the trials of two estimators."""
        columns = [self.estimators.index(one), self.estimators.index(other)]
        errors = self.errors[:, columns]
        known = np.isfinite(errors).all(axis=1)
        return _PairedErrors(errors[known], self.clusters[known], int(self.there[:, columns].all(axis=1).sum()))


@dataclass(frozen=True, slots=True, eq=False)
class _PairedErrors:
    """Two errors of the same trials.

    Parameters
    ----------
    errors
        (n, 2) of the trials of which both are known.
    clusters
        (n,) what of them is independent.
    n
        Trials that both have, with and without an error.
    """

    errors: FloatArray
    clusters: NDArray[np.generic]
    n: int

    @classmethod
    def of(cls, run: RunData, one: pd.DataFrame, other: pd.DataFrame, error: str) -> _PairedErrors:
        """Join the rows of two scenarios by their trials."""
        both = one.merge(other[["trial", error]], on="trial", suffixes=("", "_other"))
        known = both[[error, f"{error}_other"]].notna().all(axis=1)
        errors = both.loc[known, [error, f"{error}_other"]].to_numpy(dtype=np.float64)
        return cls(errors, clusters_of(run, both[known]), len(both))

    def measured(self, of_means: Callable[[FloatArray], FloatArray]) -> Measured:
        """Evaluate ``of_means`` of the two mean errors (..., 2)."""
        if len(self.errors) < 2:
            return Measured(None)
        numbers = np.column_stack([self.errors, np.ones(len(self.errors))])
        interval = cluster_interval(numbers, self.clusters, lambda sums: of_means(sums[:, :2] / sums[:, 2:]))
        return Measured(float(of_means(self.errors.mean(axis=0))), *interval)


def ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean error of every estimator of sequences over that of every other one, on the same trials.

    Sign tests stand beside it, in which what is independent counts once, by the sign of its median difference.
    Scenarios that are pooled have none by themselves: the starts on one set of images say nothing of another.
    """
    if run.table("epochs").empty:
        return
    pooled = pooled_scenarios(run)
    for name, members in groups(run):
        if name in pooled:
            continue
        own = run.rows[run.rows["scenario"].isin(members)]
        sides = {ratio: _ErrorTable.of(run, own, error) for ratio, error in ERROR_RATIOS.items()}
        for one, other in permutations(dict.fromkeys(own["estimator"]), 2):
            for ratio, side in sides.items():
                both = side.both(one, other)
                if len(both.errors):
                    yield from _ratio_records(both, (name, one, other, ratio))


def cycle_ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean cycle time of every estimator of sequences over that of every other one, trial by trial.

    The median over the trials: those in which a worker compiles a method take a hundred times as long.
    """
    if run.table("epochs").empty:
        return
    pooled, cycles = pooled_scenarios(run), run.table("timings")[run.table("timings")["stage"] == _CYCLE]
    for name, members in groups(run):
        own = cycles[cycles["scenario"].isin(members)]
        if name in pooled or own.empty:
            continue
        side = _ErrorTable.of(run, own, "seconds")
        for one, other in permutations(side.estimators, 2):
            both = side.both(one, other)
            if not (both.errors > 0.0).all():  # a method tells its times itself, and may not measure them
                continue
            (measured,) = measure(_ratio(both.errors), both.clusters, (MEDIAN,))
            yield Record(
                name, one, RATIO, other, _CYCLE_RATIO, unit_of(_CYCLE_RATIO), MEDIAN.name, measured.value, measured.low,
                measured.high, len(both.errors), both.n,
            )  # fmt: skip


def _ratio_records(both: _PairedErrors, said: tuple[str, str, str, str]) -> Iterator[Record]:
    """Yield ratio and sign test; ``said``: group, estimator, the other one and the measure."""
    group, estimator, other, name = said

    def record(statistic: str, measured: Measured, n_ok: int) -> Record:
        return Record(
            group, estimator, RATIO, other, name, unit_of(name), statistic, measured.value, measured.low,
            measured.high, n_ok, both.n,
        )  # fmt: skip

    yield record(MEAN.name, both.measured(_ratio), len(both.errors))
    share, chance, decided = sign_test(both.errors[:, 0] - both.errors[:, 1], both.clusters)
    yield record(BETTER, share, decided)
    yield record(SIGN_TEST, chance, decided)


def reduction_records(run: RunData, comparison: Comparison) -> Iterator[Record]:
    """Work out the reductions that a paper prints: ``100 (1 - mean(e) / mean(e'))``.

    The trials of two scenarios are not the same tracks: resampling them together is one way of pairing what is
    independent.
    """
    for published in comparison.values:  # noqa: PD011  a tuple of published values, not a table
        if published.stage == REDUCTION:
            for one, other in _contrasted(run, published):
                yield _reduction_record(run, one, other, published)


def _contrasted(run: RunData, published: PublishedValue) -> Iterator[tuple[Pair, Pair]]:
    """List what is set against what: another scenario, or another estimator on the same one."""
    scenarios = {scenario for scenario, _ in run.pairs()}
    for scenario, estimator in run.pairs():
        if estimator == published.estimator and published.scenario in ("", scenario):
            other = (published.against, estimator) if published.against in scenarios else (scenario, published.against)
            if other in run.pairs():
                yield (scenario, estimator), other


def _reduction_record(run: RunData, one: Pair, other: Pair, published: PublishedValue) -> Record:
    error = f"{published.measure.removesuffix('_reduction')}_m"
    both = _PairedErrors.of(run, select(run.rows, *one), select(run.rows, *other), error)
    measured = both.measured(_reduction)
    return Record(
        *one, REDUCTION, published.against, published.measure, unit_of(published.measure), MEAN.name,
        measured.value, measured.low, measured.high, len(both.errors), both.n,
    )  # fmt: skip


def _ratio(means: FloatArray) -> FloatArray:
    return np.asarray(means[..., 0] / means[..., 1], dtype=np.float64)


def _reduction(means: FloatArray) -> FloatArray:
    return np.asarray(100.0 * (1.0 - _ratio(means)), dtype=np.float64)
