"""Selection of cases of a stored run, by name, by number, or as the worst; a failure is worse than any error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from boresight.reports.compare.trials import choose_metric, metric_values, missed_or_wrong, trial_numbers
from boresight.reports.figures.named import file_stem
from boresight.reports.run.data import RunData
from boresight.reports.schema.column import Measure
from boresight.scenarios.errors import BoresightError

CONTROLS = ("prior", "dead-reckoning")
"""Baseline estimators that use no measurement, whose worst cases are of no interest."""

ORDER = "estimators that raised, then failures by their prior error, then solved trials by"
MISSED_OR_WRONG = "n_missed_or_wrong"
"""Number of missed and of wrong craters in a trial, by which detection and matching are ranked."""


@dataclass(frozen=True, slots=True)
class Case:
    """A trial of one scenario and estimator."""

    scenario: str
    estimator: str
    trial: int

    @property
    def stem(self) -> str:
        """Name of the folder of the case."""
        return file_stem(self.scenario, self.estimator, f"{self.trial:07d}")

    def __str__(self) -> str:
        return f"trial {self.trial} of {self.scenario} / {self.estimator}"


@dataclass(frozen=True, slots=True)
class Choice:
    """Scenario and estimator selected by the user; None for all."""

    scenario: str | None = None
    estimator: str | None = None


def chosen_rows(rows: pd.DataFrame, choice: Choice, run: str) -> pd.DataFrame:
    """Return the rows of a choice.

    Raise BoresightError if the run has no such scenario or estimator; the message lists the existing ones.
    """
    for column, wanted in (("scenario", choice.scenario), ("estimator", choice.estimator)):
        there = list(dict.fromkeys(rows[column].astype(str)))
        if wanted is not None and wanted not in there:
            raise unknown(column, wanted, there, run)
        if wanted is not None:
            rows = rows[rows[column] == wanted]
    return rows


def unknown(column: str, wanted: str, there: Sequence[str], run: str) -> BoresightError:
    """Return the error for a scenario or estimator that the run does not have."""
    return BoresightError(f"--{column} {wanted}: {run} has none of that name: choose one of {', '.join(there)}")


def named_cases(rows: pd.DataFrame, trials: Sequence[int], run: str) -> list[Case]:
    """Return the cases of given trials, for all estimators of one scenario.

    Raise BoresightError if the rows are of several scenarios, or a trial is not stored.
    """
    scenarios = list(dict.fromkeys(rows["scenario"].astype(str)))
    if len(scenarios) > 1:
        raise BoresightError(f"--trial: {run} has several scenarios: give --scenario, one of {', '.join(scenarios)}")
    checked_trials(rows, trials, run)
    return [case for trial in trials for case in cases_of(rows[rows["trial"] == trial])]


def checked_trials(rows: pd.DataFrame, trials: Sequence[int] | None, run: str) -> list[int]:
    """Return the requested trials, or all stored ones for None; raise BoresightError if one is not stored."""
    there = sorted({int(trial) for trial in rows["trial"]})
    for trial in trials or ():
        if trial not in there:
            raise BoresightError(f"--trial {trial}: {run} has not stored it: it holds trials {there[0]} to {there[-1]}")
    return there if trials is None else list(trials)


def cases_of(rows: pd.DataFrame) -> list[Case]:
    """Return the cases of stored rows, in order."""
    keys = rows[["scenario", "estimator", "trial"]].itertuples(index=False, name=None)
    return [Case(str(scenario), str(estimator), int(trial)) for scenario, estimator, trial in keys]


def worst_cases(run: RunData, count: int, choice: Choice, metric: str | None) -> tuple[list[Case], str]:
    """Return the ``count`` worst trials of a run, the worst first, or all if they are fewer, and the metric's name.

    Errors come first, then failures, both by decreasing prior error, then solved trials without the metric, then solved
    trials by decreasing metric; ties by trial number. `CONTROLS` are left out unless ``choice`` names one.
    """
    rows = run.rows.reset_index(drop=True)
    values, name = _badness(run, metric)
    ranked = rows.assign(_badness=values.abs().to_numpy())
    ranked = chosen_rows(ranked, choice, str(run.folder))
    others = ranked[~ranked["estimator"].isin(CONTROLS)]
    if choice.estimator is None and not others.empty:
        ranked = others
    solved = ranked["status"] == "ok"
    rank = ranked["status"].map({"error": 0, "failed": 1}).fillna(2)
    number = np.where(solved, ranked["_badness"], ranked["prior_position_error_m"].astype(float))
    # A trial without the number cannot be judged, so it is ranked before the others of its status.
    ranked = ranked.assign(_rank=rank, _number=np.nan_to_num(number, nan=np.inf))
    ranked = ranked.sort_values(["_rank", "_number", "trial"], ascending=[True, False, True], kind="stable")
    return cases_of(ranked.head(count)), name


def _badness(run: RunData, metric: str | None) -> tuple[pd.Series, str]:
    """Return the metric by which trials are ranked, in the order of the rows, and its name."""
    faults = missed_or_wrong(run)
    if faults is not None and metric in (None, MISSED_OR_WRONG):
        return faults, MISSED_OR_WRONG
    if metric is None and not trial_numbers(run):
        return pd.Series(np.nan, index=run.rows.index), "nothing: no trial has a number"
    chosen: Measure = choose_metric(metric, [run])
    return metric_values(run, chosen), chosen.name
