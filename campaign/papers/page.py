"""Definition of a paper (campaigns, figures, methods), the search for its finished runs, and the page of these."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any, cast

from boresight.campaign import RUNS
from boresight.campaign.catalog import PAGES
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.runs.read import CATALOG, campaign_names, needs
from boresight.campaign.runs.resolve import reload
from boresight.campaign.store import RunFolder, run_folders, start_of
from boresight.reports.figures.named import NamedFigure, add_provenance, with_trial_counts
from boresight.reports.kinds import Content
from boresight.reports.pages.content import content_of
from boresight.reports.pages.document import Document
from boresight.reports.pages.paper import (
    PaperLine,
    PaperPage,
    lines_by_table,
    paper_grid,
    paper_lines,
    table_figure,
    value_tally,
)
from boresight.reports.published import load_published
from boresight.reports.run.data import RunData, read_run
from boresight.reports.run.limits import short_line
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import count_of
from boresight.reports.verdicts import Verdict, verdict_tally
from boresight.scenarios.errors import BoresightError, one_line
from boresight.scenarios.load import load_campaign
from boresight.scenarios.reading import plain_json
from boresight.scenarios.spec.body import STAND_INS


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A stored run that contains all requested trials."""

    folder: RunFolder
    manifest: dict[str, Any]

    @cached_property
    def data(self) -> RunData:
        """Tables of the run; raises BoresightError if they are damaged or of another version."""
        return read_run(self.folder.path)

    @cached_property
    def content(self) -> Content:
        """Content of its report."""
        return content_of(self.data)

    def labels(self, method: str) -> list[str]:
        """Return the labels of an estimator in the run, by its name."""
        entries = [entry for each in self.manifest["campaign"]["estimators"] for entry in each.items()]
        return [str(options.get("label", name)) for name, options in entries if name == method]

    def campaign(self) -> ResolvedCampaign:
        """Resolve its campaign, to draw what is not stored.

        Raise BoresightError if code or data have changed since, or the data are gone.
        """
        campaign = reload(self.manifest)
        if campaign is None:
            option = " --embedded" if self.manifest.get("embedded") else ""
            again = f"run `boresight run {self.manifest['name']}{option}` again"
            if float(self.manifest.get("draft", 1.0)) < 1.0:
                again = "remove this draft and give the same command again"
            raise BoresightError(
                f"{self.folder.path}: was made by another version of boresight or of its data: to draw this, {again}"
            )
        return campaign


@dataclass(frozen=True, slots=True)
class GatheredRuns:
    """The newest readable finished run of each campaign that has one, and a line for each run that cannot be read."""

    found: dict[str, FinishedRun]
    refused: tuple[str, ...]


def gather_runs(
    runs: Sequence[Path], names: Sequence[str], draft: float = 1.0, *, embedded: bool = False
) -> GatheredRuns:
    """Find the newest readable finished run of each campaign among some folders.

    With ``draft`` below 1, a draft of that scale is used where there is no full run; with ``embedded``, a run on
    embedded bodies where there is none on the real ones.
    """
    found: dict[str, FinishedRun] = {}
    refused: list[str] = []
    for name in names:
        for built_in, scale in product((False, True) if embedded else (False,), dict.fromkeys((1.0, draft))):
            finished, unread = finished_runs(runs, name, scale, embedded=built_in)
            refused += unread
            for run in finished:
                try:
                    if run.data.manifest.report:
                        load_published(run.data.manifest.report)
                except BoresightError as error:
                    refused.append(_left_out(run.folder.path, error))
                else:
                    found[name] = run
                    break
            if name in found:
                break
    return GatheredRuns(found, tuple(dict.fromkeys(refused)))


def finished_runs(
    runs: Sequence[Path], name: str, draft: float = 1.0, *, embedded: bool = False
) -> tuple[list[FinishedRun], list[str]]:
    """Return the finished runs of a campaign among some folders, the most recently started first.

    Also return a line for each run that may be of the campaign but cannot be read. ``draft`` selects drafts of that
    scale (fewer trials and smaller data bases). Runs with ``--set`` are ignored, as they differ from the paper's, and
    runs on embedded bodies unless ``embedded`` selects them alone.
    """
    finished, refused = [], []
    for path in runs:
        folder = RunFolder(path)
        try:
            manifest = folder.read_manifest()
            if manifest is None or manifest.get("name") != name or manifest.get("overrides"):
                continue
            if bool(manifest.get("embedded")) != embedded:
                continue
            if float(manifest.get("draft", 1.0)) == draft and _is_whole(folder, manifest):
                finished.append(FinishedRun(folder, manifest))
        except BoresightError as error:
            if _may_be_of(path, name):
                refused.append(_left_out(path, error))
    newest = sorted(finished, key=lambda run: (start_of(run.folder.path), str(run.manifest["finished"])), reverse=True)
    return newest, refused


