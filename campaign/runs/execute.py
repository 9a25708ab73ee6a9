"""Runs a campaign: products first, then blocks of trials on joblib workers, each stored as it comes.

A block whose process ended is repeated; a method that ended it twice is stored as an error.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from boresight.campaign.imaging.real_images import left_out_notes
from boresight.campaign.pool.guard import ENDED, Call, Loss, guarding, last_call, over_time
from boresight.campaign.pool.workers import in_order, no_replacement
from boresight.campaign.products import BuiltAssets, Prepared
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs import manifest as manifests
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.read import remember
from boresight.campaign.store import Block, BlockState, RunFolder, blocks, run_lock
from boresight.campaign.threads import use_threads
from boresight.campaign.trial.kind import PerDatabase, Records, WorkerContext, kind_named
from boresight.campaign.trial.runner import unbuilt_products
from boresight.reports.schema.column import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.bodies import Body
from boresight.scenarios.errors import BoresightError

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


class Listener(Protocol):
    """Receives the progress of a run."""

    def message(self, text: str) -> None:
        """Hear of a step."""

    def started(self, done: int, total: int) -> None:
        """Hear how many trials are stored already and how many there are in all."""

    def block(self, records: Records, trials: int) -> None:
        """Hear of a block that is now stored."""


def run_campaign(campaign: ResolvedCampaign, request: RunRequest, listener: Listener) -> RunFolder:
    """Run what is not stored yet and return the run folder.

    Raise BoresightError if the folder holds another run, is in use, or cannot be written.
    """
    folder = RunFolder(request.out)
    with run_lock(request.out):
        folder.sweep()
        previous = _previous(folder, campaign)
        for note in (note for scenario in campaign.scenarios for note in left_out_notes(scenario)):
            listener.message(note)
        products = build_products(campaign, request, listener.message)
        manifest = manifests.make_manifest(campaign, request, products, previous)
        for note in manifests.missing_notes(products):
            listener.message(note)
        folder.write_manifest(manifest)

        size = kind_named(campaign.spec.experiment).block_trials
        every = list(blocks([s.spec.name for s in campaign.scenarios], request.trials, size))
        states = [folder.state(block, len(campaign.labels)) for block in every]
        todo = [block for block, state in zip(every, states, strict=True) if state is not BlockState.WHOLE]
        bad = [block for block, state in zip(every, states, strict=True) if state is BlockState.DAMAGED]
        if bad:
            listener.message(
                f"{len(bad)} of {len(every)} stored blocks are not what was stored (the first: {bad[0].file_name}):"
                f" {sum(block.trials for block in bad)} trials are run again"
            )
        total, left = (sum(block.trials for block in some) for some in (every, todo))
        listener.started(total - left, total)

        images: Counter[object] = Counter()
        began = time.monotonic()
        for block, records in zip(todo, _computed(campaign, todo, request, listener), strict=True):
            folder.write_block(block, records, campaign.spec.experiment)
            ways = (FRESH_IMAGE, STORED_IMAGE)  # all methods see the same image
            images.update({r["trial"]: r["stage"] for r in records["timings"] if r["stage"] in ways}.values())
            listener.block(records, block.trials)
        if not campaign.overrides:
            remember(campaign.spec.name, left, time.monotonic() - began, request.jobs)
        if images:
            fresh, kept = images[FRESH_IMAGE], images[STORED_IMAGE]
            listener.message(f"images: {fresh} rendered or read, {kept} from the store")
        folder.write_manifest(manifests.updated(manifest, finished=manifests.now(manifest)))
        folder.write_data_package(campaign.spec.experiment)
    return folder


def _previous(folder: RunFolder, campaign: ResolvedCampaign) -> dict[str, Any] | None:
    """Return the manifest of an earlier start of the same run, None without one; refuse another run's folder."""
    manifest = folder.read_manifest()
    if manifest is None:
        if any((folder.path / name).exists() for name in TABLES):
            raise BoresightError(f"{folder.path}: has tables but no manifest: choose another folder with --out")
        return None
    if manifest["digest"] != campaign.digest:
        raise BoresightError(
            f"{folder.path}: holds another run ({manifest.get('name')}, digest {manifest['digest'][:8]}, not"
            f" {campaign.digest[:8]}): choose another folder with --out"
        )
    return manifest


def build_products(
    campaign: ResolvedCampaign, request: RunRequest, tell: Callable[[str], None] | None
) -> list[Prepared]:
    """Build what the trials need, before any of them."""
    kind = kind_named(campaign.spec.experiment)
    products, kept = list[Prepared](), list[Body]()
    for scenario in campaign.scenarios:
        place = request.out / "products"
        assets = BuiltAssets(scenario, place, request.jobs, campaign.variant, tell, campaign.draft, kept=kept)
        products += unbuilt_products(scenario, kind.build_methods(campaign, scenario))
        products += kind.prepare(campaign, scenario, assets)
    return products


def _computed(
    campaign: ResolvedCampaign, todo: Sequence[Block], request: RunRequest, listener: Listener
) -> Iterator[Records]:
    """Return an iterator over the records of each block, in order, which holds only what is in flight."""
    if request.cluster is not None:
        # Imported here: Dask is optional, and slow to import.
        from boresight.campaign.runs.dask import blocks_in_order

        return blocks_in_order(request.cluster, campaign, request.out, todo, request.limit_s)
    context = WorkerContext(request.out, request.jobs, request.keep_images, request.limit_s)
    return in_order(
        request.jobs,
        run_block,
        ((campaign, block, context, {}) for block in todo),
        apart=request.limit_s is not None,
        renew_after=kind_named(campaign.spec.experiment).process_blocks(),
        after_death=Losses(listener.message).after,
    )
