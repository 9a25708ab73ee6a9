"""``sensitivity``: how much of an error's variation each of several keys explains."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.catalog import add_overrides
from campaign.cli.progress import ProgressListener
from campaign.cli.runs import positive
from campaign.cli.terminal import console
from campaign.machine import workers
from campaign.runs.request import RunRequest
from campaign.runs.resolve import resolve
from campaign.runs.runner import run_campaign
from campaign.runs.start import RUNS
from renderers.mitsuba3 import choose_variant
from scenarios.atomic import explain_write_error
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

_TRIALS, _SAMPLES = 20, 16


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    own = commands.add_parser("sensitivity", help="vary keys of a campaign's scenario together, and tell what matters")
    own.add_argument("name", help="a campaign, or a YAML file")
    own.add_argument("--scenario", help="of this scenario, where the campaign has several")
    own.add_argument(
        "--over", action="append", required=True, metavar="KEY=LOW:HIGH",
        help="vary this key; KEY.max is the bound of a uniform distribution (several keys: give it again)",
    )  # fmt: skip
    own.add_argument("--method", choices=["sobol", "latin-hypercube"], default="sobol", help="design of the samples")
    own.add_argument(
        "--samples", type=positive, default=_SAMPLES,
        help=f"size of the design (default: {_SAMPLES}; Sobol's runs K + 2 times as many scenarios for K keys)",
    )  # fmt: skip
    own.add_argument("--trials", type=positive, default=_TRIALS, help=f"of each sample (default: {_TRIALS})")
    own.add_argument("--metric", default=None, help="as of compare (default: the position error)")
    own.add_argument("--statistic", default="median", help="over the trials: median, mean, rms, p75, p95 or p99")
    own.add_argument("--jobs", type=positive, help="worker processes (default: one for each core, or GPU)")
    own.add_argument("--seed", type=int, help="seed (default: what the campaign says)")
    own.add_argument("--out", type=Path, help="run folder (default: runs/NAME-sensitivity-DIGEST)")
    add_overrides(own)
    own.set_defaults(handler=_sensitivity)


def _sensitivity(arguments: argparse.Namespace) -> int:
    # Imported here: SALib and Matplotlib take seconds, and most commands need neither.
    from campaign.runs.sensitivity import analyse, make_design, parse_over
    from campaign.runs.until import CONTROLS, STATISTICS
    from reports.compare.global_sensitivity import sensitivity_grid, write_sensitivity
    from reports.compare.metrics import choose_metric
    from reports.pages.console import rich_parts
    from reports.run.data import read_run
    from reports.run.known import short_line
    from reports.schema.tables import kind_schema

    varied = [parse_over(text) for text in arguments.over]
    if arguments.statistic not in STATISTICS:
        raise BoresightError(f"--statistic {arguments.statistic}: choose one of {', '.join(STATISTICS)}")
    variant = choose_variant().name
    campaign = resolve(arguments.name, arguments.overrides, arguments.seed, variant)
    known = kind_schema(campaign.spec.experiment).metrics
    if arguments.metric is not None and arguments.metric not in known:
        raise BoresightError(f"--metric {arguments.metric}: choose one of {', '.join(known)}")
    design = make_design(arguments.name, campaign, arguments.scenario, varied, arguments.samples, arguments.method)
    name = f"{campaign.spec.name}-sensitivity-{design.campaign.digest[:8]}"
    jobs = workers(arguments.jobs, variant)
    request = RunRequest(arguments.out or RUNS / name, arguments.trials, jobs, command=arguments.command)
    out = console()
    cells = len(design.campaign.scenarios)
    out.print(f"{campaign.spec.name}: {cells} scenarios of {request.trials} trials into {request.out}")
    with ProgressListener(out) as listener:
        folder = run_campaign(design.campaign, request, listener)
    run = read_run(folder.path)
    metric, statistic = choose_metric(arguments.metric, [run]), STATISTICS[arguments.statistic]
    labels = [entry.label for entry in campaign.spec.estimators if entry.name not in CONTROLS]
    found = analyse(run, design, metric, statistic, labels)
    grid = replace(sensitivity_grid(found, varied, metric, statistic.name), known=short_line(run))
    try:
        page = write_sensitivity(run, found, grid, design.varied, design.samples, metric)
    except OSError as error:
        raise BoresightError(explain_write_error(error.filename or folder.path, error)) from error
    out.print(*rich_parts(grid))
    for one in found:
        for key in one.unmoved:
            out.print(f"{key} changes no result of {one.estimator}: is it applied at all?")
    out.print(f"sensitivity: {page}")
    return 0
