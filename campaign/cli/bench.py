"""``bench``: compare our speed with other software, and measure the cost of a campaign on one core."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.table import Table

from boresight.campaign.cli.main import PEERS
from boresight.campaign.cli.terminal import console
from boresight.campaign.runs.benchmark import WHOLE_TRIAL, Benchmark, benchmark
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.resolve import resolve
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.reading import read_json

_Ratios = dict[tuple[str, str, str], float]


def bench_command(arguments: argparse.Namespace) -> int:
    """Compare speeds with other software, or time the stages of a campaign."""
    if arguments.name in PEERS:
        return _beside_peers(arguments)
    if arguments.check or arguments.record:
        raise BoresightError(f"--check and --record are for ratios to peers, of which {arguments.name!r} has none")
    out = console()
    earlier = {} if arguments.against is None else read_ratios(arguments.against)
    campaign = resolve(arguments.name, arguments.overrides, variant=choose_variant(arguments.variant).name)
    check_campaign(campaign, campaign.spec.trials)
    with tempfile.TemporaryDirectory(prefix="boresight-bench-") as folder:
        found = benchmark(campaign, arguments.blocks, Path(folder), out.print)
    out.print(_table(found, earlier))
    out.print(f"one core, {found.variant}; the yardstick, a Fourier transform, took {1e3 * found.yardstick_s:.1f} ms")
    for whole in (stage for stage in found.stages if stage.stage == WHOLE_TRIAL):
        minutes = campaign.spec.trials * whole.median_s / 60.0
        out.print(f"{whole.scenario}: {campaign.spec.trials} trials take {minutes:.1f} core minutes at that rate")
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(asdict(found), indent=1) + "\n")
    return 0


def _beside_peers(arguments: argparse.Namespace) -> int:
    """Hand over to the benchmarks against other software, which come with the source alone."""
    tests = Path(__file__).parents[2] / "tests"
    if not (tests / "benchmarks").is_dir():
        raise BoresightError(
            f"bench {arguments.name}: what we are compared with comes with the source: run it in a checkout"
        )
    sys.path[:0] = [str(tests), str(tests / "helpers")]
    return int(import_module("benchmarks.door").bench_speed(arguments))


def _table(found: Benchmark, earlier: _Ratios) -> Table:
    heads = ["scenario", "estimator", "stage", "median ms", "quartiles", "x yardstick"]
    table = Table(*heads, *(["change"] if earlier else []), box=None, pad_edge=False)
    for stage in found.stages:
        cells = [
            stage.scenario,
            stage.estimator,
            stage.stage.replace("_", " "),
            f"{1e3 * stage.median_s:.2f}",
            f"{1e3 * stage.low_s:.2f} to {1e3 * stage.high_s:.2f}",
            f"{stage.ratio:.3f}",
        ]
        if earlier:
            before = earlier.get((stage.scenario, stage.estimator, stage.stage))
            cells.append("new" if not before else f"x {stage.ratio / before:.2f}")
        table.add_row(*cells)
    return table


def read_ratios(path: Path) -> _Ratios:
    """Read the ratios of an earlier ``--json``; raise BoresightError where the file is none."""
    try:
        stored: dict[str, Any] = read_json(path, "a result of boresight bench --json")
        return {(s["scenario"], s["estimator"], s["stage"]): float(s["ratio"]) for s in stored["stages"]}
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise BoresightError(f"{path}: is no result of boresight bench --json ({error})") from error
