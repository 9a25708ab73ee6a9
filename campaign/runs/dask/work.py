"""Computation of a block on a worker of a cluster: unpack the bundle once, then run as a local worker does."""

from __future__ import annotations

import json
import pickle
import shutil
import tempfile
import threading
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import cast

from distributed import get_worker

from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.machine import cores
from boresight.campaign.pool.workers import in_order
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.dask.bundle import CAMPAIGN, DATA, RUN, Fetch, asset_file, from_scheduler
from boresight.campaign.runs.worker import Losses, run_block
from boresight.campaign.store.folder import Block
from boresight.campaign.trial.kind import Records, WorkerContext, kind_named

# Scenes, meshes and estimators belong to a process and are used by one block at a time, however many threads there are.
_ALONE = threading.Lock()


def run_block_there(bundle: str, block: Block, images_kept: bool, limit_s: float | None) -> Records:
    """Run every trial of a block with what the bundle holds.

    Parameters
    ----------
    bundle
        Digest of the bundle, which the scheduler holds.
    block
        The trials.
    images_kept
        Whether rendered images go to the store of this worker's machine.
    limit_s
        How long a method may work at a trial. With a limit the block runs in a process of its own, which can be ended
        where the method does not stop, while the worker stays.
    """
    with _ALONE, store_switched(images_kept):
        this = get_worker()
        campaign, folder = opened(bundle, from_scheduler, Path(this.local_directory))
        workers = max(1, cores() // max(1, this.state.nthreads))
        context = WorkerContext(folder / RUN, workers, keep_images=False, limit_s=limit_s)
        if limit_s is None:
            return run_block(campaign, block, context)
        again = kind_named(campaign.spec.experiment).process_blocks()
        calls: list[tuple[object, ...]] = [(campaign, block, context, {})]
        # All of it is taken, as what is broken off costs the process.
        (found,) = in_order(1, run_block, calls, apart=True, renew_after=again, after_death=Losses().after)
        return found


@lru_cache(maxsize=1)
def opened(bundle: str, fetch: Fetch, below: Path) -> tuple[ResolvedCampaign, Path]:
    """Lay out a bundle in a folder of this process, and read the campaign so that it finds its data there.

    The folder lies below that of the worker, which Dask removes with it, or later where the worker was killed.
    """
    folder = Path(tempfile.mkdtemp(prefix="boresight-", dir=below))
    index = json.loads(asset_file(bundle, fetch).read_bytes())
    for name, sha256 in index.items():
        target = folder / name
        if not target.resolve().is_relative_to(folder.resolve()):
            raise ValueError(f"{name} leads out of the bundle")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(asset_file(sha256, fetch), target)
    campaign = cast("ResolvedCampaign", pickle.loads((folder / CAMPAIGN).read_bytes()))  # noqa: S301  who sends it may run code here anyway
    scenarios = tuple(replace(scenario, search_dirs=(folder / DATA,)) for scenario in campaign.scenarios)
    # The digest was worked out where the data are; it comes along and stays what it is.
    there = replace(campaign, scenarios=scenarios)
    there.__dict__["digest"] = campaign.digest
    return there, folder
