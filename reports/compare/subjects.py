"""Comparison of runs: statistics of every subject, and differences between subjects that differ in one factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.metrics import Metric, choose_metric
from boresight.reports.compare.pairs import (
    Contrast,
    holm_corrected,
    independent_contrast,
    paired_contrast,
    without_failures,
)
from boresight.reports.compare.trials import (
    ESTIMATOR,
    SCENARIO,
    all_factors,
    check_factors,
    check_pairs,
    tabulate_trials,
)
from boresight.reports.run.data import RunData, read_run
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.measured import (
    MEDIAN,
    P75,
    P95,
    P99,
    RMS,
    WORST,
    Measured,
    Statistic,
    bounded,
    measure,
    share_of,
)
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError

STATISTICS = (MEDIAN, RMS, P75, P95, P99)
DEFAULT_FACTORS = (ESTIMATOR, SCENARIO)
_QUANTILES = tuple(statistic for statistic in STATISTICS if statistic.quantile is not None)


@dataclass(frozen=True, slots=True)
class Subject:
    """One line of a comparison: its statistics, with and without failures.

    Parameters
    ----------
    names
        Its value of each factor.
    estimator
        Label of its estimator, '' where several are pooled.
    n_ok, n
        Trials with a value of the metric, and all.
    success
        Share of the trials that did not fail.
    solved
        Each of `STATISTICS` over the trials with a value.
    counted
        The same over all trials, a failure with the prior's error; where there is no prior, the quantiles alone, a
        failure worse than any error (infinite where the quantile falls among failures).
    at_prior
        Whether failures count with the prior's error.
    """

    names: tuple[str, ...]
    estimator: str
    n_ok: int
    n: int
    success: Measured
    solved: tuple[Measured, ...]
    counted: tuple[Measured, ...]
    at_prior: bool


@dataclass(frozen=True, eq=False)
class RunComparison:
    """Runs compared.

    Parameters
    ----------
    runs, metric, factors
        What is compared, by what, and what tells the subjects apart.
    trials
        Every trial, see `reports.compare.trials.tabulate_trials`.
    subjects, contrasts
        The lines, in the order of the runs; the differences, corrected.
    """

    runs: tuple[RunData, ...]
    metric: Metric
    factors: tuple[str, ...]
    trials: pd.DataFrame
    subjects: tuple[Subject, ...]
    contrasts: tuple[Contrast, ...]

    @cached_property
    def varied(self) -> tuple[str, ...]:
        """Factors of which there are several levels; the first one where there is only one subject."""
        levels = zip(self.factors, zip(*(one.names for one in self.subjects), strict=True), strict=True)
        several = tuple(factor for factor, own in levels if len(set(own)) > 1)
        return several or self.factors[:1]

    @property
    def shared(self) -> str:
        """Levels that all subjects share, as text."""
        first = self.subjects[0].names
        return ", ".join(name for factor, name in zip(self.factors, first, strict=True) if factor not in self.varied)

    def levels(self, names: Sequence[str]) -> tuple[str, ...]:
        """Keep the levels of the factors that vary."""
        return tuple(name for factor, name in zip(self.factors, names, strict=True) if factor in self.varied)

    def label(self, names: Sequence[str]) -> str:
        """Name a subject in figures."""
        return ", ".join(self.levels(names))

    def of(self, subject: Subject) -> pd.DataFrame:
        """Trials of a subject."""
        return _of(self.trials, self.factors, subject.names)


def compare_runs(
    folders: Sequence[Path],
    metric: str | None = None,
    factors: Sequence[str] = DEFAULT_FACTORS,
    unpaired: bool = False,
) -> RunComparison:
    """Compare estimators and scenarios of one run or of several.

    Parameters
    ----------
    folders
        The run folders.
    metric
        See `Metric`; by default the position error, of sequences after the last whole revolution.
    factors
        Factors that define the subjects: ``estimator``, ``scenario``, ``run`` or a key of the scenarios such as
        ``brdf`` or ``camera.fov_deg``. Trials that differ in other things are pooled.
    unpaired
        Whether subjects whose trials are not the same are compared as independent samples.

    Raises
    ------
    BoresightError
        If a run cannot be read, metric or factor is unknown, or the trials of two runs are not the same.
    """
    runs = tuple(read_run(folder) for folder in folders)
    check_factors(factors, runs)
    if not unpaired:
        check_pairs(runs)
    return compared(runs, choose_metric(metric, runs), factors, unpaired)


def compared(
    runs: tuple[RunData, ...], chosen: Metric, factors: Sequence[str] = DEFAULT_FACTORS, unpaired: bool = False
) -> RunComparison:
    """Compare runs that have been read and can be compared by these factors.

    Raises
    ------
    BoresightError
        If no trial has a value of the metric.
    """
    trials = tabulate_trials(runs, chosen, factors)
    own = all_factors(factors, trials)
    names = _in_order(trials, own, runs)
    subjects = tuple(_subject(_of(trials, own, one), one) for one in names)
    if all(subject.n_ok == 0 for subject in subjects):
        folders = ", ".join(str(run.folder) for run in runs)
        raise BoresightError(f"--metric {chosen.name}: no trial of {folders} has a value of it")
    pairs = [_contrast(trials, own, pair, unpaired) for pair in _pairs(subjects)]
    known = [one for one in pairs if one is not None]
    contrasts = known if chosen.is_error else [without_failures(one) for one in known]
    return RunComparison(runs, chosen, own, trials, subjects, tuple(holm_corrected(contrasts)))


def _in_order(trials: pd.DataFrame, factors: Sequence[str], runs: Sequence[RunData]) -> list[tuple[str, ...]]:
    """List the subjects: estimators in the order of their campaigns, all else as the runs have it."""
    labels = [str(label) for run in runs for label in run.manifest.estimators]
    order = {label: place for place, label in enumerate(dict.fromkeys(labels))}
    levels = trials.drop_duplicates(list(factors))
    ranked = levels.assign(place=levels["estimator"].map(order).fillna(len(order)))
    others = [factor for factor in factors if factor != ESTIMATOR]
    first_seen = {factor: {one: i for i, one in enumerate(trials[factor].unique())} for factor in others}
    keys = [ranked[factor].map(first_seen[factor]) for factor in others]
    sorted_rows = ranked.assign(**{f"by {i}": key for i, key in enumerate(keys)})
    sorted_rows = sorted_rows.sort_values([*(f"by {i}" for i in range(len(keys))), "place"], kind="stable")
    return list(sorted_rows[list(factors)].itertuples(index=False, name=None))


def _of(trials: pd.DataFrame, factors: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    mine = np.ones(len(trials), dtype=bool)
    for factor, name in zip(factors, names, strict=True):
        mine &= (trials[factor] == name).to_numpy()
    return trials[mine]


def _pairs(subjects: Sequence[Subject]) -> list[tuple[Subject, Subject]]:
    """Pair the subjects that differ in one factor alone; the control, which estimates nothing, is left out."""
    named = [subject for subject in subjects if subject.estimator != CONTROL]
    return [
        (one, other)
        for one, other in combinations(named, 2)
        if sum(a != b for a, b in zip(one.names, other.names, strict=True)) == 1
    ]


def _contrast(
    trials: pd.DataFrame, factors: Sequence[str], pair: tuple[Subject, Subject], unpaired: bool
) -> Contrast | None:
    """Set the later subject of a pair against the earlier one."""
    second, first = pair
    names = (first.names, second.names)
    tables = [_of(trials, factors, one) for one in names]
    found = paired_contrast(names, *tables)
    return independent_contrast(names, *tables) if found is None and unpaired else found


def _subject(rows: pd.DataFrame, names: tuple[str, ...]) -> Subject:
    values, clusters = rows["value"].to_numpy(dtype=np.float64), rows["cluster"].to_numpy()
    known = np.isfinite(values)
    prior = rows["prior"].to_numpy(dtype=np.float64)
    at_prior = bool(np.isfinite(prior[~known]).all()) and bool(np.isfinite(prior).any())
    labels = rows["estimator"].unique()
    return Subject(
        names,
        str(labels[0]) if len(labels) == 1 else "",
        int(known.sum()),
        len(rows),
        share_of(~rows["failed"].to_numpy(dtype=bool), clusters),
        tuple(measure(values[known], clusters[known], STATISTICS)),
        tuple(_counted(np.where(known, values, prior if at_prior else WORST), clusters, at_prior)),
        at_prior,
    )


def _counted(values: FloatArray, clusters: NDArray[np.generic], at_prior: bool) -> list[Measured]:
    """Evaluate over all trials; without a prior only quantiles are defined."""
    statistics: tuple[Statistic, ...] = STATISTICS if at_prior else _QUANTILES
    found = dict(zip(statistics, measure(values, clusters, statistics), strict=True))
    return [_bounded(found.get(statistic, Measured(None))) for statistic in STATISTICS]


def _bounded(measured: Measured) -> Measured:
    """Make quantiles that lie among the failures infinite."""
    ends = (measured.value, measured.low, measured.high)
    return Measured(*(None if end is None else bounded(end) for end in ends))
