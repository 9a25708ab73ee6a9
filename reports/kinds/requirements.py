"""The requirements of a campaign, and what its trials say of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.trials import nothing_to_find, trial_numbers
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData, in_order_of
from boresight.reports.run.outcomes import succeeded
from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.grid import NO_VALUE, Grid, chance, number, row_grid
from boresight.reports.schema.records import CONTROLS
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.requirements import SECONDS, YES_OR_NO, Requirement, Verdict, judge, read_requirement

LEAST_TRIALS = 10
"""Trials in each third of a tornado, or of each level of a grid, below which a quantile there says nothing."""
_NOTE = (
    "Missed: trials beyond the limit, or without the number; no estimate: those of them without an estimate. Reached:"
    " the limit that would just pass. Risk: the consumer's risk, the probability of a result at least as good where"
    " the requirement is just not met. Further: trials without another miss that would pass it; at this rate: about"
    " how many would decide it if they miss as often as those so far. Each verdict has its own risk. Trials that share"
    " a real image, or sequences that share a set of images, count as one, which passes by its worst and fails by its"
    " best. With several data bases a verdict is of these."
)
_LOOKED = (
    " This run was looked at and went on, or is not finished: verdicts are of a test that holds at every look, and"
    " needs more trials than one of a number of trials fixed beforehand."
)


@dataclass(frozen=True, slots=True)
class Judged:
    """A requirement on an estimator in a scenario, and the verdict; ``unsolved`` of its misses have no estimate."""

    requirement: Requirement
    scenario: str
    estimator: str
    verdict: Verdict
    unsolved: int


def judged(run: RunData, *, trials: int | None = None, looked: bool = False) -> Iterator[Judged]:
    """Judge every requirement of a run on each estimator but the controls, in each scenario.

    Of the first ``trials``, if they are given. ``looked``: the run may end after each look, as it may if its manifest
    says so, or trials that were asked for are not there.
    """
    again = looked or _could_end_elsewhere(run)
    for requirement, scenario, estimator, values in required_values(run):
        numbers = run.rows.loc[values.index, "trial"]
        own = values.dropna() if trials is None else values[numbers < trials].dropna()
        of_unit = pd.Series(independent_units(run, run.rows.loc[own.index]), own.index)
        units, failed = own.groupby(of_unit, sort=False), run.rows.loc[own.index, "status"] != "ok"
        worst, best = (np.asarray(part, dtype=np.float64) for part in (units.max(), units.min()))
        verdict = judge(requirement, worst, best=best, looked=again, turns=max(1, run.databases))
        yield Judged(requirement, scenario, estimator, verdict, of_unit[failed].nunique())


def _could_end_elsewhere(run: RunData) -> bool:
    """Tell whether the number of trials was not fixed beforehand: the run was looked at, or is not finished."""
    done, asked = run.progress()
    return run.manifest.looked or done < asked


def required_values(run: RunData) -> Iterator[tuple[Requirement, str, str, pd.Series[float]]]:
    """Yield requirements with each scenario and estimator that they are of, and the measure of its trials (n,)."""
    for asked in run.manifest.requirements:
        requirement = read_requirement(asked.that, run.manifest.experiment)
        values = _values(run, requirement.measure)
        # Also a pair that no trial is stored of yet is asked.
        for scenario, estimator in product(run.manifest.scenarios, map(str, run.manifest.estimators)):
            wanted = not asked.scenarios or scenario in asked.scenarios
            own = estimator in asked.estimators if asked.estimators else estimator not in CONTROLS
            if wanted and own:
                yield requirement, scenario, estimator, values.loc[run.of(scenario, estimator).index]


def is_moved(requirement: Requirement) -> bool:
    """Return whether a tornado shows what moves it: a limit, on another measure than the time of the estimator."""
    return requirement.limit is not None and requirement.measure != SECONDS


def independent_units(run: RunData, rows: pd.DataFrame) -> NDArray[np.generic]:
    """Label rows (n,) by the unit that is judged as one: the trial, or the image or the set that trials share."""
    # Of trials whose chances differ by data base a binomial test of their mean is on the safe side (W. Hoeffding 1956).
    return rows["trial"].to_numpy() if run.databases > 1 else clusters_of(run, rows)


def _values(run: RunData, measure: str) -> pd.Series[float]:
    """Return the measure of every row of a run, infinite for a failure; of a yes or no 0 for yes.

    NaN where nothing is to be measured: no crater could be found, or the estimator does not tell its time.
    """
    rows = run.rows
    ok = rows["status"] == "ok"
    if measure in YES_OR_NO:
        met = ok if measure == YES_OR_NO[0] else succeeded(rows)
        return pd.Series(np.where(met, 0.0, 1.0), rows.index)
    if measure == SECONDS:
        times = run.table("timings")
        own = times[~times["stage"].isin([FRESH_IMAGE, STORED_IMAGE])]
        total = own.groupby(["scenario", "estimator", "trial"], sort=False)[["seconds"]].sum().reset_index()
        return in_order_of(rows, total, ["seconds"])["seconds"].where(ok, np.inf)
    values = trial_numbers(run).get(measure, rows[measure] if measure in rows else pd.Series(np.nan, rows.index))
    sizes = values.astype(float).abs().where(ok, np.inf).fillna(np.inf)
    return sizes.mask(nothing_to_find(run, measure_of(measure)))


def requirement_grid(run: RunData) -> Grid | None:
    """Tabulate the requirements of a run and their verdicts; None if it has none."""
    found = list(judged(run))
    rows = [
        {
            "requirement": one.requirement.written,
            "scenario": one.scenario,
            "estimator": one.estimator,
            "verdict": one.verdict.verdict,
            "missed": f"{one.verdict.missed}/{one.verdict.n}",
            "no estimate": str(one.unsolved),
            "reached": _reached(one.verdict.reached, measure_of(one.requirement.measure).unit or ""),
            "risk": chance(one.verdict.risk),
            "further": _trials(one.verdict.further),
            "at this rate": _trials(one.verdict.at_this_rate),
        }
        for one in found
    ]
    note = _NOTE + (_LOOKED if _could_end_elsewhere(run) else "")
    least = LEAST_TRIALS if run.manifest.grid is not None else 3 * LEAST_TRIALS
    if any(one.verdict.n < least for one in found if is_moved(one.requirement)):
        note += f" What moves a requirement is shown from {least} trials of a scenario on."
    return row_grid("Requirements", rows, ("requirement", "scenario", "estimator", "verdict"), note) if rows else None


def _trials(more: int | None) -> str:
    return NO_VALUE if more is None else f"{more:,}"


def _reached(limit: float | None, unit: str) -> str:
    return NO_VALUE if limit is None else f"{number(limit)} {unit}".rstrip() if np.isfinite(limit) else "none"
