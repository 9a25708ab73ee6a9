"""``figures``: every figure and every number of a paper, from what has been run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.runs import RUNS
from campaign.cli.terminal import console
from campaign.machine import cores
from campaign.paper import PAPERS
from campaign.store.atomic import explain
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_commands(commands: _SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to the parser."""
    figures = commands.add_parser("figures", help="draw every figure of a paper, and set every number beside ours")
    figures.add_argument("paper", choices=PAPERS, help="which paper")
    figures.add_argument("--runs", type=Path, default=RUNS, help="where the runs are (default: runs)")
    figures.add_argument("--out", type=Path, help="folder of the figures (default: figures/PAPER)")
    figures.set_defaults(handler=_figures)


def _figures(arguments: argparse.Namespace) -> int:
    # Imported here: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.paper.page import paper_page
    from reports.console import rich_table
    from reports.paper import paper_grid, verdict_tally, write_paper

    out = console()
    page = paper_page(arguments.runs, cores())
    folder = arguments.out or Path("figures") / arguments.paper
    try:
        written = write_paper(page, folder)
    except OSError as error:
        raise BoresightError(explain(error.filename or folder, error)) from error
    out.print(
        rich_table(paper_grid(page.lines).keep("campaign", "quantity", "statistic", "paper", "ours [95 %]", "verdict"))
    )
    for line in page.missing:
        out.print(line)
    out.print(f"{len(page.figures)} figures; verdicts: {verdict_tally(page.lines)}")
    out.print(f"figures and table: {written}")
    return 0
