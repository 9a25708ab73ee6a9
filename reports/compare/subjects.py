"""Comparison of runs: statistics of every subject, and differences between subjects that differ in one factor.

Differences are paired by trial where trials are the same, else between independent samples. Among tests of many pairs
some are significant by chance alone. Holm's correction (S. Holm, A simple sequentially rejective multiple test
procedure, Scandinavian Journal of Statistics 6, 1979) keeps the probability of a single false finding in the whole
table at the level of one test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from boresight.reports.compare.trials import (
    ESTIMATOR,
    KEY,
    RUN,
    SCENARIO,
    check_factors,
    check_pairs,
    choose_metric,
    default_factors,
    tabulate_trials,
)
from boresight.reports.figures.style import PlotStyle, plot_styles
from boresight.reports.run.data import RunData, read_run
from boresight.reports.schema.column import Measure
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.measured import (
    MEAN,
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
from boresight.reports.statistics.paired import rate_difference, sign_test
from boresight.scenarios.errors import BoresightError

MOST_PAIRS = 5_000
"""Pairs up to which all subjects that differ in one factor are compared; of more, each with the first of them."""


@dataclass(frozen=True, slots=True)
class Contrast:
    """Difference between two subjects, which are named by their factors, trial by trial if it is ``paired``.

    ``n_both`` trials are solved by both, of the ``n`` that both have; of independent samples these are the solved
    trials of the first and of the second. ``median`` and ``mean`` are of the differences, first minus second, over the
    trials that both solved; of independent samples they are differences of medians and of means.

    ``better`` is the share of trials in which the first is better, ``p`` that of the test that either is as often the
    better. ``better_of_all`` and ``p_of_all`` are the same over all trials: who fails loses against who does not, and
    two failures decide nothing. ``failures`` is the difference of the failure rates. ``p_holm`` and ``p_of_all_holm``
    are corrected over the table. ``equal`` counts the trials that both solved with the same value; it is 0 of
    independent samples.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    paired: bool
    n_both: int
    n: int
    median: Measured
    mean: Measured
    better: Measured
    p: float | None
    better_of_all: Measured
    p_of_all: float | None
    failures: Measured
    p_holm: float | None = None
    p_of_all_holm: float | None = None
    equal: int = 0


def holm(chances: Sequence[float | None]) -> list[float | None]:
    """Correct p values of m tests: the k-th smallest times m - k + 1, never below a smaller one's, at most 1.

    Where one is None there is no test.
    """
    given = np.array(chances, dtype=np.float64)  # None is NaN
    tests = np.flatnonzero(np.isfinite(given))
    order = tests[np.argsort(given[tests], kind="stable")]
    given[order] = np.minimum(np.maximum.accumulate(given[order] * np.arange(len(order), 0, -1)), 1.0)
    return [None if math.isnan(p) else float(p) for p in given]


def holm_corrected(contrasts: Sequence[Contrast]) -> list[Contrast]:
    """Correct the p of all tests of a table, those over the trials that both solved and those over all trials."""
    found = holm([p for one in contrasts for p in (one.p, one.p_of_all)])
    corrected = zip(contrasts, found[::2], found[1::2], strict=True)
    return [replace(one, p_holm=solved, p_of_all_holm=of_all) for one, solved, of_all in corrected]


def paired_contrast(
    names: tuple[tuple[str, ...], tuple[str, ...]], one: pd.DataFrame, other: pd.DataFrame
) -> Contrast | None:
    """Compare two subjects trial by trial; None where they share no trial."""
    both = one.merge(other, on=KEY, suffixes=("", "_other"))
    if both.empty:
        return None
    difference = (both["value"] - both["value_other"]).to_numpy(dtype=np.float64)
    # One side may share few data bases: the clusters of the side with fewer of them are what is independent.
    coarser = "cluster" if both["cluster"].nunique() <= both["cluster_other"].nunique() else "cluster_other"
    clusters, solved = both[coarser].to_numpy(), np.isfinite(difference)
    median, mean = measure(difference[solved], clusters[solved], (MEDIAN, MEAN))
    better, chance, _ = sign_test(difference[solved], clusters[solved])
    mine, theirs = both["failed"].to_numpy(dtype=bool), both["failed_other"].to_numpy(dtype=bool)
    # A failure is worse than any success, and two failures are a tie.
    of_all = np.where(mine | theirs, mine.astype(float) - theirs.astype(float), np.nan_to_num(difference))
    better_of_all, chance_of_all, _ = sign_test(of_all, clusters)
    return Contrast(
        *names, True, int(solved.sum()), len(both), median, mean, better, chance.value, better_of_all,
        chance_of_all.value, rate_difference(mine, theirs, clusters), equal=int((difference == 0.0).sum()),
    )  # fmt: skip


