"""Which cases of a stored run are meant: names that it has, and one clear line where it has not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from reports.schema.named_figure import file_stem
from scenarios.errors import BoresightError

CONTROLS = ("prior", "dead-reckoning")
"""Estimators that do nothing, so that others can be held against them: the worst of them teaches nothing."""


@dataclass(frozen=True, slots=True)
class Case:
    """A trial of one scenario and estimator."""

    scenario: str
    estimator: str
    trial: int

    @property
    def stem(self) -> str:
        """Name of its folder."""
        return file_stem(self.scenario, self.estimator, f"{self.trial:07d}")

    def __str__(self) -> str:
        return f"trial {self.trial} of {self.scenario} / {self.estimator}"


@dataclass(frozen=True, slots=True)
class Choice:
    """Which scenarios and estimators of a run a user asked for; None for all."""

    scenario: str | None = None
    estimator: str | None = None


def chosen_rows(rows: pd.DataFrame, choice: Choice, run: str) -> pd.DataFrame:
    """Keep the rows of a choice.

    Raises
    ------
    BoresightError
        If the run has no such scenario or estimator; the message lists those that it has.
    """
    for column, wanted in (("scenario", choice.scenario), ("estimator", choice.estimator)):
        there = list(dict.fromkeys(rows[column].astype(str)))
        if wanted is not None and wanted not in there:
            raise unknown(column, wanted, there, run)
        if wanted is not None:
            rows = rows[rows[column] == wanted]
    return rows


def unknown(column: str, wanted: str, there: Sequence[str], run: str) -> BoresightError:
    """Say that a run has no scenario or estimator of a name."""
    return BoresightError(f"--{column} {wanted}: {run} has none of that name: choose one of {', '.join(there)}")


def named_cases(rows: pd.DataFrame, trials: Sequence[int], run: str) -> list[Case]:
    """List the cases of numbered trials, of all estimators of one scenario.

    Raises
    ------
    BoresightError
        If several scenarios are left, or a trial is not stored.
    """
    scenarios = list(dict.fromkeys(rows["scenario"].astype(str)))
    if len(scenarios) > 1:
        raise BoresightError(f"--trial: {run} has several scenarios: give --scenario, one of {', '.join(scenarios)}")
    checked_trials(rows, trials, run)
    return [case for trial in trials for case in cases_of(rows[rows["trial"] == trial])]


def checked_trials(rows: pd.DataFrame, trials: Sequence[int] | None, run: str) -> list[int]:
    """Return the trials that were asked for, all that are stored for None.

    Raises
    ------
    BoresightError
        If one is not stored.
    """
    there = sorted({int(trial) for trial in rows["trial"]})
    for trial in trials or ():
        if trial not in there:
            raise BoresightError(f"--trial {trial}: {run} has not stored it: it holds trials {there[0]} to {there[-1]}")
    return there if trials is None else list(trials)


def cases_of(rows: pd.DataFrame) -> list[Case]:
    """List the cases of stored rows, in their order."""
    keys = rows[["scenario", "estimator", "trial"]].itertuples(index=False, name=None)
    return [Case(str(scenario), str(estimator), int(trial)) for scenario, estimator, trial in keys]
