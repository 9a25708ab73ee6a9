"""``compare`` and ``board``: compare estimators, scenarios or runs after they have been run, and list runs."""

from __future__ import annotations

import argparse

from boresight.campaign.cli.arguments import COMPARISONS
from boresight.campaign.cli.terminal import console, writing
from boresight.campaign.papers.gather import run_folders
from boresight.campaign.runs.newest import find_run, newest_first
from boresight.reports.compare import compare_runs
from boresight.reports.compare.tables import counted_tests, equal_pairs, limits, pooled_lines
from boresight.reports.pages.board import write_board
from boresight.reports.pages.comparison import write_comparison
from boresight.reports.pages.rich_tables import rich_parts
from boresight.scenarios.errors import BoresightError, display

_IN_PART = 3
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
    files = write_comparison(found, out, arguments.command)
    printer = console()
    for grid in files.grids:
        printer.print(*rich_parts(grid.keep(*(head for head in grid.columns if not head.startswith(_LEFT_OUT)))))
    for name, text in limits(found):
        printer.print(f"{name}: {text}")
    for line in filter(None, (pooled_lines(found), equal_pairs(found), counted_tests(found))):
        printer.print(line)
    printer.print(f"comparison: {files.html}")
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
    return _IN_PART if refused else 0
