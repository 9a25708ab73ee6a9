"""The errors of a grid of scenarios: what is compared, by scenario and trial, and how it changes between scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.kinds.pooled import pooled_trials
from boresight.reports.run.clusters import clusters_of, image_set
from boresight.reports.run.data import RunData, ScenarioGrid
from boresight.reports.run.outcomes import errors_by_stage, final_stage, succeeded
from boresight.reports.schema.grid import of_ended
from boresight.reports.schema.kinds import SEQUENCE_COLUMNS
from boresight.reports.schema.records import CONTROL, SEQUENCE, stage_label
from boresight.reports.schema.tables import kind_schema, measure_label, unit_of
from boresight.reports.statistics.measured import MEAN, MEDIAN, Measured, measure
from boresight.reports.statistics.paired import main_effects
from boresight.reports.tables import interval

POSITION, ATTITUDE, CENTROID = "position_error_m", "attitude_error_deg", "centroid_offset_px"
REVOLUTION_ERRORS = tuple(name for name in SEQUENCE_COLUMNS if name.startswith("error_after_"))
_REPORTED = "diagnostics"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Quantity compared between scenarios: an error of an estimator after a stage, '' for the final one.

    The stage ``diagnostics`` stands for numbers that the estimator reports, ``sequence`` for what a trial of a sequence
    comes to.
    """

    estimator: str
    stage: str
    measure: str

    @property
    def label(self) -> str:
        """In words, with the unit."""
        if self.stage == CONTROL:
            return f"prior, {unit_of(self.measure)}"
        after = f" {stage_label(self.stage)}" if self.stage not in ("", _REPORTED, SEQUENCE) else ""
        return f"{measure_label(self.measure)}{after}, {unit_of(self.measure)}"


def outcomes(run: RunData) -> list[Outcome]:
    """List the outcomes of a run: what there is of centroiding, then the final position and attitude.

    The attitude is none of an estimator that leaves it as it was, such as centroiding alone. Of sequences, list the
    errors after whole revolutions that they are long enough for.
    """
    if kind_schema(run.manifest.experiment).frames:
        names = dict.fromkeys(name for _, name in run.pairs())
        reached = [name for name in REVOLUTION_ERRORS if run.rows[name].notna().any()]
        return [Outcome(estimator, SEQUENCE, name) for estimator in names for name in reached or [POSITION]]
    found = []
    for estimator in dict.fromkeys(name for _, name in run.pairs() if name != CONTROL):
        scenario = next(where for where, name in run.pairs() if name == estimator)
        stages = errors_by_stage(run, scenario, estimator)
        told = run.table("diagnostics")
        if ((told["estimator"] == estimator) & (told["name"] == CENTROID)).any():
            found.append(Outcome(estimator, _REPORTED, CENTROID))
        if "centroid" in stages and final_stage(run, scenario, estimator) != "centroid":
            found.append(Outcome(estimator, "centroid", POSITION))
        found.append(Outcome(estimator, "", POSITION))
        rows = run.rows[(run.rows["estimator"] == estimator) & (run.rows["status"] == "ok")]
        turned = (rows[ATTITUDE] - rows[f"prior_{ATTITUDE}"]).abs() > 1e-9
        if rows.empty or turned.any():
            found.append(Outcome(estimator, "", ATTITUDE))
    return found


