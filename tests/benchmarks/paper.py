"""The stages of landmark recognition beside Table 1 of Rowell et al. (2015), which was measured on another machine."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.ratio import Absent, Ratio
from benchmarks.settings import Settings
from campaign.runs.benchmark import StageTime, benchmark
from campaign.runs.resolve import resolve
from renderers.mitsuba3 import choose_variant
from reports.published import load_published

CAMPAIGN = "quickstart"
_PAPER, _TABLE = "rowell2015-simulated", "table 1"
_AIM = 500.0


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
    for stage, seconds in ours.items():
        yield _beside(stage.replace("_", " "), seconds, printed[stage])
    yield _beside("in all", sum(ours.values()), sum(printed[stage] for stage in ours), _AIM)


def _counts(stage: StageTime, printed: dict[str, float]) -> bool:
    return stage.stage in printed and bool(stage.estimator)


def _beside(what: str, ours_s: float, theirs_s: float, aim: float | None = None) -> Ratio:
    work, note = f"recognition, {what}", f"a 2.4 GHz Core i5; ours on {CAMPAIGN}, one core"
    return Ratio(work, "Rowell et al. (2015), table 1", "wall", ours_s, theirs_s, aim, note, same_run=False)
