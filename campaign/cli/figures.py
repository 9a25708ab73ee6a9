"""``figures``: pages of papers, with every figure and every number, after running the campaigns that are missing."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from boresight.campaign import RUNS
from boresight.campaign.catalog import PAPERS
from boresight.campaign.cli.fetch import bring_missing
from boresight.campaign.cli.main import ALL_PAPERS, EXIT_IN_PART
from boresight.campaign.cli.terminal import NamedLines, ProgressListener, console, writing
from boresight.campaign.machine import sharing_cores
from boresight.campaign.papers.page import gather, paper_called, paper_campaigns, paper_page
from boresight.campaign.pool.workers import in_order
from boresight.campaign.resolved import ResolvedCampaign, as_draft, kept
from boresight.campaign.runs.check import check_campaign, check_data
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.read import CATALOG, needs, sources
from boresight.campaign.runs.resolve import resolve
from boresight.campaign.threads import workers
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.pages.paper import PaperLine, paper_grid, value_tally, write_paper
from boresight.reports.pages.rich_tables import FittedTable
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import count_of
from boresight.reports.verdicts import verdict_tally
from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.load import load_campaign

_REAL = ("images", "tables")
"""Folders of real data, as `Need.kind` names them."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """How the campaigns of a paper are run: folder of the runs, share of a draft (1 for none), most trials or None."""

    runs: Path
    share: float
    trials: int | None
    command: str
    embedded: bool = False

    def of(self, name: str, variant: str, jobs: int) -> tuple[ResolvedCampaign, RunRequest]:
        """Resolve a campaign, and say how it is run."""
        campaign = as_draft(resolve(name, variant=variant, embedded=self.embedded), self.share)
        check_data(campaign)
        scaled = kept(campaign.spec.trials, self.share)
        trials = scaled if self.trials is None else min(self.trials, scaled)
        folder = self.runs / f"{campaign.spec.name}-{campaign.digest[:8]}"
        return campaign, RunRequest(folder, trials, jobs, command=self.command)


def run_missing(names: Sequence[str], wanted: Wanted, jobs: int | None) -> None:
    """Run or continue campaigns; report those that lack data, and leave them out.

    A draft has so few trials of each that most of its time is spent where one campaign alone keeps one core busy, with
    what is built before trials, and behind its last ones; so campaigns are drafted side by side.
    """
    variant = choose_variant().name
    among = workers(jobs, variant)
    lanes = 1 if wanted.share == 1.0 else max(1, min(among, len(names)))
    each = among if lanes == 1 else 1
    for _ in in_order(lanes, _run, ((name, wanted, variant, each, lanes) for name in names)):
        pass


def _run(name: str, wanted: Wanted, variant: str, jobs: int, lanes: int) -> None:
    """Run a campaign with its share of the cores; print steps in place of progress bars if others run beside it."""
    lines, began = NamedLines(console(), name), time.monotonic()
    try:
        campaign, request = wanted.of(name, variant, jobs)
        check_campaign(campaign, request.trials)
        lines.message(f"{count_of(request.trials, 'trial')} into {display(request.out)}")
        listening = ProgressListener(console()) if lanes == 1 else nullcontext(lines)
        with sharing_cores(lanes), listening as listener:
            run_campaign(campaign, request, listener)
    except BoresightError as error:
        lines.message(str(error).removeprefix(f"{name}: "))
        return
    if lanes > 1:
        lines.message(f"done in {time.monotonic() - began:.0f} s")


def figures_command(arguments: argparse.Namespace) -> int:
    """Write the page of a paper, or of all papers, after running what is missing if wanted."""
    scale = arguments.trials_scale
    if arguments.trials is not None and not arguments.run:
        raise BoresightError("--trials says how much is to be run: give --run too")
    if arguments.runs != RUNS and not arguments.runs.is_dir() and not arguments.run and scale == 1.0:
        raise BoresightError(
            f"--runs {arguments.runs}: no such folder: give one that holds runs, or --run to make them"
        )
    if arguments.paper not in PAPERS and arguments.paper != ALL_PAPERS and not arguments.fetch:
        _refuse_without_data(arguments)
    parent = Path("figures") if scale == 1.0 else Path("figures") / f"draft-{scale:g}"
    if arguments.paper != ALL_PAPERS:
        written = _of_papers({arguments.paper: arguments.out or parent / arguments.paper}, arguments)
    else:
        folders = {name: (arguments.out or parent) / name for name in PAPERS}
        among = [folders] if scale < 1.0 else [{name: folder} for name, folder in folders.items()]
        written = [one for papers in among for one in _of_papers(papers, arguments)]
        console().print(f"all papers: {value_tally([line for one in written for line in one.lines])}")
    return EXIT_IN_PART if any(one.refused for one in written) else 0


def _refuse_without_data(arguments: argparse.Namespace) -> None:
    """Refuse a page on real data where none of them are there, nor a run."""
    paper = paper_called(arguments.paper)
    wanted = {name: needs(load_campaign(name, CATALOG)) for name in paper_campaigns(paper)}
    real = {name: found for name, found in wanted.items() if any(one.kind in _REAL for one in found)}
    if any(all(one.found for one in found) for found in real.values()):
        return
    if not gather(paper, arguments.runs, arguments.trials_scale, embedded=arguments.embedded).found:
        raise BoresightError(
            f"{arguments.paper}: the data of {' and of '.join(real)} are missing: boresight fetch {arguments.paper}"
            " brings them, or says where they are"
        )


def _of_papers(folders: Mapping[str, Path], arguments: argparse.Namespace) -> list[_Written]:
    """Run what papers are missing, where that is asked for, and write and print their pages."""
    bring_missing([name for paper in folders for name in paper_campaigns(paper_called(paper))], arguments)
    if arguments.run or arguments.trials_scale < 1.0:
        wanted = Wanted(arguments.runs, arguments.trials_scale, arguments.trials, arguments.command, arguments.embedded)
        run_missing(_missing(folders, arguments), wanted, arguments.jobs)
    among = 1 if len(folders) == 1 else min(workers(arguments.jobs, choose_variant().name), len(folders))
    jobs = arguments.jobs if among == 1 else 1
    how = (arguments.runs, jobs, arguments.trials_scale, arguments.embedded, among)
    calls = ((name, folder, *how) for name, folder in folders.items())
    pages = []
    for written in in_order(among, _written, calls):
        _print(written, arguments)
        pages.append(written)
    return pages


def _missing(papers: Iterable[str], arguments: argparse.Namespace) -> list[str]:
    """List the campaigns of papers without a finished run, the papers by turns: those of one share what they build."""
    missing = []
    for paper in map(paper_called, papers):
        found = gather(paper, arguments.runs, arguments.trials_scale, embedded=arguments.embedded).found
        missing.append([name for name in paper_campaigns(paper) if name not in found])
    return list(dict.fromkeys(name for turn in zip_longest(*missing) for name in turn if name is not None))


@dataclass(frozen=True, slots=True)
class _Written:
    """Printed summary of a paper's page; ``runs`` is the number of runs that it uses."""

    paper: str
    page: Path
    runs: int
    lines: Sequence[PaperLine]
    tables: Sequence[Grid]
    figures: int
    refused: Sequence[str]
    missing: Sequence[str]


