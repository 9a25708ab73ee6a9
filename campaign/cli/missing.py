"""Campaigns that figures are missing: each by all workers, or, of a draft, side by side with one worker each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from campaign.cli.progress import NamedLines, ProgressListener
from campaign.cli.terminal import console
from campaign.draft import as_draft, kept
from campaign.machine import sharing_cores, workers
from campaign.pool.workers import in_order
from campaign.resolved import ResolvedCampaign
from campaign.runs.request import RunRequest
from campaign.runs.resolve import resolve
from campaign.runs.runner import run_campaign
from renderers.mitsuba3 import choose_variant
from reports.schema.labels import count_of
from scenarios.errors import BoresightError


@dataclass(frozen=True, slots=True)
class Wanted:
    """How much of campaigns is to be run, and where.

    Parameters
    ----------
    runs
        Where the run folders are.
    share
        Of the trials, and of all that a draft keeps a share of; 1 for runs that are meant.
    trials
        Of each scenario at most; None for as many as the campaign says.
    command
        The command line, for the manifest.
    """

    runs: Path
    share: float
    trials: int | None
    command: str

    def of(self, name: str, variant: str, jobs: int) -> tuple[ResolvedCampaign, RunRequest]:
        """Resolve a campaign, and say how it is run."""
        campaign = as_draft(resolve(name, variant=variant), self.share)
        scaled = kept(campaign.spec.trials, self.share)
        trials = scaled if self.trials is None else min(self.trials, scaled)
        folder = self.runs / f"{campaign.spec.name}-{campaign.digest[:8]}"
        return campaign, RunRequest(folder, trials, jobs, command=self.command)


def run_missing(names: Sequence[str], wanted: Wanted, jobs: int | None) -> None:
    """Run campaigns, or go on with them; those that cannot be run, for want of their data, are told and left out.

    A draft has so few trials of each that most of its time is spent where one campaign alone keeps one core busy, with
    what is built before trials, and behind its last ones; so campaigns are drafted side by side.
    """
    variant = choose_variant().name
    among = workers(jobs, variant)
    lanes = 1 if wanted.share == 1.0 else max(1, min(among, len(names)))
    each = among if lanes == 1 else 1
    for _ in in_order(lanes, _run, ((name, wanted, variant, each, lanes) for name in names)):
        pass


def _run(name: str, wanted: Wanted, variant: str, jobs: int, lanes: int) -> None:
    """Run a campaign, with its share of the cores where others run beside it, which then show no progress but steps."""
    lines, began = NamedLines(console(), name), time.monotonic()
    try:
        campaign, request = wanted.of(name, variant, jobs)
        lines.message(f"{count_of(request.trials, 'trial')} into {request.out}")
        listening = ProgressListener(console()) if lanes == 1 else nullcontext(lines)
        with sharing_cores(lanes), listening as listener:
            run_campaign(campaign, request, listener)
    except BoresightError as error:
        lines.message(str(error))
        return
    if lanes > 1:
        lines.message(f"done in {time.monotonic() - began:.0f} s")
