"""``figures``: every figure and every number of a paper, from what has been run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.progress import ProgressListener
from campaign.cli.runs import positive
from campaign.cli.terminal import console
from campaign.draft import LEAST_TRIALS, as_draft, kept
from campaign.machine import workers
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


ALL = "all"
_IN_PART = 3
"""Exit code: done, without the runs that could not be read."""


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    figures = commands.add_parser("figures", help="draw every figure of a paper, and set every number beside ours")
    figures.add_argument("paper", choices=(*PAPERS, ALL), help="which paper, or all of them")
    figures.add_argument("--runs", type=Path, default=RUNS, help="where the runs are (default: runs)")
    figures.add_argument(
        "--out", type=Path, help="folder of the figures, of all papers that of their folders (default: figures/PAPER)"
    )
    figures.add_argument("--run", action="store_true", help="first run, or finish, the campaigns that are missing")
    figures.add_argument("--trials", type=positive, help="with --run: trials of each scenario at most")
    figures.add_argument(
        "--trials-scale", type=_share, default=1.0, metavar="SHARE",
        help="make a draft: run what is missing with this share of its trials, data bases of this share of their"
        " images, 120 at least, and arcs of this share of theirs, 24 at least",
    )  # fmt: skip
    figures.add_argument(
        "--jobs", type=positive,
        help="worker processes of what is run or built again for a figure (default: one for each core, or GPU)",
    )  # fmt: skip
    figures.set_defaults(handler=_figures)


def _share(text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.0 < share <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and 1 at most")
    return share


def _figures(arguments: argparse.Namespace) -> int:
    if arguments.trials is not None and not arguments.run:
        raise BoresightError("--trials says how much is to be run: give --run too")
    if arguments.runs != RUNS and not arguments.runs.is_dir() and not arguments.run and arguments.trials_scale == 1.0:
        raise BoresightError(
            f"--runs {arguments.runs}: no such folder: give one that holds runs, or --run to make them"
        )
    parent = Path("figures") if arguments.trials_scale == 1.0 else Path("figures") / f"draft-{arguments.trials_scale:g}"
    if arguments.paper != ALL:
        return _of_paper(arguments.paper, arguments.out or parent / arguments.paper, arguments)
    return max(_of_paper(name, (arguments.out or parent) / name, arguments) for name in PAPERS)


def _of_paper(name: str, folder: Path, arguments: argparse.Namespace) -> int:
    """Write the page of a paper; return the exit code."""
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.paper.page import gather, paper_called, paper_campaigns, paper_page
    from reports.console import rich_table
    from reports.paper import paper_grid, verdict_tally, write_paper

    out, scale = console(), arguments.trials_scale
    paper = paper_called(name)
    if arguments.run or scale < 1.0:
        found = gather(paper, arguments.runs, scale).found
        for missing in (campaign for campaign in paper_campaigns(paper) if campaign not in found):
            run_or_finish(missing, arguments)
    page = paper_page(paper, arguments.runs, arguments.jobs, scale)
    try:
        written = write_paper(page, folder)
    except OSError as error:
        raise BoresightError(explain(error.filename or folder, error)) from error
    shown = ("campaign", "scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "verdict")
    out.print(rich_table(paper_grid(page.lines).keep(*shown)))
    for line in (*page.refused, *page.missing):
        out.print(line)
    out.print(f"figures and tables drawn: {len(page.figures)}; verdicts: {verdict_tally(page.lines)}")
    out.print(f"page: {written}")
    return _IN_PART if page.refused else 0


def run_or_finish(name: str, arguments: argparse.Namespace) -> None:
    """Run a campaign, or go on with it; one that cannot be run, for want of its data, is told and left out."""
    out = console()
    try:
        variant = choose_variant().name
        campaign = as_draft(resolve(name, variant=variant), arguments.trials_scale)
        trials = _trials(campaign.spec.trials, arguments)
        folder = arguments.runs / f"{campaign.spec.name}-{campaign.digest[:8]}"
        out.print(f"{name}: {trials} trials into {folder}")
        request = RunRequest(folder, trials, workers(arguments.jobs, variant), command=arguments.command)
        with ProgressListener(out) as listener:
            run_campaign(campaign, request, listener)
    except BoresightError as error:
        out.print(f"{name}: {error}")


def _trials(whole: int, arguments: argparse.Namespace) -> int:
    scaled = kept(whole, float(arguments.trials_scale), LEAST_TRIALS)
    return scaled if arguments.trials is None else min(int(arguments.trials), scaled)
