"""``bench`` without a campaign: the comparisons by name, and one table of our speed beside that of others."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from rich.table import Table

from benchmarks import ceres
from benchmarks.images import image_ratios, plain_ratios, scaling_ratios
from benchmarks.methods import combined_ratios, crater_ratios, method_ratios
from benchmarks.ratio import HISTORY, Absent, Kept, Ratio, SpeedTable, checked, read_history, record
from benchmarks.rays import ray_ratios
from benchmarks.sequences import adjustment_ratios, kernel_ratios, smoother_ratios
from benchmarks.size import size_ratios
from benchmarks.timing import Settings
from boresight.campaign.cli.terminal import console
from boresight.campaign.machine import describe, package_versions, processor
from boresight.campaign.runs.benchmark import benchmark
from boresight.campaign.runs.manifest import commit_here, now
from boresight.campaign.runs.resolve import resolve
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.published import load_published
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError

EXIT_REGRESSION = 1
CAMPAIGN = "quickstart"


def recognition_ratios(settings: Settings) -> Iterator[Ratio | Absent]:
    """Time the stages of a recognised image of the embedded body, beside table 1 of Rowell et al. (2015), as context.

    512 x 512 pixels at 2 km, as in the paper, on another machine. Stage by stage alone: nearly all of the paper's time
    is its renderer, so that a ratio of the sums compares renderers.
    """
    campaign = resolve(CAMPAIGN, (), variant=choose_variant().name)
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as folder:
        found = benchmark(campaign, settings.rounds, Path(folder), lambda _: None)
    printed = {
        value.stage: value.value
        for value in load_published("rowell2015-simulated").values
        if value.measure == "seconds" and value.place.startswith("table 1")
    }
    ours = {one.stage: one.median_s for one in found.stages if one.stage in printed and one.estimator}
    whole_s = sum(printed[stage] for stage in ours)
    for stage, seconds in ours.items():
        work = f"recognition, {stage.replace('_', ' ')}"
        note = f"a 2.4 GHz Core i5, {printed[stage] / whole_s:.0%} of its time; ours on {CAMPAIGN}, one core"
        peer = "Rowell et al. (2015), table 1"
        yield Ratio(work, peer, "wall", seconds, printed[stage], agreement=note, same_run=False)


WORKS: Mapping[str, Callable[[Settings], Iterator[Ratio | Absent]]] = MappingProxyType(
    {
        "plain": plain_ratios,
        "kernels": kernel_ratios,
        "images": image_ratios,
        "rays": ray_ratios,
        "adjustment": adjustment_ratios,
        "smoother": smoother_ratios,
        "methods": method_ratios,
        "craters": crater_ratios,
        "combined": combined_ratios,
        "recognition": recognition_ratios,
        "scaling": scaling_ratios,
        "size": size_ratios,
    }
)
GROUPS: Mapping[str, Sequence[str]] = MappingProxyType({"all": tuple(WORKS), "quick": ("plain", "kernels")})


def bench_speed(arguments: argparse.Namespace) -> int:
    """Print the table, keep it, and hold it against the history; 1 where a ratio fell too far."""
    if arguments.blocks < 1:
        raise BoresightError(f"--blocks: works are done in turn at least 1 time, not {arguments.blocks}")
    kept = arguments.history or HISTORY
    out, history = console(), read_history(kept, processor())
    settings = Settings(rounds=arguments.blocks, blender=arguments.blender)
    names = GROUPS.get(arguments.name, (arguments.name,) if arguments.name in WORKS else ())
    found = speed_table(names, settings, lambda name: out.print(f"timing: {name}"))
    out.print(_table(found, history))
    for absent in found.absent:
        out.print(f"not compared: {absent.work}: {absent.why}")
    machine = found.machine
    out.print(
        f"{machine['processor']}, {machine['cores']} core(s), load {machine['load_before']} to {machine['load_after']}"
    )
    out.print(", ".join(f"{name} {version}" for name, version in found.versions.items()))
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(found.plain(), indent=1) + "\n")
    if arguments.record:
        out.print(f"{record(found, kept)} ratio(s) recorded in {kept}")
    if not arguments.check:
        return 0
    unrecorded, failed = checked(found, history)
    for key in unrecorded:
        out.print(f"not checked, as it has no record of this processor (--record makes one): {key}")
    for line in failed:
        out.print(f"failed: {line}")
    return EXIT_REGRESSION if failed else 0


def speed_table(names: Sequence[str], settings: Settings, tell: Callable[[str], None]) -> SpeedTable:
    """Do works, keys of ``WORKS``, one after the other, and gather the ratios; ``tell`` is called as each begins."""
    found: list[Ratio | Absent] = []
    before = os.getloadavg()[0]
    for name in names:
        tell(name)
        found += WORKS[name](settings)
    return SpeedTable(
        tuple(item for item in found if isinstance(item, Ratio)),
        tuple(item for item in found if isinstance(item, Absent)),
        commit_here(),
        now(),
        {**describe(), "load_before": round(before, 2), "load_after": round(os.getloadavg()[0], 2)},
        package_versions()
        | {name: _version(lambda name=name: version(name)) for name in ("gtsam", "embreex")}
        | {"Ceres": _version(ceres.version)},
    )


def _version(of: Callable[[], str]) -> str:
    try:
        return of()
    except (PackageNotFoundError, BoresightError):
        return "absent"


def _table(found: SpeedTable, history: Mapping[str, Kept]) -> Table:
    table = Table("work", "beside", "clock", "ours ms", "theirs ms", "x", "aim", "recorded", "how they agree", box=None)
    for ratio in found.ratios:
        kept = history.get(ratio.key)
        table.add_row(
            ratio.work, ratio.peer, ratio.clock, f"{1e3 * ratio.ours_s:.4g}", f"{1e3 * ratio.peer_s:.4g}",
            f"{ratio.value:.3g}" if ratio.same_run else f"{ratio.value:.3g} (another machine)",
            "" if ratio.aim is None else f"{ratio.aim:g}", "" if kept is None else f"{kept.ratio:.3g}", ratio.agreement,
        )  # fmt: skip
    return table
