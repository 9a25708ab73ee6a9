"""A case of a stored run, worked out again from its seed with all that came about on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from campaign.experiments.registry import Bench, Experiment, Record, Records
from campaign.inspection.case import Case
from campaign.inspection.same import Sameness, compare_with_stored
from campaign.resolve import ResolvedCampaign, reload, unlike
from campaign.store import RunFolder
from campaign.worker import experiment_of
from scenarios.errors import BoresightError


@dataclass(frozen=True, slots=True, eq=False)
class Recomputed:
    """A case as it came out again.

    Parameters
    ----------
    case
        Which one.
    experiment
        What it is a trial of.
    records
        Its stored tables, made again.
    shown
        What its witness was shown; None of a kind that shows nothing, or where there was no such trial.
    sameness
        Against what is stored.
    """

    case: Case
    experiment: Experiment
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
            f"{folder.path}: cannot be recomputed: {_why(manifest)}; to remake it: boresight run"
            f" {manifest.get('name', 'NAME')} --trials {manifest.get('trials', 'N')} --seed {manifest.get('seed', 'N')}"
        )
    return campaign


def _why(manifest: Mapping[str, Any]) -> str:
    made = manifest.get("commit") or f"version {manifest.get('versions', {}).get('boresight', 'unknown')}"
    changed = unlike(manifest)
    since = f": {', '.join(changed)} changed since" if changed else ", whose manifest this one cannot read"
    return f"it was made by boresight {made}{since}"


def recompute(campaign: ResolvedCampaign, folder: RunFolder, case: Case) -> Recomputed:
    """Run one case again, with a witness, and compare it with what is stored."""
    bench = Bench(folder.path, jobs=1, keep_images=False)
    shown: list[object] = []
    experiment = experiment_of(campaign, case.scenario, bench)
    watched = experiment.watched(case.estimator, shown.append)
    records = watched.run(range(case.trial, case.trial + 1))
    sameness = compare_with_stored(folder, case, records)
    return Recomputed(case, watched, records, shown[-1] if shown else None, sameness)
