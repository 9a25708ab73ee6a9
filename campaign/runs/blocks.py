"""Computation of a block of trials in a worker process, and what is repeated when such a process ends."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from boresight.campaign.pool.guard import ENDED, Call, Loss, guarding, last_call, over_time
from boresight.campaign.pool.workers import no_replacement
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import Block
from boresight.campaign.threads import use_threads
from boresight.campaign.trial.kind import PerDatabase, Records, WorkerContext
from boresight.reports.schema.tables import TABLES

Tell = Callable[[str], None]

_TRIES = 3
_log = logging.getLogger("campaign")


class BlockCall(NamedTuple):
    """Arguments of `run_block`."""

    campaign: ResolvedCampaign
    block: Block
    context: WorkerContext
    lost: Mapping[Call, Loss]


class Losses:
    """Remembers which methods and blocks lost their process; it grows with these alone.

    A method that hung is not tried again, nor one that lost its process twice: something else may have killed the
    first. A block that loses its process outside of any method is tried a few times.
    """

    def __init__(self, tell: Tell = _log.warning) -> None:
        self._tell = tell
        self._calls: Counter[Call] = Counter()
        self._blocks: Counter[Block] = Counter()

    def after(self, lost: Sequence[tuple[Any, ...]], note: Path) -> list[tuple[Any, ...]]:
        """Return the arguments of `run_block` to go on with.

        Raise BoresightError if a block loses its process again and again and no method is to blame.
        """
        blocks = [BlockCall(*arguments) for arguments in lost]
        found = last_call(note)
        at = next(
            (one for one in blocks if found is not None and one.block.holds(found[0].scenario, found[0].trial)), None
        )
        if found is None or at is None:
            block = blocks[0].block
            self._blocks[block] += 1
            if self._blocks[block] == _TRIES:
                return list(no_replacement(lost, note))
            self._tell(
                f"trials {block.first} to {block.last - 1} of {block.scenario}: their process ended: tried again"
            )
            return list(lost)
        call, trace = found
        self._calls[call] += 1
        what = f"trial {call.trial} of {call.scenario}, {call.label}"
        if not trace and self._calls[call] == 1:
            self._tell(f"{what}: its process ended (killed, or crashed): tried again in another")
            return list(lost)
        why = "does not stop when its time is over, so its process was ended" if trace else "ended its process again"
        self._tell(f"{what}: {why}: stored as an error")
        loss = Loss(over_time(at.context.limit_s) if trace else ENDED, trace)
        return [one._replace(lost={**one.lost, call: loss}) if one is at else one for one in blocks]


def run_block(
    campaign: ResolvedCampaign, block: Block, context: WorkerContext, lost: Mapping[Call, Loss] = MappingProxyType({})
) -> Records:
    """Run every trial of a block: the records of each table, in the order of trials and estimators.

    ``lost`` are those that ended the process that they were in: they are not tried again.
    """
    with guarding(limit_s=context.limit_s, lost=lost):
        found = trials_of(campaign, block.scenario, context).run(range(block.first, block.last))
    return {name: found.get(name, []) for name in TABLES}


@lru_cache(maxsize=1)
def trials_of(campaign: ResolvedCampaign, scenario_name: str, context: WorkerContext) -> PerDatabase:
    """Open the trials once per process and scenario, with the threads that rows are worked out with.

    Whoever works a trial out again needs them as well: matrices multiplied by more threads differ in their last bits.
    """
    use_threads(context.jobs)
    return PerDatabase.open(campaign, campaign.scenario(scenario_name), context)


def opened(campaign: ResolvedCampaign, scenario: str, run: Path, trial: int = 0) -> Any:
    """Open the trials of a stored run that one trial is of; their class is that of the kind of trial."""
    return trials_of(campaign, scenario, WorkerContext(run, 1, keep_images=False)).of(trial)
