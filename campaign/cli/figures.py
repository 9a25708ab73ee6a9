"""``figures``: every figure and every number of a paper, from what has been run."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.cli.missing import Wanted, run_missing
from campaign.cli.runs import positive
from campaign.cli.terminal import console
from campaign.machine import sharing_cores, workers
from campaign.papers import PAPERS
from campaign.pool.workers import in_order
from campaign.runs.start import RUNS
from renderers.mitsuba3 import choose_variant
from scenarios.atomic import explain_write_error
from scenarios.errors import BoresightError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

    from reports.papers.page import PaperLine


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
    scale = arguments.trials_scale
    if arguments.trials is not None and not arguments.run:
        raise BoresightError("--trials says how much is to be run: give --run too")
    if arguments.runs != RUNS and not arguments.runs.is_dir() and not arguments.run and scale == 1.0:
        raise BoresightError(
            f"--runs {arguments.runs}: no such folder: give one that holds runs, or --run to make them"
        )
    parent = Path("figures") if scale == 1.0 else Path("figures") / f"draft-{scale:g}"
    if arguments.paper != ALL:
        return _of_papers({arguments.paper: arguments.out or parent / arguments.paper}, arguments)
    folders = {name: (arguments.out or parent) / name for name in PAPERS}
    if scale < 1.0:
        return _of_papers(folders, arguments)
    return max(_of_papers({name: folder}, arguments) for name, folder in folders.items())


def _of_papers(folders: Mapping[str, Path], arguments: argparse.Namespace) -> int:
    """Run what papers are missing, where that is asked for, and write their pages; return the exit code."""
    if arguments.run or arguments.trials_scale < 1.0:
        wanted = Wanted(arguments.runs, arguments.trials_scale, arguments.trials, arguments.command)
        run_missing(_missing(folders, arguments), wanted, arguments.jobs)
    among = 1 if len(folders) == 1 else min(workers(arguments.jobs, choose_variant().name), len(folders))
    jobs = arguments.jobs if among == 1 else 1
    calls = ((name, folder, arguments.runs, jobs, arguments.trials_scale, among) for name, folder in folders.items())
    return max(_told(written) for written in in_order(among, _written, calls))


def _missing(papers: Iterable[str], arguments: argparse.Namespace) -> list[str]:
    """List the campaigns of papers without a finished run, the papers by turns: those of one share what they build."""
    # Imported here, as below: Matplotlib and scipy.stats take a third of the start-up, and most commands draw nothing.
    from campaign.papers.page import gather, paper_called, paper_campaigns

    missing = []
    for paper in map(paper_called, papers):
        found = gather(paper, arguments.runs, arguments.trials_scale).found
        missing.append([name for name in paper_campaigns(paper) if name not in found])
    return list(dict.fromkeys(name for turn in zip_longest(*missing) for name in turn if name is not None))


@dataclass(frozen=True, slots=True)
class _Written:
    """What is told of the page of a paper that has been written."""

    page: Path
    lines: Sequence[PaperLine]
    figures: int
    refused: Sequence[str]
    missing: Sequence[str]


def _written(name: str, folder: Path, runs: Path, jobs: int | None, scale: float, among: int) -> _Written:
    """Write the page of a paper, beside the pages of others."""
    from campaign.papers.page import paper_called, paper_page
    from reports.papers.page import write_paper

    with sharing_cores(among):
        page = paper_page(paper_called(name), runs, jobs, scale)
    try:
        place = write_paper(page, folder)
    except OSError as error:
        raise BoresightError(explain_write_error(error.filename or folder, error)) from error
    return _Written(place, page.lines, len(page.figures), page.refused, page.missing)


def _told(written: _Written) -> int:
    """Print what a page came to; return the exit code."""
    from reports.pages.console import rich_table
    from reports.papers.page import paper_grid, verdict_tally

    out = console()
    shown = ("campaign", "scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "verdict")
    out.print(rich_table(paper_grid(written.lines).keep(*shown)))
    for line in (*written.refused, *written.missing):
        out.print(line)
    out.print(f"figures and tables drawn: {written.figures}; verdicts: {verdict_tally(written.lines)}")
    out.print(f"page: {written.page}")
    return _IN_PART if written.refused else 0
