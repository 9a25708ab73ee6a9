"""Runs a campaign: products first, then blocks of trials on joblib workers, each stored as it comes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

from boresight.campaign.imaging.real_images import left_out_notes
from boresight.campaign.pool.workers import in_order
from boresight.campaign.products import BuiltAssets, BuiltProduct, MissingProduct
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs import manifest as manifests
from boresight.campaign.runs.blocks import Losses, run_block
from boresight.campaign.runs.request import RunRequest
from boresight.campaign.runs.requirements import remember
from boresight.campaign.store import Block, BlockState, RunFolder, blocks, run_lock
from boresight.campaign.trial.kind import Records, WorkerContext, kind_named
from boresight.campaign.trial.methods import unbuilt_products
from boresight.reports.schema.common import FRESH_IMAGE, STORED_IMAGE
from boresight.reports.schema.tables import TABLES
from boresight.scenarios.errors import BoresightError


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
) -> list[BuiltProduct | MissingProduct]:
    """Build what the trials need, before any of them."""
    kind = kind_named(campaign.spec.experiment)
    products: list[BuiltProduct | MissingProduct] = []
    for scenario in campaign.scenarios:
        place = request.out / "products"
        assets = BuiltAssets(scenario, place, request.jobs, campaign.variant, tell, campaign.draft)
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
