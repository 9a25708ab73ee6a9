"""Comparison of runs: statistics of every subject, and differences between subjects that differ in one factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from boresight.reports.compare.metrics import Metric, choose_metric
from boresight.reports.compare.pairs import Contrast, holm_corrected, independent_contrast, paired_contrast
from boresight.reports.compare.trials import (
    ESTIMATOR,
    KEY,
    RUN,
    SCENARIO,
    check_factors,
    check_pairs,
    default_factors,
    tabulate_trials,
)
from boresight.reports.figures.style import PlotStyle, plot_styles
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
    bounded,
    measure,
    share_of,
)
from boresight.scenarios.errors import BoresightError

STATISTICS = (MEDIAN, RMS, P75, P95, P99)


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
    folders: Sequence[Path],
    metric: str | None = None,
    factors: Sequence[str] | None = None,
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
        ``brdf`` or ``camera.fov_deg``. Trials that differ in other things are pooled. By default estimator and
        scenario, and the run where several runs have the same ones.
    unpaired
        Whether subjects whose trials are not the same are compared as independent samples.

    Raises
    ------
    BoresightError
        If a run cannot be read, metric or factor is unknown, or the trials of two runs are not the same.
    """
    runs = tuple(read_run(folder) for folder in folders)
    check_factors(factors or (), runs)
    if not unpaired:
        check_pairs(runs)
    return compared(runs, choose_metric(metric, runs), factors, unpaired)


def compared(
    runs: tuple[RunData, ...], chosen: Metric, factors: Sequence[str] | None = None, unpaired: bool = False
) -> RunComparison:
    """Compare runs that have been read and can be compared by these factors.

    Raises
    ------
    BoresightError
        If no trial has a value of the metric.
    """
    trials = tabulate_trials(runs, chosen, factors or (ESTIMATOR, SCENARIO))
    own = tuple(factors or default_factors(trials))
    if RUN not in own and trials.duplicated([*own, *KEY]).any():
        own = (RUN, *own)  # several runs have the same trials of a subject
    subjects = tuple(_subject(_of(trials, own, one), one) for one in _in_order(trials, own, runs))
    if all(subject.n_ok == 0 for subject in subjects):
        folders = ", ".join(str(run.folder) for run in runs)
        raise BoresightError(f"--metric {chosen.name}: no trial of {folders} has a value of it")
    contrasts = []
    # The control, which estimates nothing, is left out of the differences.
    for second, first in combinations((one for one in subjects if one.estimator != CONTROL), 2):
        if sum(a != b for a, b in zip(first.names, second.names, strict=True)) == 1:
            names = (first.names, second.names)
            tables = [_of(trials, own, one) for one in names]
            found = paired_contrast(names, *tables)
            if found is None and unpaired:
                found = independent_contrast(names, *tables)
            if found is not None and not chosen.is_error:  # a failure is neither more nor less
                found = replace(found, better_of_all=Measured(None), p_of_all=None)
            contrasts += [] if found is None else [found]
    return RunComparison(runs, chosen, own, trials, subjects, tuple(holm_corrected(contrasts)))


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


def _of(trials: pd.DataFrame, factors: Sequence[str], names: Sequence[str]) -> pd.DataFrame:
    mine = np.ones(len(trials), dtype=bool)
    for factor, name in zip(factors, names, strict=True):
        mine &= (trials[factor] == name).to_numpy()
    return trials[mine]


def _subject(rows: pd.DataFrame, names: tuple[str, ...]) -> Subject:
    values, clusters = rows["value"].to_numpy(dtype=np.float64), rows["cluster"].to_numpy()
    known, prior = np.isfinite(values), rows["prior"].to_numpy(dtype=np.float64)
    at_prior = bool(np.isfinite(prior[~known]).all()) and bool(np.isfinite(prior).any())
    # Without priors only quantiles are defined; those that lie among the failures are infinite.
    defined = [one for one in STATISTICS if at_prior or one.quantile is not None]
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
        tuple(measure(values[known], clusters[known], STATISTICS)),
        tuple(counted.get(one, Measured(None)).each(bounded) for one in STATISTICS),
        at_prior,
    )
