"""From what a user asks for to a run folder: the one way in, for the command line and for Python."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.imaging.world import check_craters, trial_limit
from campaign.machine import workers
from campaign.resolved import ResolvedCampaign
from campaign.runs.request import RUNS, Cluster, RunRequest
from campaign.runs.resolve import resolve
from campaign.runs.runner import Listener, run_campaign
from campaign.store import RunFolder
from renderers.mitsuba3 import choose_variant
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from campaign.runs.until import Until


@dataclass(frozen=True, slots=True)
class Start:
    """A run that is about to begin, all that could be refused beforehand checked.

    Parameters
    ----------
    campaign
        What decides its rows.
    request
        Where and how it runs.
    until
        When to stop before all trials are run; None to run them all.
    advice
        What would make this machine faster; '' without.
    """

    campaign: ResolvedCampaign
    request: RunRequest
    until: Until | None
    advice: str

    def go(self, listener: Listener) -> RunFolder:
        """Run what is not stored yet."""
        if self.until is None:
            return run_campaign(self.campaign, self.request, listener)
        # Imported here, as below: scipy.stats takes a third of the start-up, and most runs need none of it.
        from campaign.runs.until import run_until

        return run_until(self.campaign, self.request, self.until, listener)


def start(
    name: str,
    *,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    trials: int | None = None,
    until: str | None = None,
    jobs: int | None = None,
    out: Path | None = None,
    variant: str | None = None,
    keep_images: bool = False,
    cluster: Cluster | None = None,
    trial_limit_s: float | None = None,
    command: str = "",
) -> Start:
    """Read a campaign and say how it is to run; what is left out is as the campaign, or the machine, says.

    Raises
    ------
    BoresightError
        If a file, a key, a value or a name is wrong, or more trials are asked for than there are real images.
    """
    chosen = choose_variant(variant)
    campaign = resolve(name, overrides, seed, chosen.name)
    wanted = campaign.spec.trials if trials is None else trials
    processes = workers(jobs, chosen.name)
    _check(campaign, wanted, processes)
    if trial_limit_s is not None and not 0.0 < trial_limit_s < math.inf:
        raise BoresightError(f"--trial-limit {trial_limit_s:g}: give a number of seconds above 0")
    condition = None if until is None else _condition(until, campaign)
    folder = out or RUNS / f"{campaign.spec.name}-{campaign.digest[:8]}"
    if cluster is not None and keep_images:
        raise BoresightError("--keep-images: workers of a cluster cannot write to the run folder: leave it out")
    request = RunRequest(folder, wanted, processes, keep_images, command, cluster, trial_limit_s)
    return Start(campaign, request, condition, chosen.advice)


def _condition(until: str, campaign: ResolvedCampaign) -> Until:
    from campaign.runs.until import parse_until

    return parse_until(until, campaign.spec.experiment)


def _check(campaign: ResolvedCampaign, trials: int, jobs: int) -> None:
    """Refuse none of either, a cratered body that is too large, and more trials than there are real images for."""
    for what, number in (("--trials", trials), ("--jobs", jobs)):
        if number < 1:
            raise BoresightError(f"{what} {number}: give 1 or more")
    for scenario in campaign.scenarios:
        check_craters(scenario)
        limit = trial_limit(scenario)
        if limit is not None and trials > limit:
            raise BoresightError(f"--trials {trials}: {scenario.spec.name} has real images for {limit} trials at most")
