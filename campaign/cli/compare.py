"""``compare``: estimators, scenarios or whole runs beside each other, after they have run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.runs import find_run
from campaign.cli.terminal import console
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

COMPARISONS = Path("comparisons")
_LEFT_OUT = ("75th", "99th", "mean difference", "p of all", "better % of all")
"""Columns that the files have and the terminal has no room for."""


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    compare = commands.add_parser("compare", help="compare estimators and scenarios of runs, trial by trial")
    compare.add_argument("runs", nargs="+", metavar="RUN", help="run folders, or campaigns' names")
    compare.add_argument(
        "--by", default="estimator,scenario", metavar="FACTOR,...",
        help="what tells the lines apart: estimator, scenario, run, or a key of the scenarios such as brdf or"
        " camera.fov_deg (default: estimator,scenario); the rest is pooled",
    )  # fmt: skip
    compare.add_argument(
        "--metric",
        help="what is compared (default: position_error_m, of sequences after the last whole revolution; of runs"
        " without poses their first number, as missed_share of crater detection; a wrong one lists all that a run has)",
    )  # fmt: skip
    compare.add_argument("--unpaired", action="store_true", help="compare runs of other seeds or views too")
    compare.add_argument("--out", type=Path, help=f"folder of the comparison (default: {COMPARISONS}/RUN-...)")
    compare.set_defaults(handler=_compare)


def _compare(arguments: argparse.Namespace) -> int:
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from reports.compare import compare_runs, write_comparison
    from reports.pages.console import rich_parts

    factors = list(dict.fromkeys(filter(None, (part.strip() for part in arguments.by.split(",")))))
    if not factors:
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
    printer.print(f"comparison: {files.markdown}")
    return 0
