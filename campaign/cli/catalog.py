"""``list``, ``show``, ``validate`` and ``schema``: print or check campaigns and scenarios before they run."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from campaign.cli.terminal import console
from campaign.machine import cores
from campaign.runs.read import CATALOG, campaign_names, read_campaign
from campaign.trial.kind import kind_names
from scenarios.designs import grid_cells
from scenarios.errors import printable
from scenarios.load import (
    LoadedCampaign,
    LoadedScenario,
    canonical_json,
    dump_yaml,
    file_kind,
    json_schema,
    load_campaign,
    load_scenario,
    scenario_names,
)

_INDENT = 4
_GAP = "  "
_LEAST = 24
"""Characters that the last column, and what an entry is, have at least; a terminal that is narrower wraps them."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What stands in the list.

    Parameters
    ----------
    cells
        Its name, and what is told of it in short; the last may be long.
    what
        A sentence about it.
    """

    cells: tuple[str, ...]
    what: str


def print_entries(out: Console, heads: Sequence[str], entries: Sequence[Entry]) -> None:
    """Print entries under their headings.

    In a terminal an entry has a line of its cells, the last wrapped in its column, and what it is below. Elsewhere it
    has one line, what it is before the last cell: for a program, or a pager that moves to the right.
    """
    table = [tuple(heads), *(tuple(map(printable, one.cells)) for one in entries)]
    widths = [max(map(len, column)) for column in list(zip(*table, strict=True))[:-1]]
    if not out.is_terminal:
        whats = ["what it is", *(printable(one.what) for one in entries)]
        widths = [*widths, max(map(len, whats))]
        for cells, what in zip(table, whats, strict=True):
            _print_line(out, _columns((*cells[:-1], what, cells[-1]), widths))
        return
    _print_line(out, Text(_columns(table[0], widths), style="underline"))
    for cells, one in zip(table[1:], entries, strict=True):
        first, *further = _wrapped(cells, widths, out.width)
        _print_line(out, Text.assemble((cells[0], "bold"), first[len(cells[0]) :]))
        for line in (*further, *_indented(printable(one.what), out.width)):
            _print_line(out, line)


def _print_line(out: Console, line: str | Text) -> None:
    """Print a line as it is: its width is known to fit."""
    out.print(line, soft_wrap=True, highlight=False)


def _wrapped(cells: Sequence[str], widths: Sequence[int], width: int) -> list[str]:
    """Lay cells out, the last wrapped in what the others leave of a line."""
    before = _columns((*cells[:-1], "|"), widths)[:-1]
    width = max(width, len(before) + _LEAST)
    after = " " * len(before)
    lines = textwrap.wrap(cells[-1], width, initial_indent=before, subsequent_indent=after, break_on_hyphens=False)
    return lines or [before.rstrip()]


def _indented(text: str, width: int) -> list[str]:
    margin = " " * _INDENT
    return textwrap.wrap(text, max(width, _LEAST), initial_indent=margin, subsequent_indent=margin)


def _columns(cells: Sequence[str], widths: Sequence[int]) -> str:
    *padded, last = cells
    return _GAP.join([*(f"{cell:<{width}}" for cell, width in zip(padded, widths, strict=True)), last]).rstrip(" ")


def list_command(_: argparse.Namespace) -> int:
    """List campaigns, scenarios and estimators."""
    # Imported here: they read what is installed, which no other command of this file does.
    from estimators.registry import estimator_names
    from estimators.slam.registry import sequence_estimator_names

    out, known = console(), {name: load_scenario(name) for name in scenario_names()}
    campaigns = [_campaign_entry(load_campaign(name, CATALOG), known) for name in campaign_names()]
    print_entries(out, ("campaign", "trials", "time here", "needs"), campaigns)
    out.print(
        f"\ntrials: of each scenario, x scenarios. time here: on {cores()} core(s), data bases aside, by the rate of"
        " the last run on this machine; - where there was none. needs: what is read from the data folder"
        " (boresight fetch --list), and packages that are optional.\n"
    )
    scenarios = [Entry((name, ""), scenario.spec.description) for name, scenario in known.items()]
    print_entries(out, ("scenario", ""), scenarios)
    out.print(f"\nestimators: {', '.join(estimator_names())}")
    out.print(f"estimators of sequences: {', '.join(sequence_estimator_names())}")
    return 0


def _campaign_entry(loaded: LoadedCampaign, known: Mapping[str, LoadedScenario]) -> Entry:
    """Describe a campaign by its size, its cost here and its needs."""
    from campaign.runs.requirements import needs, rate_of

    spec, rate = loaded.spec, rate_of(loaded.spec.name)
    scenarios = len(spec.scenarios) * (1 if spec.grid is None else len(grid_cells(spec.grid)))
    size = f"{spec.trials}" if scenarios == 1 else f"{spec.trials} x {scenarios}"
    time = "-" if rate is None else rate.describe(spec.trials * scenarios, cores())
    return Entry((spec.name, size, time, ", ".join(map(str, needs(loaded, known))) or "-"), spec.title)


def show_command(arguments: argparse.Namespace) -> int:
    """Print a campaign or a scenario as YAML, every default filled in."""
    if _is_campaign(arguments.name):
        campaign = read_campaign(arguments.name, arguments.overrides, embedded=arguments.embedded)
        shown = {
            "campaign": json.loads(canonical_json(campaign.loaded.spec)),
            "scenarios": [json.loads(canonical_json(s.spec)) for s in campaign.scenarios],
        }
    else:
        shown = {"scenario": json.loads(canonical_json(load_scenario(arguments.name, arguments.overrides).spec))}
    console().print(dump_yaml(shown), end="", highlight=False)
    return 0


def validate_command(arguments: argparse.Namespace) -> int:
    """Check a campaign or a scenario file as a run does before anything is built."""
    # Imported here: they load kinds of trial and estimators, 1.5 s, which the other commands do without.
    from campaign.runs.check import check_campaign, check_scenario
    from campaign.runs.resolve import resolve

    if _is_campaign(arguments.file):
        campaign = resolve(arguments.file, arguments.overrides, embedded=arguments.embedded)
        check_campaign(campaign, campaign.spec.trials)
        what = f"a campaign of {len(campaign.scenarios)} scenario(s) and {len(campaign.labels)} estimator(s)"
    else:
        scenario = load_scenario(arguments.file, arguments.overrides)
        check_scenario(scenario)
        what = f"the scenario {scenario.spec.name}"
    console().print(f"{arguments.file}: ok, {what}")
    return 0


def _is_campaign(name: str) -> bool:
    """Tell campaigns from scenarios: by the catalogue first, by the keys of the file otherwise."""
    if name in campaign_names():
        return True
    if name in scenario_names():
        return False
    return file_kind(Path(name), campaign_names()) == "campaign"


def schema_command(arguments: argparse.Namespace) -> int:
    """Print the JSON Schema of scenario or campaign files."""
    schema = json_schema(arguments.kind)
    if arguments.kind == "campaign":
        _list_kinds(schema)
    console().print(json.dumps(schema, indent=1), highlight=False)
    return 0


def _list_kinds(schema: dict[str, Any]) -> None:
    """Restrict ``experiment`` in the schema of campaigns to the known kinds of trial.

    The models of files are in `scenarios`, which does not import the kinds of trial; so they are added here.
    """
    for definition in schema["$defs"].values():
        experiment = definition.get("properties", {}).get("experiment")
        if experiment is not None:
            experiment["enum"] = kind_names()
