"""The page of a paper, put together from what has been run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from campaign.paper.gather import FinishedRun, newest_finished, run_folders
from campaign.paper.rowell2015 import FIGURES, METHODS, PaperFigure
from campaign.resolve import CATALOG, campaign_names
from reports.content import NamedFigure
from reports.designs import design_grids
from reports.paper import PaperLine, PaperPage, paper_lines
from reports.published import load_published
from reports.sensitivity import mesh_variants, sensitivity_grid
from reports.tables import Grid
from scenarios.errors import BoresightError
from scenarios.load import load_campaign

_ALSO = ("navcam67p-real",)
_SENSITIVITY = "rowell2015-sensitivity"
_TITLE = "Rowell et al. (2015): every figure and every number"


def paper_campaigns() -> list[str]:
    """List the campaigns of the paper in the catalogue, in the order of its sections."""
    order = ("database", "centroid", "convergence", "simulated", "real", "real-like")
    known = [f"rowell2015-{name}" for name in order]
    others = [name for name in campaign_names() if name.startswith(_SENSITIVITY)]
    return [name for name in (*known, *_ALSO, *others) if name in campaign_names()]


def gather(runs: Path) -> tuple[dict[str, FinishedRun], list[str]]:
    """Find the newest finished run of each campaign of the paper; say of each that is missing how to run it."""
    folders = run_folders(runs)
    found, missing = {}, []
    for name in paper_campaigns():
        run = newest_finished(folders, name)
        if run is None:
            missing.append(f"{name}: no finished run under {runs}/; to run it: boresight run {name}")
        else:
            found[name] = run
    return found, missing


def paper_page(runs: Path, jobs: int) -> PaperPage:
    """Draw all figures and set all numbers of the paper beside ours, as far as they have been run."""
    found, missing = gather(runs)
    figures: list[NamedFigure] = []
    for figure in FIGURES:
        try:
            figures += drawn(figure, found, jobs)
        except BoresightError as error:
            missing.append(f"figure {figure.number}: {error}")
    lines = [line for name in paper_campaigns() for line in _lines(name, found.get(name))]
    sources = {load_published(name).source for name in _reports().values()}
    return PaperPage(
        title=_TITLE,
        source="; ".join(sorted(sources)),
        lines=tuple(lines),
        grids=tuple(grid for run in found.values() for grid in _sensitivity(run)),
        figures=tuple(figures),
        runs=tuple((name, _how(run)) for name, run in found.items()),
        missing=tuple(missing),
        credits=tuple(sorted({line for run in found.values() for line in run.manifest["credits"]})),
    )


def drawn(figure: PaperFigure, found: Mapping[str, FinishedRun], jobs: int) -> list[NamedFigure]:
    """Draw one figure of the paper; the first of its campaigns gives it its number, further ones stand beside it.

    Raises
    ------
    BoresightError
        If none of its campaigns has been run, or a run can no longer be drawn.
    """
    runs = {name: found[name] for name in figure.campaigns if name in found}
    if not runs:
        raise BoresightError(f"not drawn without a finished run of {' or '.join(figure.campaigns)}")
    names = list(runs)
    return [figure.named(drawing, f"_{names[i]}" if i else "") for i, drawing in enumerate(figure.draw(runs, jobs))]


def _reports() -> dict[str, str]:
    """Return the key of the published values of each campaign that has one."""
    specs = {name: load_campaign(name, CATALOG).spec for name in paper_campaigns()}
    return {name: spec.report for name, spec in specs.items() if spec.report}


def _lines(name: str, run: FinishedRun | None) -> list[PaperLine]:
    report = _reports().get(name)
    if report is None:
        return []
    labels = [label for method in METHODS for label in run.labels(method)] if run else []
    return list(paper_lines(name, load_published(report), run.content if run else None, labels))


def _sensitivity(run: FinishedRun) -> list[Grid]:
    """Return the tables of a run that varies what the paper leaves open."""
    if not run.manifest["name"].startswith(_SENSITIVITY):
        return []
    content, paper = run.content, load_published("rowell2015-simulated")
    grids = [*design_grids(content.run), sensitivity_grid(content.records, mesh_variants(content.run), paper)]
    return [replace(grid, title=f"{run.manifest['name']}: {grid.title}") for grid in grids if grid]


def _how(run: FinishedRun) -> str:
    manifest = run.manifest
    return (
        f"{run.folder.path}, {manifest['trials']} trials, seed {manifest['seed']}, {manifest['finished']},"
        f" commit {manifest['commit'] or 'unknown'}"
    )
