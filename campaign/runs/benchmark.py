"""Cost of a campaign on one core: time of each stage of a trial, relative to a yardstick of the same process.

A time by itself says as much of the machine and its other guests as of the program. So after each block of trials a
fixed piece of work is timed, the yardstick, and a stage is told by its ratio to it as well.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from boresight.campaign.imaging.image_store import store_switched
from boresight.campaign.machine import describe, package_versions
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.trial.kind import Records, kind_named
from boresight.reports.schema.column import FRESH_IMAGE
from boresight.scenarios.errors import BoresightError

WHOLE_TRIAL = "whole trial"
_YARDSTICK_PX = 1024
_YARDSTICKS = 5


@dataclass(frozen=True, slots=True)
class StageTime:
    """A stage of a trial: median time with its quartiles, and the median as a multiple of the yardstick.

    ``estimator`` is '' for what all of them share. The stage ``whole trial`` is everything between two stored trials,
    the writing included; it is known for blocks alone, so its quartiles are those of the blocks' means.
    """

    scenario: str
    estimator: str
    stage: str
    median_s: float
    low_s: float
    high_s: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Benchmark:
    """The times of all stages, and what they were taken on."""

    campaign: str
    digest: str
    variant: str
    trials: int
    yardstick_s: float
    stages: tuple[StageTime, ...]
    machine: Mapping[str, object]
    versions: Mapping[str, str]


@dataclass(slots=True)
class _Clock:
    """Listens to a run: keeps the stages' times and those of whole blocks, and measures with the yardstick between."""

    tell: Callable[[str], None]
    timings: list[pd.DataFrame] = field(default_factory=list)
    blocks: list[dict[str, object]] = field(default_factory=list)
    yardsticks_s: list[float] = field(default_factory=list)
    _last: float = 0.0

    def message(self, text: str) -> None:
        self.tell(text)

    def started(self, done: int, total: int) -> None:
        del done, total
        self._last = time.perf_counter()

    def block(self, records: Records, trials: int) -> None:
        seconds = (time.perf_counter() - self._last) / trials
        scenario = records["rows"][0]["scenario"]
        # The first block of a scenario opens its world and compiles its kernels.
        if any(block["scenario"] == scenario for block in self.blocks):
            self.timings.append(pd.DataFrame(records["timings"]))
        self.blocks.append({"scenario": scenario, "seconds": seconds})
        self.yardsticks_s += [yardstick_s() for _ in range(_YARDSTICKS)]
        self._last = time.perf_counter()


def yardstick_s() -> float:
    """Time a two-dimensional Fourier transform of fixed size."""
    image = np.ones((_YARDSTICK_PX, _YARDSTICK_PX))
    began = time.perf_counter()
    np.fft.rfft2(image)
    return time.perf_counter() - began


def benchmark(campaign: ResolvedCampaign, blocks: int, folder: Path, tell: Callable[[str], None]) -> Benchmark:
    """Run some blocks of trials of each scenario on one core, rendering every image, and time them.

    One more block goes before them. Products are built or taken from the cache first, which is not timed. ``folder`` is
    an empty one for the run; ``tell`` is called with each step.
    """
    if blocks < 1:
        raise BoresightError(f"a benchmark needs at least 1 block of trials, not {blocks}")
    trials = (blocks + 1) * kind_named(campaign.spec.experiment).block_trials
    clock = _Clock(tell)
    with one_core(), store_switched(on=False):
        run_campaign(campaign, RunRequest(folder, trials, jobs=1), clock)
    yardstick = float(np.median(clock.yardsticks_s))
    stages = _stages(pd.concat(clock.timings, ignore_index=True), yardstick)
    whole = _whole(pd.DataFrame(clock.blocks), yardstick)
    about = (campaign.spec.name, campaign.digest, campaign.variant, trials, yardstick)
    return Benchmark(*about, (*stages, *whole), describe(), package_versions())


def _stages(timings: pd.DataFrame, yardstick: float) -> Iterator[StageTime]:
    """Yield each stage of each estimator, summed over its turns in a trial; the image once, as all share it."""
    shared = timings["stage"] == FRESH_IMAGE
    first = timings["estimator"] == timings["estimator"].iloc[0]
    own = timings[~shared | first].assign(estimator=timings["estimator"].where(~shared, ""))
    totals = own.groupby(["scenario", "estimator", "stage", "trial"], sort=False)["seconds"].sum()
    for key, seconds in totals.groupby(level=[0, 1, 2], sort=False):
        yield _stage(key, seconds, yardstick)


def _whole(blocks: pd.DataFrame, yardstick: float) -> Iterator[StageTime]:
    for scenario, group in blocks.groupby("scenario", sort=False):
        yield _stage((str(scenario), "", WHOLE_TRIAL), group["seconds"].iloc[1:], yardstick)


def _stage(key: tuple[str, str, str], seconds: pd.Series, yardstick: float) -> StageTime:
    low, median, high = (float(q) for q in np.percentile(seconds, [25.0, 50.0, 75.0]))
    return StageTime(*key, median, low, high, median / yardstick)


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process to one core where the system can, so that times are those of a worker among many."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