class DesignData:
    """A run of a grid of scenarios, with the errors of an outcome by scenario and trial."""

    def __init__(self, run: RunData, design: ScenarioGrid) -> None:
        self.run = run
        self.design = design
        done = set(run.rows["scenario"])
        self._variations = {one.name: one for one in design.scenarios if one.name in done}
        self._errors: dict[tuple[str, Outcome], pd.Series] = {}

    def levels(self, scenario: str) -> dict[str, str]:
        """Return a scenario's level of each axis, in the order of the axes."""
        own = self._variations[scenario].levels
        return {axis.name: own[axis.name] for axis in self.design.axes}

    def bases(self) -> dict[str, list[str]]:
        """Group the scenarios that have been run by the one that they vary."""
        groups: dict[str, list[str]] = {}
        for name, one in self._variations.items():
            groups.setdefault(one.base, []).append(name)
        return groups

    def errors(self, scenario: str, outcome: Outcome) -> pd.Series:
        """Return the errors by trial; trials without an estimate, or which did not reach the stage, have none."""
        key, run = (scenario, outcome), self.run
        if key not in self._errors:
            if outcome.stage == _REPORTED:
                told = run.of(scenario, outcome.estimator, "diagnostics")
                errors = told[told["name"] == outcome.measure].set_index("trial")["value"]
            elif outcome.stage == SEQUENCE:  # of every trial that came so far, whether or not it failed later
                errors = run.of(scenario, outcome.estimator).set_index("trial")[outcome.measure]
            else:
                stages = errors_by_stage(run, scenario, outcome.estimator)
                table = stages.get(outcome.stage or final_stage(run, scenario, outcome.estimator))
                errors = pd.Series(dtype=float) if table is None else table.set_index("trial")[outcome.measure]
            self._errors[key] = errors.dropna().astype(float)
        return self._errors[key]

    def pooled(self, names: Sequence[str], outcome: Outcome) -> pd.DataFrame:
        """Return all trials of an estimator in some scenarios, with their errors and levels; see `pooled_trials`."""
        tables = {_REPORTED: self.run.table("diagnostics"), "": self.run.rows, SEQUENCE: self.run.rows}
        tables[CONTROL] = self.run.rows.assign(**{POSITION: self.run.rows[f"prior_{POSITION}"]})
        rows, errors = (
            table[(table["estimator"] == outcome.estimator) & table["scenario"].isin(names)]
            for table in (self.run.rows, tables.get(outcome.stage, self.run.table("stages")))
        )
        column = outcome.measure
        if outcome.stage == _REPORTED:
            errors, column = errors[errors["name"] == outcome.measure], "value"
        elif outcome.stage == "":
            errors = errors[errors["status"] == "ok"]
        elif outcome.stage not in tables:
            errors = errors[errors["stage"] == outcome.stage]
        levels = pd.DataFrame.from_dict({name: [*self.levels(name).values()] for name in names}, orient="index")
        return pooled_trials(self.run, errors.assign(value=errors[column]), rows, levels)

    def trials(self, scenario: str, outcome: Outcome) -> int:
        """Count the trials of a scenario, with and without an estimate."""
        return len(self.run.of(scenario, outcome.estimator))

    def priors(self, names: Sequence[str], estimator: str) -> list[Outcome]:
        """Return the position error of the prior that an estimator began with, where its trials have one."""
        prior = Outcome(estimator, CONTROL, POSITION)
        return [prior] if any(len(self.errors(name, prior)) for name in names) else []

    def median(self, scenario: str, outcome: Outcome) -> Measured:
        """Return the median error with its interval."""
        errors = self.errors(scenario, outcome)
        return measure(errors.to_numpy(), self._clusters(scenario, errors), (MEDIAN,))[0]

    def printed_median(self, scenario: str, outcome: Outcome) -> str:
        """Print the median error with its interval, and of how many trials where others have none."""
        cell, trials = interval(self.median(scenario, outcome)), self.trials(scenario, outcome)
        return of_ended(cell, len(self.errors(scenario, outcome)), trials)

    def ok(self, scenarios: Sequence[str], outcome: Outcome) -> str:
        """Print n_ok/n over scenarios."""
        n_ok = sum(len(self.errors(name, outcome)) for name in scenarios)
        return f"{n_ok}/{sum(self.trials(name, outcome) for name in scenarios)}"

    def counts(self, scenarios: Sequence[str], outcome: Outcome) -> tuple[str, ...]:
        """Print the trials behind a median and, where trials have priors, those that succeeded, over scenarios."""
        solved = self.ok(scenarios, outcome)
        if not self.priors(scenarios, outcome.estimator):
            return (solved,)
        good = [succeeded(self.run.of(name, outcome.estimator)) for name in scenarios]
        return (solved, f"{sum(int(own.sum()) for own in good)}/{sum(map(len, good))}")

    def change(self, scenario: str, against: str, outcome: Outcome) -> Measured:
        """Return the ratio of geometric means between two scenarios, over the trials known to both."""
        errors = (self.errors(name, outcome).clip(lower=1e-12) for name in (scenario, against))
        logs = pd.concat([np.log(series) for series in errors], axis=1, join="inner")
        difference = logs.iloc[:, 0] - logs.iloc[:, 1]
        found = measure(difference.to_numpy(), self._clusters(scenario, difference), (MEAN,))[0]
        return found.each(lambda end: float(np.exp(end)))

    def _clusters(self, scenario: str, by_trial: pd.Series) -> NDArray[np.generic]:
        return clusters_of(self.run, pd.DataFrame({"scenario": scenario, "trial": by_trial.index}))

    def effects(self, names: Sequence[str], outcome: Outcome) -> list[Measured]:
        """Return the main effect of each axis between its first and last level; of images or data bases without."""
        levels = {name: self.levels(name).values() for name in names}
        firsts = [axis.levels[0] for axis in self.design.axes]
        high = {name: [a != b for a, b in zip(own, firsts, strict=True)] for name, own in levels.items()}
        found = main_effects({name: self.errors(name, outcome) for name in names}, high)
        seen = any(image_set(self.run.manifest.scenarios[name]) for name in names)
        return [Measured(one.value) for one in found] if seen or self.run.databases > 1 else found