def independent_contrast(
    names: tuple[tuple[str, ...], tuple[str, ...]], one: pd.DataFrame, other: pd.DataFrame
) -> Contrast:
    """Compare two subjects as independent samples, by the test of Mann and Whitney."""
    tables, solved = (one, other), [table[table["value"].notna()] for table in (one, other)]
    statistics = [
        measure(table["value"].to_numpy(dtype=np.float64), table["cluster"].to_numpy(), (MEDIAN, MEAN))
        for table in solved
    ]
    median, mean = (_difference(*ends) for ends in zip(*statistics, strict=True))
    worst = max((float(table["value"].max()) for table in solved if len(table)), default=0.0) + 1.0
    better, p = _superiority([table["value"].groupby(table["cluster"]).median() for table in solved])
    better_of_all, p_of_all = _superiority(
        [table["value"].where(~table["failed"], worst).groupby(table["cluster"]).median() for table in tables]
    )
    rates = [share_of(table["failed"].to_numpy(dtype=bool), table["cluster"].to_numpy()) for table in tables]
    return Contrast(
        *names, False, len(solved[0]), len(solved[1]), median, mean, better, p, better_of_all, p_of_all,
        _difference(*rates),
    )  # fmt: skip


def _superiority(samples: Sequence[pd.Series]) -> tuple[Measured, float | None]:
    """Chance that one of the first sample is better than one of the second (ties count half), and the test's p."""
    one, other = samples
    if not len(one) or not len(other):
        return Measured(None), None
    # Imported here, as it takes 1 s and paired comparisons need none of it.
    from scipy.stats import mannwhitneyu

    found = mannwhitneyu(one, other)
    return Measured(1.0 - float(found.statistic) / (len(one) * len(other))), float(found.pvalue)


def _difference(one: Measured, other: Measured) -> Measured:
    """Subtract two independent numbers; either end is as far off as their own ends are, added as squares.

    G. Zou and A. Donner, Construction of confidence limits about effect measures, Statistics in Medicine 27, 2008. Of
    two shares with Wilson's ends this is method 10 of R. Newcombe, Interval estimation for the difference between
    independent proportions, Statistics in Medicine 17, 1998. Where trials form clusters, as by a data base, the ends of
    each share are those of the clusters if these are wider (`share_of`).

    Coverage of the truth, in %, for shares of 2 % and 5 %, summed over all outcomes: 98.7 of 40 and 40 trials, 96.8 of
    100 and 100, 95.3 of 500 and 500; for 5 % and 20 %, 96.0 of 40 and 40. With five data bases on either side, whose
    shares are correlated by 0.05, of 600 samples each: 95.3 with 20 trials for each data base, 93.2 with 100.
    """
    if one.value is None or other.value is None:
        return Measured(None)
    value = one.value - other.value
    if one.low is None or one.high is None or other.low is None or other.high is None:
        return Measured(value)
    below = math.hypot(one.value - one.low, other.high - other.value)
    above = math.hypot(one.high - one.value, other.value - other.low)
    return Measured(value, value - below, value + above)


STATISTICS = (MEDIAN, RMS, P75, P95, P99)


@dataclass(frozen=True, slots=True)
class Subject:
    """One line of a comparison: its statistics, with and without failures.

    ``names`` are its values of the factors; ``estimator`` is '' where several are pooled. ``n_ok`` of ``n`` trials have
    a value of the metric, and ``success`` is the share that did not fail. ``prior`` is the median of the same number of
    the priors; None where there are none. ``solved`` has each of `STATISTICS` over the trials with a value, ``counted``
    over all trials: a failure counts with the prior's error (``at_prior``). Where there is no prior, ``counted`` has
    the quantiles alone, a failure being worse than any error: infinite where the quantile falls among failures.
    """

    names: tuple[str, ...]
    estimator: str
    n_ok: int
    n: int
    success: Measured
    prior: float | None
    solved: tuple[Measured, ...]
    counted: tuple[Measured, ...]
    at_prior: bool


