"""Cases of a stored run: selection, recomputation from the seed, comparison with the stored tables bit by bit.

Cases are selected by name, by number, or as the worst; a failure is worse than any error.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from boresight.campaign.pool.guard import STOPPED, Call, Loss, guarding
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import trials_of
from boresight.campaign.runs.resolve import reload, unlike
from boresight.campaign.store import RunFolder, run_words
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.reports.compare.trials import choose_metric, metric_values, missed_or_wrong, trial_numbers
from boresight.reports.figures.named import file_stem
from boresight.reports.run.data import RunData
from boresight.reports.schema.column import Measure
from boresight.reports.schema.records import CONTROLS
from boresight.reports.schema.tables import TABLES, schema
from boresight.scenarios.errors import BoresightError

ORDER = "estimators that raised, then failures by their prior error, then solved trials by"
MISSED_OR_WRONG = "n_missed_or_wrong"
"""Number of missed and of wrong craters in a trial, by which detection and matching are ranked."""

_MOST_NAMED = 3

NOT_REPRODUCIBLE = ("timings", "tracebacks", "said")
"""Tables not compared: times vary, tracebacks contain file paths, and the output of methods is arbitrary."""


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
            raise BoresightError(f"--{column} {wanted}: {run} has none of that name: choose one of {', '.join(there)}")
        if wanted is not None:
            rows = rows[rows[column] == wanted]
    return rows


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


@dataclass(frozen=True, eq=False)
class Recomputed:
    """A recomputed case: the trials of its estimator alone, its tables, and the `InspectedTrial`.

    The last is None if the kind of trial has none, or the trial ended before. The types of trials and `InspectedTrial`
    depend on the kind.
    """

    case: Case
    trials: Any
    records: Records
    shown: Any
    folder: RunFolder

    @cached_property
    def comparison(self) -> StoredComparison:
        """Comparison with the stored tables."""
        return compare_with_stored(self.folder, self.case, self.records)

    @property
    def row(self) -> Record:
        """Row of the case."""
        return self.records["rows"][0]

    @property
    def traceback(self) -> str:
        """Traceback of an estimator that raised, else ''."""
        return "\n".join(str(record["traceback"]) for record in self.records.get("tracebacks", []))

    @property
    def said(self) -> dict[str, str]:
        """Captured output of the method, by stream."""
        return {str(record["stream"]): str(record["text"]) for record in self.records.get("said", [])}


def reopened(folder: RunFolder) -> ResolvedCampaign:
    """Resolve the campaign of a stored run, to recompute its trials.

    Raise BoresightError if there is no run, or code or data differ from those that it was made with.
    """
    manifest = folder.read_manifest()
    if manifest is None:
        raise BoresightError(f"{folder.path}: no run has started there")
    campaign = reload(manifest)
    if campaign is None:
        raise BoresightError(
            f"{folder.path}: cannot be recomputed: {_why(manifest)}; to remake it: {_remake(manifest)}"
        )
    return campaign


def _why(manifest: Mapping[str, Any]) -> str:
    made = manifest.get("commit") or f"version {manifest.get('versions', {}).get('boresight', 'unknown')}"
    changed = unlike(manifest)
    if not changed:
        return f"it was made by boresight {made}, whose manifest this one cannot read"
    more = f" and {len(changed) - _MOST_NAMED} more" if len(changed) > _MOST_NAMED else ""
    return f"it was made by boresight {made}: {', '.join(changed[:_MOST_NAMED])}{more} changed since"


def _remake(manifest: Mapping[str, Any]) -> str:
    """Return the command that runs the campaign of a manifest with the present code."""
    began = run_words(manifest)
    given = len(began) > 2 and not began[2].startswith("-")
    name = began[2] if given else str(manifest.get("name", "NAME"))
    words = ["boresight", "run", name, "--trials", str(manifest.get("trials")), "--seed", str(manifest.get("seed"))]
    return shlex.join([*words, *(part for change in manifest.get("overrides", ()) for part in ("--set", change))])


def _stopped_before(folder: RunFolder, case: Case) -> dict[Call, Loss]:
    """Return the loss of a case whose method was stopped, so that it is not run again: it could end this process."""
    rows = folder.of_trial("rows", case.scenario, case.estimator, case.trial).to_pylist()
    reasons = [str(row.get("reason")).partition(STOPPED)[2] for row in rows if row["status"] == "error"]
    traces = folder.of_trial("tracebacks", case.scenario, case.estimator, case.trial).to_pylist()
    return {
        Call(case.scenario, case.trial, case.estimator): Loss(reason, "\n".join(trace["traceback"] for trace in traces))
        for reason in reasons
        if reason
    }


def recompute(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> Recomputed:
    """Run one case again, observed; one whose method was stopped in the stored run is not."""
    context = WorkerContext(folder.path, jobs=1, keep_images=False)
    shown: list[InspectedTrial[Any, Any, Any]] = []
    watched = trials_of(campaign, case.scenario, context).of(case.trial).watched(case.estimator, shown.append)
    with guarding(lost=_stopped_before(folder, case)):
        records = watched.run(range(case.trial, case.trial + 1))
    return Recomputed(case, watched, records, shown[-1] if shown else None, folder)


@dataclass(frozen=True, slots=True)
class StoredComparison:
    """Result of comparing a recomputed trial with the stored one.

    ``values`` is the number of compared values; ``differences`` has a line for each table and column that differs.
    """

    values: int
    differences: tuple[str, ...]

    def __str__(self) -> str:
        if self.differences:
            return f"NOT the same as stored: {'; '.join(self.differences)}"
        return f"the same as stored, bit for bit ({self.values:,} values)"


def compare_with_stored(folder: RunFolder, case: Case, records: Records) -> StoredComparison:
    """Compare every reproducible table of a case with the recomputed one."""
    values, differences = 0, []
    for name in (name for name in TABLES if name not in NOT_REPRODUCIBLE):
        stored = folder.of_trial(name, case.scenario, case.estimator, case.trial)
        again = pa.Table.from_pylist([dict(record) for record in records.get(name, [])], schema=schema(name))
        if stored.num_rows != again.num_rows:
            differences.append(f"{name}: {again.num_rows} rows, {stored.num_rows} stored")
            continue
        values += stored.num_rows * len(stored.column_names)
        differences += _differences(name, stored, again)
    return StoredComparison(values, tuple(differences))


def _differences(name: str, stored: pa.Table, again: pa.Table) -> Iterator[str]:
    """Yield the columns that differ, without those that an earlier version did not store.

    Numbers are compared by their bits: NaN equals NaN, and -0 differs from 0.
    """
    for column in (column for column in again.column_names if column in stored.column_names):
        bits = ([x.hex() if isinstance(x, float) else x for x in one[column].to_pylist()] for one in (stored, again))
        rows = sum(one != other for one, other in zip(*bits, strict=True))
        if rows:
            yield f"{name}.{column} in {rows} of {stored.num_rows} rows"
