"""A case of a stored run, worked out again from its seed with all that came about on the way."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from campaign.inspection.case import Case
from campaign.inspection.same import Sameness, compare_with_stored
from campaign.pool.guard import STOPPED, Call, Loss, guarding
from campaign.resolved import ResolvedCampaign
from campaign.runs.resolve import reload, unlike
from campaign.runs.worker import trials_of
from campaign.store import RunFolder
from campaign.trial.kind import Bench, Record, Records, Trials
from scenarios.errors import BoresightError

_MOST_NAMED = 3


@dataclass(frozen=True, slots=True, eq=False)
class Recomputed:
    """A case as it came out again.

    Parameters
    ----------
    case
        Which one.
    trials
        The trials of its estimator alone.
    records
        Its stored tables, made again.
    shown
        What its witness was shown; None of a kind that shows nothing, or where there was no such trial.
    sameness
        Against what is stored.
    """

    case: Case
    trials: Trials
    records: Records
    shown: object | None
    sameness: Sameness

    @property
    def row(self) -> Record:
        """Its row."""
        return self.records["rows"][0]

    @property
    def traceback(self) -> str:
        """Of an estimator that raised; '' of others."""
        return "\n".join(str(record["traceback"]) for record in self.records.get("tracebacks", []))

    @property
    def said(self) -> dict[str, str]:
        """What its method wrote, by stream."""
        return {str(record["stream"]): str(record["text"]) for record in self.records.get("said", [])}


def reopened(folder: RunFolder) -> ResolvedCampaign:
    """Resolve the campaign of a stored run again, to recompute its trials.

    Raises
    ------
    BoresightError
        If no run has started there, or code or data are not those that it was made with.
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
    """Write the command that runs the campaign of a manifest again, into the folder of its new digest."""
    began = _words(manifest.get("command") or "")
    given = began[:2] == ["boresight", "run"] and len(began) > 2 and not began[2].startswith("-")
    name = began[2] if given else str(manifest.get("name", "NAME"))
    words = ["boresight", "run", name, "--trials", str(manifest.get("trials")), "--seed", str(manifest.get("seed"))]
    return shlex.join([*words, *(part for change in manifest.get("overrides", ()) for part in ("--set", change))])


def _words(command: str) -> list[str]:
    try:
        return shlex.split(command)
    except ValueError:  # a quotation that has no end
        return []


def _stopped_before(folder: RunFolder, case: Case) -> dict[Call, Loss]:
    """Tell that a method was stopped in a case: it would take as long again, or this process with it."""
    rows = folder.of_trial("rows", case.scenario, case.estimator, case.trial).to_pylist()
    reasons = [str(row.get("reason")).partition(STOPPED)[2] for row in rows if row["status"] == "error"]
    traces = folder.of_trial("tracebacks", case.scenario, case.estimator, case.trial).to_pylist()
    return {
        Call(case.scenario, case.trial, case.estimator): Loss(reason, "\n".join(trace["traceback"] for trace in traces))
        for reason in reasons
        if reason
    }


def recompute(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> Recomputed:
    """Run one case again, with a witness, and compare it with what is stored."""
    bench = Bench(folder.path, jobs=1, keep_images=False)
    shown: list[object] = []
    watched = trials_of(campaign, case.scenario, bench).watched(case.estimator, shown.append)
    with guarding(lost=_stopped_before(folder, case)):
        records = watched.run(range(case.trial, case.trial + 1))
    sameness = compare_with_stored(folder, case, records)
    return Recomputed(case, watched, records, shown[-1] if shown else None, sameness)