def _written(
    name: str, folder: Path, runs: Path, jobs: int | None, scale: float, embedded: bool, among: int
) -> _Written:
    """Write the page of a paper."""
    with sharing_cores(among):
        page = paper_page(paper_called(name), runs, jobs, scale, embedded=embedded)
    with writing(folder):
        place = write_paper(page, folder)
    return _Written(
        name, place, page.runs, page.lines, page.document.grids, len(page.document.figures), page.refused, page.missing
    )


def _print(written: _Written, arguments: argparse.Namespace) -> None:
    """Print the table of a page, and what is not on it."""
    out = console()
    if written.runs and not written.lines:
        for grid in written.tables:
            out.print(FittedTable(grid))
    elif written.runs:
        shown = ("campaign", "scenario", "quantity", "statistic", "paper", "ours [95 %]", "ok", "verdict")
        out.print(FittedTable(paper_grid(written.lines).keep(*shown)))
    for line in (*written.refused, *(written.missing if written.runs else _needed(written.paper, arguments))):
        out.print(line)
    if written.lines:
        verdicts = verdict_tally(line.verdict for line in written.lines)
        out.print(f"figures and tables drawn: {written.figures}; verdicts: {verdicts}")
        out.print(value_tally(written.lines))
    out.print(f"page: {written.page}")


def _needed(paper: str, arguments: argparse.Namespace) -> Iterator[str]:
    """Yield what would run for a paper without any finished run, and which data it lacks here."""
    campaigns = [load_campaign(name, CATALOG) for name in paper_campaigns(paper_called(paper))]
    share = arguments.trials_scale
    trials = sum(kept(one.spec.trials, share) * len(sources(one.spec)) for one in campaigns)
    yield f"{paper}: no finished run; to run: {count_of(len(campaigns), 'campaign')}, {trials:,} trials in all"
    lacking: dict[str, list[str]] = {}
    for one in campaigns:
        missing = {need.word for need in needs(one) if not need.found}
        # Built-in bodies replace the shapes, but not where images are real.
        for word in sorted(missing if not arguments.embedded or "images" in missing else missing - {"data"}):
            lacking.setdefault(word, []).append(one.spec.name)
    for word, names in lacking.items():
        yield f"{word} missing for {count_of(len(names), 'campaign')}: {', '.join(names)}"
    if lacking.keys() & {"data", "images"}:
        yield f"boresight fetch {paper} brings data, or says where they are; --embedded does without shapes"
    if not arguments.run and arguments.trials_scale == 1.0:
        yield f"to run them: {arguments.command} --run; for a draft: {arguments.command} --trials-scale 0.05"
