"""``list``, ``show``, ``validate`` and ``schema``: campaigns and scenarios before they run."""

from __future__ import annotations

import argparse
import json
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from campaign.cli.listing import Entry, print_entries
from campaign.cli.terminal import console
from campaign.machine import cores
from campaign.runs.costs import rate_of
from campaign.runs.needs import data_needed
from campaign.runs.resolve import CATALOG, campaign_names, resolve
from campaign.trial.kind import kind_names
from estimators.registry import estimator_names
from estimators.slam.registry import sequence_estimator_names
from scenarios.designs import grid_cells
from scenarios.load import (
    LoadedCampaign,
    canonical_json,
    file_kind,
    json_schema,
    load_campaign,
    load_scenario,
    scenario_names,
)


def list_command(_: argparse.Namespace) -> int:
    """List campaigns, scenarios and estimators."""
    out = console()
    campaigns = [_campaign_entry(load_campaign(name, CATALOG)) for name in campaign_names()]
    print_entries(out, ("campaign", "trials", "time here", "data"), campaigns)
    out.print(
        f"\ntrials: of each scenario, x scenarios. time here: on {cores()} core(s), data bases aside, by the rate of"
        " the last run on this machine; - where there was none. data: what is read from the data folder"
        " (boresight fetch --list).\n"
    )
    scenarios = [Entry((name, ""), load_scenario(name).spec.description) for name in scenario_names()]
    print_entries(out, ("scenario", ""), scenarios)
    out.print(f"\nestimators: {', '.join(estimator_names())}")
    out.print(f"estimators of sequences: {', '.join(sequence_estimator_names())}")
    return 0


def _campaign_entry(loaded: LoadedCampaign) -> Entry:
    """Tell of a campaign its size, its cost here and its data."""
    spec, rate = loaded.spec, rate_of(loaded.spec.name)
    scenarios = len(spec.scenarios) * (1 if spec.grid is None else len(grid_cells(spec.grid)))
    size = f"{spec.trials}" if scenarios == 1 else f"{spec.trials} x {scenarios}"
    time = "-" if rate is None else rate.describe(spec.trials * scenarios, cores())
    return Entry((spec.name, size, time, ", ".join(map(str, data_needed(loaded))) or "-"), spec.title)


def show_command(arguments: argparse.Namespace) -> int:
    """Print a campaign or a scenario as YAML, every default filled in."""
    if _is_campaign(arguments.name):
        campaign = resolve(arguments.name, arguments.overrides)
        shown = {
            "campaign": json.loads(canonical_json(campaign.spec)),
            "scenarios": [json.loads(canonical_json(s.spec)) for s in campaign.scenarios],
        }
    else:
        shown = {"scenario": json.loads(canonical_json(load_scenario(arguments.name, arguments.overrides).spec))}
    yaml = YAML()
    yaml.default_flow_style = None
    text = StringIO()
    yaml.dump(shown, text)
    console().print(text.getvalue(), end="", highlight=False)
    return 0


def validate_command(arguments: argparse.Namespace) -> int:
    """Check a campaign or a scenario file."""
    if _is_campaign(arguments.file):
        campaign = resolve(arguments.file, arguments.overrides)
        what = f"a campaign of {len(campaign.scenarios)} scenario(s) and {len(campaign.labels)} estimator(s)"
    else:
        what = f"the scenario {load_scenario(arguments.file, arguments.overrides).spec.name}"
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
