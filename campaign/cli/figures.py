"""``figures``: every figure and every number of a paper, from what has been run."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.progress import ProgressListener
from campaign.cli.runs import positive
from campaign.cli.terminal import console
from campaign.machine import cores
from campaign.paper import PAPERS
from campaign.request import RunRequest
from campaign.resolve import resolve
from campaign.runner import run_campaign
from campaign.start import RUNS
from renderers.mitsuba3 import choose_variant
from scenarios.atomic import explain
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    figures = commands.add_parser("figures", help="draw every figure of a paper, and set every number beside ours")
    figures.add_argument("paper", choices=PAPERS, help="which paper")
    figures.add_argument("--runs", type=Path, default=RUNS, help="where the runs are (default: runs)")
    figures.add_argument("--out", type=Path, help="folder of the figures (default: figures/PAPER)")
    figures.add_argument("--run", action="store_true", help="first run, or finish, the campaigns that are missing")
    figures.add_argument("--trials", type=positive, help="with --run: trials of each scenario at most")
    figures.add_argument(
        "--jobs", type=positive, default=cores(),
        help="worker processes of what is run or built again for a figure (default: the cores)",
    )  # fmt: skip
    figures.set_defaults(handler=_figures)


def _figures(arguments: argparse.Namespace) -> int:
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.paper.page import gather, paper_called, paper_campaigns, paper_page
    from reports.console import rich_table
    from reports.paper import paper_grid, verdict_tally, write_paper

    out = console()
    if arguments.trials is not None and not arguments.run:
        raise BoresightError("--trials says how much is to be run: give --run too")
    paper = paper_called(arguments.paper)
    if arguments.run:
        found, _ = gather(paper, arguments.runs)
        for name in (name for name in paper_campaigns(paper) if name not in found):
            run_or_finish(name, arguments)
    page = paper_page(paper, arguments.runs, arguments.jobs)
    folder = arguments.out or Path("figures") / arguments.paper
    try:
        written = write_paper(page, folder)
    except OSError as error:
        raise BoresightError(explain(error.filename or folder, error)) from error
    shown = ("campaign", "scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "verdict")
    out.print(rich_table(paper_grid(page.lines).keep(*shown)))
    for line in page.missing:
        out.print(line)
    out.print(f"{len(page.figures)} figures; verdicts: {verdict_tally(page.lines)}")
    out.print(f"figures and table: {written}")
    return 0


def run_or_finish(name: str, arguments: argparse.Namespace) -> None:
    """Run a campaign, or go on with it; one that cannot be run, for want of its data, is told and left out."""
    out = console()
    try:
        campaign = resolve(name, variant=choose_variant().name)
        trials = min(arguments.trials or campaign.spec.trials, campaign.spec.trials)
        folder = arguments.runs / f"{campaign.spec.name}-{campaign.digest[:8]}"
        command = shlex.join(["boresight", "run", name, "--trials", str(trials), "--out", str(folder)])
        out.print(f"{name}: {trials} trials into {folder}")
        with ProgressListener(out) as listener:
            run_campaign(campaign, RunRequest(folder, trials, arguments.jobs, command=command), listener)
    except BoresightError as error:
        out.print(f"{name}: {error}")