@dataclass(frozen=True, eq=False)
class RunComparison:
    """Runs compared by a metric; the factors tell the subjects apart.

    ``trials`` are those of `reports.compare.trials.tabulate_trials`, ``subjects`` the lines in the order of the runs,
    ``contrasts`` the differences with corrected p.
    """

    runs: tuple[RunData, ...]
    metric: Measure
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

    def levels(self, names: Sequence[str]) -> dict[str, str]:
        """Return a subject's levels of the factors that vary."""
        return {factor: name for factor, name in zip(self.factors, names, strict=True) if factor in self.varied}

    def label(self, names: Sequence[str]) -> str:
        """Name a subject in figures."""
        return ", ".join(self.levels(names).values())

    def of(self, subject: Subject) -> pd.DataFrame:
        """Trials of a subject."""
        own: pd.DataFrame = self.trials.iloc[self._places[subject.names]]
        return own

    @cached_property
    def _places(self) -> Mapping[tuple[Any, ...], Any]:
        return _places(self.trials, self.factors)

    @cached_property
    def styles(self) -> dict[tuple[str, ...], PlotStyle]:
        """Style of each subject: that of its estimator, or its own where estimators are pooled."""
        keys = [one.estimator or self.label(one.names) for one in self.subjects]
        drawn = plot_styles(keys)
        return {one.names: drawn[key] for one, key in zip(self.subjects, keys, strict=True)}

    @cached_property
    def groups(self) -> dict[str, dict[str, Subject]]:
        """Subjects that differ in the estimator alone, by label, in groups by name; all in one where it is pooled."""
        gathered: dict[str, dict[str, Subject]] = {}
        for one in self.subjects:
            named = dict(zip(self.factors, one.names, strict=True))
            label = named.pop(ESTIMATOR, self.label(one.names))
            kept = [level for factor, level in named.items() if factor in self.varied and ESTIMATOR in self.factors]
            gathered.setdefault(", ".join(kept), {})[label] = one
        return gathered

    @property
    def credits(self) -> list[str]:
        """Credit lines of all runs, each once."""
        return list(dict.fromkeys(line for run in self.runs for line in run.manifest.credits))


def compare_runs(
    folders: Sequence[Path], metric: str | None = None, factors: Sequence[str] | None = None, unpaired: bool = False
) -> RunComparison:
    """Compare estimators and scenarios of one run or of several.

    ``metric`` names a number of each trial: by default the position error, of sequences after the last whole
    revolution. ``factors`` define the subjects: ``estimator``, ``scenario``, ``run`` or a key of the scenarios such as
    ``brdf`` or ``camera.fov_deg``; trials that differ in other things are pooled. By default they are estimator and
    scenario, and the run where several runs have the same ones. With ``unpaired``, subjects whose trials are not the
    same are compared as independent samples.

    Raises `BoresightError` if a run cannot be read, metric or factor is unknown, or the trials of two runs are not the
    same.
    """
    runs = tuple(read_run(folder) for folder in folders)
    check_factors(factors or (), runs)
    if not unpaired:
        check_pairs(runs)
    return compared(runs, choose_metric(metric, runs), factors, unpaired)


def compared(
    runs: tuple[RunData, ...], chosen: Measure, factors: Sequence[str] | None = None, unpaired: bool = False
) -> RunComparison:
    """Compare runs that have been read and can be compared by these factors.

    Raises `BoresightError` if no trial has a value of the metric.
    """
    trials = tabulate_trials(runs, chosen, factors or (ESTIMATOR, SCENARIO))
    own = tuple(factors or default_factors(trials))
    if RUN not in own and trials.duplicated([*own, *KEY]).any():
        own = (RUN, *own)  # several runs have the same trials of a subject
    places = _places(trials, own)
    subjects = tuple(subject_of(trials.iloc[places[one]], one) for one in _in_order(trials, own, runs))
    if all(subject.n_ok == 0 for subject in subjects):
        folders = ", ".join(str(run.folder) for run in runs)
        raise BoresightError(f"--metric {chosen.name}: no trial of {folders} has a value of it")
    contrasts = []
    for first, second in one_factor_apart(subjects):
        names = (first.names, second.names)
        tables = [trials.iloc[places[one]] for one in names]
        found = paired_contrast(names, *tables)
        if found is None and unpaired:
            found = independent_contrast(names, *tables)
        if found is not None and not chosen.error:  # a failure is neither more nor less
            found = replace(found, better_of_all=Measured(None), p_of_all=None)
        contrasts += [] if found is None else [found]
    return RunComparison(runs, chosen, own, trials, subjects, tuple(holm_corrected(contrasts)))


