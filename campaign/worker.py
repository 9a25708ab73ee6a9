"""What a worker process does with one block of trials."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from campaign.experiments.single_image import ImageSink, Records, SingleImage
from campaign.machine import use_threads
from campaign.products import Shelf
from campaign.resolve import ResolvedCampaign
from campaign.store import TABLES
from campaign.store.atomic import write_atomically
from campaign.store.folder import Block
from campaign.world import open_world
from estimators.registry import estimator_class
from scenarios.errors import BoresightError


@dataclass(frozen=True, slots=True)
class Bench:
    """Where and how a worker works; nothing here may change a row."""

    run: Path
    jobs: int
    keep_images: bool


def run_block(campaign: ResolvedCampaign, block: Block, bench: Bench) -> Records:
    """Run every trial of a block: the records of each table, in the order of trials and estimators."""
    use_threads(bench.jobs)
    experiment = experiment_of(campaign, block.scenario, bench)
    records: Records = {name: [] for name in TABLES}
    for trial in range(block.first, block.last):
        for table, added in experiment.trial(trial).items():
            records[table].extend(added)
    return records


@lru_cache(maxsize=1)
def experiment_of(campaign: ResolvedCampaign, scenario_name: str, bench: Bench) -> SingleImage:
    """Build the experiment once per process and scenario."""
    scenario = campaign.scenario(scenario_name)
    shelf = Shelf(scenario, bench.run / "products", jobs=0, variant=campaign.variant)
    estimators = {
        entry.label: estimator_class(entry.name).from_options(entry.options, shelf)
        for entry in campaign.spec.estimators
    }
    sink = _image_sink(bench.run / "images" / scenario_name) if bench.keep_images else None
    return SingleImage(open_world(scenario, campaign.variant), estimators, campaign.seed, sink)


def _image_sink(folder: Path) -> ImageSink:
    def keep(trial: int, image: NDArray[np.float32]) -> None:
        ok, encoded = cv2.imencode(".tiff", image)
        if not ok:
            raise BoresightError(f"{folder}: the image of trial {trial} could not be encoded as TIFF")
        write_atomically(folder / f"{trial:07d}.tiff", lambda path: _write_bytes(path, encoded.tobytes()))

    return keep


def _write_bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)
