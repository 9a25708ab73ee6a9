"""What a worker process does with one block of trials."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from campaign.machine import use_threads
from campaign.pool.guard import Call, Loss, guarding
from campaign.resolved import ResolvedCampaign
from campaign.store import TABLES
from campaign.store.folder import Block
from campaign.trial.in_turn import part_of
from campaign.trial.kind import Bench, Records, Trials, kind_named

T = TypeVar("T")

_TRIALS_OF_A_PROCESS = 1000


def renew_after(block_trials: int) -> int:
    """Return after how many blocks a worker makes room for a fresh one, so that nothing leaks for ever.

    Mitsuba has been reported to fail after some thousands of renderings in one process.
    """
    return max(1, _TRIALS_OF_A_PROCESS // block_trials)


def run_block(
    campaign: ResolvedCampaign, block: Block, bench: Bench, lost: Mapping[Call, Loss] = MappingProxyType({})
) -> Records:
    """Run every trial of a block: the records of each table, in the order of trials and estimators.

    ``lost`` are those that ended the process that they were in: they are not tried again.
    """
    with guarding(limit_s=bench.limit_s, lost=lost):
        found = trials_of(campaign, block.scenario, bench).run(range(block.first, block.last))
    return {name: found.get(name, []) for name in TABLES}


@lru_cache(maxsize=1)
def trials_of(campaign: ResolvedCampaign, scenario_name: str, bench: Bench) -> Trials:
    """Open the trials once per process and scenario, with the threads that rows are worked out with.

    Whoever works a trial out again needs them as well: matrices multiplied by more threads differ in their last bits.
    """
    use_threads(bench.jobs)
    return kind_named(campaign.spec.experiment).open(campaign, campaign.scenario(scenario_name), bench)


def opened(campaign: ResolvedCampaign, scenario: str, run: Path, kind: type[T], trial: int = 0) -> T:
    """Open the trials of a stored run that one trial is of, which are of a class that their kind knows."""
    trials = trials_of(campaign, scenario, Bench(run, 1, keep_images=False))
    found = part_of(trials, kind, trial)
    if found is None:
        raise TypeError(f"{run} holds trials of {type(trials).__name__}, not of {kind.__name__}")
    return found
