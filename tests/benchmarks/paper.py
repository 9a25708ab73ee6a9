"""The stages of landmark recognition beside Table 1 of Rowell et al. (2015), as context: another machine and renderer.

Stage by stage alone: nearly all of the paper's time is its renderer, so that a ratio of the sums compares renderers.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.ratio import Absent, Ratio
from benchmarks.settings import Settings
from boresight.campaign.runs.benchmark import StageTime, benchmark
from boresight.campaign.runs.resolve import resolve
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.published import load_published

CAMPAIGN = "quickstart"
_PAPER, _TABLE = "rowell2015-simulated", "table 1"


def recognition_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time the stages of a recognised image of the embedded body: 512 x 512 pixels at 2 km, as in the paper."""
    campaign = resolve(CAMPAIGN, (), variant=choose_variant().name)
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as folder:
        found = benchmark(campaign, settings.rounds, Path(folder), lambda _: None)
    printed = {
        value.stage: value.value
        for value in load_published(_PAPER).values
        if value.measure == "seconds" and value.place.startswith(_TABLE)
    }
    ours = {stage.stage: stage.median_s for stage in found.stages if _counts(stage, printed)}
    whole_s = sum(printed[stage] for stage in ours)
    for stage, seconds in ours.items():
        work = f"recognition, {stage.replace('_', ' ')}"
        note = f"a 2.4 GHz Core i5, {printed[stage] / whole_s:.0%} of its time; ours on {CAMPAIGN}, one core"
        peer = "Rowell et al. (2015), table 1"
        yield Ratio(work, peer, "wall", seconds, printed[stage], agreement=note, same_run=False)


def _counts(stage: StageTime, printed: dict[str, float]) -> bool:
    return stage.stage in printed and bool(stage.estimator)
