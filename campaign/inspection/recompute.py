"""Recomputation of a case of a stored run from its seed, and its comparison with the stored tables bit by bit."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pyarrow as pa

from boresight.campaign.inspection.case import Case
from boresight.campaign.pool.guard import STOPPED, Call, Loss, guarding
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.blocks import trials_of
from boresight.campaign.runs.newest import run_words
from boresight.campaign.runs.resolve import reload, unlike
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.reports.schema.tables import TABLES, schema
from boresight.scenarios.errors import BoresightError

_MOST_NAMED = 3

NOT_REPRODUCIBLE = ("timings", "tracebacks", "said")
"""Tables not compared: times vary, tracebacks contain file paths, and the output of methods is arbitrary."""


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