def _left_out(path: Path, error: BoresightError) -> str:
    said = one_line(error)
    return f"left out: {said}" if str(path) in said else f"left out: {path}: {said}"


def _may_be_of(path: Path, name: str) -> bool:
    """Return whether an unreadable run may be of a campaign, by its manifest or the name of its folder."""
    try:
        content = plain_json(path / "manifest.json")
    except (OSError, ValueError):
        content = None
    own = content.get("name") if isinstance(content, dict) else None
    if isinstance(own, str):
        return own == name
    known = [one for one in campaign_names() if path.name.startswith(f"{one}-")]
    return name in known or not known


def _is_whole(folder: RunFolder, manifest: dict[str, Any]) -> bool:
    """Return whether all trials are stored: more may have been requested after the run finished."""
    if not manifest.get("finished"):
        return False
    rows = folder.table("rows")
    wanted = int(manifest["trials"]) * len(manifest["scenarios"])
    return len(rows[["scenario", "trial"]].drop_duplicates()) >= wanted


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """A figure of a paper, with the names of the campaigns that it can be drawn from: none if it needs no run.

    ``draw`` draws a finished run or, ``together``, those of all campaigns by their names. If it ``rebuilds`` something,
    it is also given the number of workers, None for one for each core or GPU.
    """

    number: str
    campaigns: tuple[str, ...]
    draw: Callable[..., Iterable[NamedFigure]]
    together: bool = False
    rebuilds: bool = False


@dataclass(frozen=True, slots=True)
class Paper:
    """Definition of a paper's page.

    ``campaigns`` are in the order of its sections; those missing from the catalogue are ignored. ``methods`` are the
    names of the paper's; other estimators of a run are not compared with it. ``grids`` returns further tables of a run,
    ``tables`` each those of several runs together.
    """

    title: str
    campaigns: tuple[str, ...]
    methods: tuple[str, ...]
    figures: tuple[PaperFigure, ...]
    grids: Callable[[FinishedRun], list[Grid]]
    tables: tuple[Callable[[Mapping[str, FinishedRun]], list[Grid]], ...] = ()


def paper_called(name: str) -> Paper:
    """Return the paper of that name, one of `campaign.catalog.PAGES`.

    Raise BoresightError if there is none of that name.
    """
    if name not in PAGES:
        raise BoresightError(f"{name!r} is no paper: choose one of {', '.join(PAGES)}")
    return cast("Paper", import_module(f"boresight.campaign.papers.{name}").PAPER)


def paper_campaigns(paper: Paper) -> list[str]:
    """List the campaigns of a paper in the catalogue, in the order of its sections."""
    known = campaign_names()
    return [name for name in paper.campaigns if name in known]


def gather(paper: Paper, runs: Path, draft: float = 1.0, *, embedded: bool = False) -> GatheredRuns:
    """Find the newest finished run of each campaign of the paper; see `gather_runs`."""
    return gather_runs(run_folders(runs), paper_campaigns(paper), draft, embedded=embedded)


def paper_page(
    paper: Paper, runs: Path, jobs: int | None = None, draft: float = 1.0, *, embedded: bool = False
) -> PaperPage:
    """Draw all figures and compare all numbers of the paper, as far as its campaigns have been run.

    Rebuilds for figures use ``jobs`` workers; None for one for each core or GPU.
    """
    gathered = gather(paper, runs, draft, embedded=embedded)
    found = gathered.found
    missing = [
        f"{name}: no finished run without --set under {runs}/; to run it: {_command(name, runs, embedded=embedded)}"
        for name in paper_campaigns(paper)
        if name not in found
    ]
    figures: list[NamedFigure] = []
    for figure in paper.figures:
        try:
            figures += drawn(figure, found, jobs)
        except BoresightError as error:
            missing.append(f"figure {figure.number}: {error}")
    together: list[Grid] = []
    for table in paper.tables:
        try:
            together += table(found)
        except BoresightError as error:
            missing.append(str(error))
    specs = {name: load_campaign(name, CATALOG).spec for name in paper_campaigns(paper)}
    reports = {name: spec.report for name, spec in specs.items() if spec.report}
    lines = [line for name, report in reports.items() for line in _lines(paper, name, report, found.get(name))]
    tables: list[NamedFigure] = []
    for number, own in lines_by_table(lines).items():
        campaigns = dict.fromkeys(line.campaign for line in own)
        if shown := [found[name].content.run for name in campaigns if name in found]:
            tables.append(table_figure(number, own))
            add_provenance(tables[-1].figure, shown)
        else:
            missing.append(f"table {number}: not drawn without a finished run of {' or '.join(campaigns)}")
    comparisons = {name: load_published(report) for name, report in reports.items()}
    built_in = [name for name, run in found.items() if run.manifest.get("embedded")]
    conditions = [
        *dict.fromkeys(f"bounds of the verdicts: {one.bounds}" for one in comparisons.values()),
        *(f"{name}: {one.conditions}" for name, one in comparisons.items()),
    ]
    if built_in:
        replaced = f"on embedded bodies in place of shape files, so without verdicts: {', '.join(built_in)}"
        conditions.insert(0, replaced)
    document = Document(
        product="boresight figures",
        title=f"{paper.title}{' (embedded bodies)' if built_in else ''}",
        facts=[
            *([("Paper", "; ".join(sorted({one.source for one in comparisons.values()})))] if comparisons else []),
            *([("Values", value_tally(lines))] if lines else []),
            *([("Verdicts", verdict_tally(line.verdict for line in lines))] if lines else []),
            *((name, f"{_how(run)}. {short_line(run.data)}") for name, run in found.items()),
        ],
        lists=[
            ("Not read", gathered.refused),
            ("Not there", missing),
            ("What is compared, and by which bounds", conditions),
        ],
        grids=(
            *([paper_grid(lines)] if lines else []),
            *together,
            *(grid for run in found.values() for grid in paper.grids(run)),
        ),
        figures=(*figures, *tables),
        credits=sorted({line for run in found.values() for line in run.manifest["credits"]}),
    )
    return PaperPage(document, tuple(lines), len(found), tuple(missing), gathered.refused)