def one_factor_apart(subjects: Sequence[Subject]) -> list[tuple[Subject, Subject]]:
    """List the pairs of subjects that differ in one factor alone, without the control, which estimates nothing.

    Where there are more than `MOST_PAIRS`, each is paired with the first alone of those that differ in that factor.
    """
    alike = _alike(subjects)
    shown = 1 if has_too_many_pairs(subjects) else None
    pairs = [(second, first) for places in alike for second in places[:shown] for first in places if first > second]
    return [(subjects[first], subjects[second]) for second, first in sorted(pairs)]


def has_too_many_pairs(subjects: Sequence[Subject]) -> bool:
    """Return whether more than `MOST_PAIRS` pairs of subjects differ in one factor alone."""
    return sum(len(places) * (len(places) - 1) // 2 for places in _alike(subjects)) > MOST_PAIRS


def _alike(subjects: Sequence[Subject]) -> list[list[int]]:
    """Group the numbers of subjects that differ in one factor alone, by that factor; the control is left out."""
    alike: dict[tuple[int, tuple[str, ...]], list[int]] = {}
    for place, one in enumerate(subjects):
        for k in range(len(one.names)) if one.estimator != CONTROL else ():
            alike.setdefault((k, one.names[:k] + one.names[k + 1 :]), []).append(place)
    return list(alike.values())


def _in_order(trials: pd.DataFrame, factors: Sequence[str], runs: Sequence[RunData]) -> list[tuple[str, ...]]:
    """List the subjects: estimators in the order of their campaigns, all else as the runs have it."""
    labels = dict.fromkeys(str(label) for run in runs for label in run.manifest.estimators)
    order = {ESTIMATOR: list(labels)} | {one: list(trials[one].unique()) for one in factors if one != ESTIMATOR}
    subjects = trials.drop_duplicates(list(factors))[list(factors)]
    # The estimator is the last key of the order, one that no campaign names comes after all others.
    keys = sorted(factors, key=lambda one: one == ESTIMATOR)
    places = [
        [order[one].index(level) if level in order[one] else len(order[one]) for level in subjects[one]] for one in keys
    ]
    ranked = sorted(zip(*places, subjects.itertuples(index=False, name=None), strict=True), key=lambda line: line[:-1])
    return [line[-1] for line in ranked]


def _places(trials: pd.DataFrame, factors: Sequence[str]) -> Mapping[tuple[Any, ...], Any]:
    """Return the numbers of the lines of each subject, by its levels of the factors."""
    found = trials.groupby(list(factors), sort=False).indices
    return {key if isinstance(key, tuple) else (key,): places for key, places in found.items()}


def subject_of(rows: pd.DataFrame, names: tuple[str, ...], statistics: Sequence[Statistic] = STATISTICS) -> Subject:
    """Measure the trials of a subject, rows of `reports.compare.trials.tabulate_trials`, by some statistics."""
    values, clusters = rows["value"].to_numpy(dtype=np.float64), rows["cluster"].to_numpy()
    known, prior = np.isfinite(values), rows["prior"].to_numpy(dtype=np.float64)
    at_prior = bool(np.isfinite(prior[~known]).all()) and bool(np.isfinite(prior).any())
    # Without priors only quantiles are defined; those that lie among the failures are infinite.
    defined = [one for one in statistics if at_prior or one.quantile is not None]
    counted = dict(
        zip(defined, measure(np.where(known, values, prior if at_prior else WORST), clusters, defined), strict=True)
    )
    labels = rows["estimator"].unique()
    return Subject(
        names,
        str(labels[0]) if len(labels) == 1 else "",
        int(known.sum()),
        len(rows),
        share_of(~rows["failed"].to_numpy(dtype=bool), clusters),
        float(np.nanmedian(prior)) if np.isfinite(prior).any() else None,
        tuple(measure(values[known], clusters[known], statistics)),
        tuple(counted.get(one, Measured(None)).each(bounded) for one in statistics),
        at_prior,
    )
