"""``bench`` without a campaign: one table of our speed beside that of others."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping

from rich.table import Table

from benchmarks.history import HISTORY, Kept, read_history, record, regressions, unrecorded
from benchmarks.ratio import Ratio, SpeedTable
from benchmarks.settings import Settings
from benchmarks.works import names_of, speed_table
from boresight.campaign.cli.terminal import console
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError

EXIT_REGRESSION = 1


def bench_speed(arguments: argparse.Namespace) -> int:
    """Print the table, keep it, and hold it against the history; 1 where a ratio fell too far."""
    if arguments.blocks < 1:
        raise BoresightError(f"--blocks: works are done in turn at least 1 time, not {arguments.blocks}")
    kept = arguments.history or HISTORY
    out, history = console(), read_history(kept)
    settings = Settings(rounds=arguments.blocks, blender=arguments.blender)
    found = speed_table(names_of(arguments.name), settings, lambda name: out.print(f"timing: {name}"))
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
    return _checked(found, history) if arguments.check else 0


def _checked(found: SpeedTable, history: Mapping[str, Kept]) -> int:
    """Say what fell and what cannot be checked; 1 where something fell."""
    out = console()
    for key in unrecorded(found, history):
        out.print(f"not checked, as it has no record: {key}")
    fallen = regressions(found, history)
    for regression in fallen:
        out.print(f"slower: {regression}")
    return EXIT_REGRESSION if fallen else 0


def _table(found: SpeedTable, history: Mapping[str, Kept]) -> Table:
    table = Table("work", "beside", "clock", "ours ms", "theirs ms", "x", "aim", "recorded", "how they agree", box=None)
    for ratio in found.ratios:
        kept = history.get(ratio.key)
        table.add_row(
            ratio.work, ratio.peer, ratio.clock, f"{1e3 * ratio.ours_s:.4g}", f"{1e3 * ratio.peer_s:.4g}",
            _value(ratio), "" if ratio.aim is None else f"{ratio.aim:g}",
            "" if kept is None else f"{kept.ratio:.3g}", ratio.agreement,
        )  # fmt: skip
    return table


def _value(ratio: Ratio) -> str:
    return f"{ratio.value:.3g}" if ratio.same_run else f"{ratio.value:.3g} (another machine)"