def drawn(figure: PaperFigure, found: Mapping[str, FinishedRun], jobs: int | None) -> list[NamedFigure]:
    """Draw one figure of the paper for each of its campaigns that has been run, or once if it has none.

    The first drawing is named by the number, further ones also by campaign, or by their stem if it begins with an
    underscore. Raise BoresightError if none of its campaigns has been run, or a run can no longer be drawn.
    """
    runs = {name: found[name] for name in figure.campaigns if name in found}
    if figure.campaigns and not runs:
        raise BoresightError(f"not drawn without a finished run of {' or '.join(figure.campaigns)}")
    groups = [{name: run} for name, run in runs.items()] if figure.campaigns and not figure.together else [runs]
    named: list[NamedFigure] = []
    for group in groups:
        first, shown = next(iter(group), ""), [run.content.run for run in group.values()]
        given = [] if not figure.campaigns else [group if figure.together else group[first]]
        for drawing in figure.draw(*given, *([jobs] if figure.rebuilds else [])):
            suffix = drawing.stem if drawing.stem.startswith("_") else f"_{first}" if named else ""
            counted = drawing
            if shown:
                add_provenance(drawing.figure, shown)
                counted = with_trial_counts(drawing, shown)
            stem, caption = f"figure_{figure.number:0>2}{suffix}", f"Figure {figure.number}. {counted.caption}"
            named.append(replace(counted, stem=stem, caption=caption))
    if not named:
        raise BoresightError(f"there is nothing to draw in the runs of {', '.join(runs)}")
    return named


def _command(name: str, runs: Path, *, embedded: bool) -> str:
    """Return the command that runs a campaign into the searched folder, and before it the one that fetches its data.

    With ``embedded``, built-in bodies replace the shape files that they stand for, which need not be fetched then.
    """
    files = [need for need in needs(load_campaign(name, CATALOG)) if need.kind]
    replaced = embedded and bool(files) and all(need.name in STAND_INS for need in files)
    absent = not replaced and not all(need.found for need in files)
    out = [] if runs == RUNS else ["--out", str(runs / name)]
    run = shlex.join(["boresight", "run", name, *(["--embedded"] if replaced else []), *out])
    return f"boresight fetch {name} && {run}" if absent else run


def _lines(paper: Paper, name: str, report: str, run: FinishedRun | None) -> list[PaperLine]:
    labels = [label for method in paper.methods for label in run.labels(method)] if run else []
    real = any(need.kind == "images" and not need.found for need in needs(load_campaign(name, CATALOG)))
    absent: Verdict = "needs real images" if real else "not measured"
    return list(paper_lines(name, load_published(report), run.content if run else None, labels, absent))


def _how(run: FinishedRun) -> str:
    manifest, draft = run.manifest, float(run.manifest.get("draft", 1.0))
    said = [*([f"a draft of scale {draft:g}"] if draft < 1.0 else []), *manifest.get("embedded", [])]
    size = count_of(manifest["trials"], "trial") + (f" ({', '.join(said)})" if said else "")
    return (
        f"{run.folder.path}, {size}, seed {manifest['seed']}, {manifest['finished']},"
        f" commit {manifest['commit'] or 'unknown'}"
    )
