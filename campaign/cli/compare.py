"""``compare``, ``rare``, ``board`` and ``sensitivity``: comparisons of runs, rare misses, and keys that count."""

from __future__ import annotations

import argparse
from dataclasses import replace

from boresight.campaign import RUNS
from boresight.campaign.cli.main import COMPARISONS, EXIT_IN_PART
from boresight.campaign.cli.terminal import ProgressListener, console, writing
from boresight.campaign.runs.check import check_campaign
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.runs.sensitivity import analyse, make_design, parse_over
from boresight.campaign.runs.until import STATISTICS
from boresight.campaign.store import find_run, newest_first, run_folders
from boresight.campaign.threads import workers
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.compare import compare_runs
from boresight.reports.compare.global_sensitivity import sensitivity_grid
from boresight.reports.compare.tables import counted_tests, equal_pairs, limits, pooled_lines
from boresight.reports.compare.trials import choose_metric
from boresight.reports.kinds.rare import rare_grid
from boresight.reports.pages.build import write_board
from boresight.reports.pages.comparison import write_comparison, write_sensitivity
from boresight.reports.pages.rich_tables import rich_parts
from boresight.reports.run.data import StoredRequirement, read_run
from boresight.reports.run.limits import short_line
from boresight.reports.schema.records import CONTROLS
from boresight.reports.schema.tables import kind_schema
from boresight.reports.statistics.requirements import read_requirement
from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.load import load_scenario

_LEFT_OUT = ("75th", "99th", "mean difference", "p of all", "better % of all")
"""Columns that the files have and the terminal has no room for."""


def compare_command(arguments: argparse.Namespace) -> int:
    """Compare estimators, scenarios and runs, and write the comparison."""
    factors = None
    if arguments.by is not None:
        factors = list(dict.fromkeys(filter(None, (part.strip() for part in arguments.by.split(",")))))
    if factors == []:
        raise BoresightError("--by: empty: give estimator, scenario, run or a key of the scenarios")
    folders = [find_run(name) for name in arguments.runs]
    paths = list(dict.fromkeys(folder.path.resolve() for folder in folders))
    if len(paths) < len(folders):
        raise BoresightError(f"{', '.join(arguments.runs)}: a run is named twice")
    found = compare_runs([folder.path for folder in folders], arguments.metric, factors, arguments.unpaired)
    out = arguments.out or COMPARISONS / "-".join(folder.path.name for folder in folders)
    page, grids = write_comparison(found, out, arguments.command)
    printer = console()
    for grid in grids:
        printer.print(*rich_parts(grid.keep(*(head for head in grid.columns if not head.startswith(_LEFT_OUT)))))
    for name, text in limits(found):
        printer.print(f"{name}: {text}")
    for line in filter(None, (pooled_lines(found), equal_pairs(found), counted_tests(found))):
        printer.print(line)
    printer.print(f"comparison: {page}")
    return 0


def rare_command(arguments: argparse.Namespace) -> int:
    """Print how often requirements are missed by a narrower law of the pose errors than that of the run."""
    run = read_run(find_run(arguments.run).path)
    if arguments.that is not None:
        asked = StoredRequirement(that=read_requirement(arguments.that, run.manifest.experiment).written)
        run = replace(run, manifest=run.manifest.model_copy(update={"requirements": (asked,)}))
    elif not run.manifest.requirements:
        raise BoresightError(f"{arguments.run}: has no requirement: give one, as 'success in 99.99 % at 90 %'")
    law = None if arguments.law is None else load_scenario(arguments.law).spec.pose_error
    wanted = {name: law or spec.onboard.pose_error for name, spec in (run.specs or {}).items()}
    if told := [name for name, one in wanted.items() if one is None]:
        raise BoresightError(f"{told[0]}: no onboard.pose_error: name with --law a scenario that has the wanted errors")
    grid = rare_grid(run, {name: one for name, one in wanted.items() if one is not None})
    console().print(*rich_parts(grid), grid.note)
    return 0


def board_command(arguments: argparse.Namespace) -> int:
    """Write the index page of the runs in a folder."""
    folders = newest_first(run_folders(arguments.folder))
    if not folders:
        raise BoresightError(f"{arguments.folder}: no run in that folder: give one that holds run folders")
    with writing(arguments.folder):
        page, refused = write_board(folders, arguments.folder, arguments.command)
    out = console()
    for line in refused:
        out.print(f"not read: {line}")
    out.print(f"board of {len(folders) - len(refused)} of {len(folders)} runs: {display(page)}")
    return EXIT_IN_PART if refused else 0


def sensitivity_command(arguments: argparse.Namespace) -> int:
    """Run a design of scenarios, and write the sensitivity indices."""
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
    check_campaign(design.campaign, arguments.trials)
    request = RunRequest(arguments.out or RUNS / name, arguments.trials, jobs, command=arguments.command)
    out = console()
    cells = len(design.campaign.scenarios)
    out.print(f"{campaign.spec.name}: {cells} scenarios of {request.trials} trials into {display(request.out)}")
    with ProgressListener(out) as listener:
        folder = run_campaign(design.campaign, request, listener)
    run = read_run(folder.path)
    metric, statistic = choose_metric(arguments.metric, [run]), STATISTICS[arguments.statistic]
    labels = [entry.label for entry in campaign.spec.estimators if entry.name not in CONTROLS]
    found = analyse(run, design, metric, statistic, labels)
    grid = replace(sensitivity_grid(found, varied, metric, statistic.name), known=short_line(run))
    with writing(folder.path):
        page = write_sensitivity(run, found, grid, design.varied, design.samples, metric)
    out.print(*rich_parts(grid))
    for one in found:
        for key in one.unmoved:
            out.print(f"{key} changes no result of {one.estimator}: is it applied at all?")
    out.print(f"sensitivity: {display(page)}")
    return 0
