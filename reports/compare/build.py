"""Write a comparison: tables as CSV and Markdown, figures as PNG and PDF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from boresight.reports.compare.figures import comparison_figures
from boresight.reports.compare.subjects import RunComparison
from boresight.reports.compare.tables import (
    consistency_grid,
    consistency_table,
    contrast_grid,
    contrast_table,
    subject_grid,
    subject_table,
)
from boresight.reports.compare.trials import is_pooled_control
from boresight.reports.figures.provenance import add_provenance
from boresight.reports.figures.style import save_figure
from boresight.reports.run.limits import known_lines
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.labels import as_title
from boresight.reports.schema.named_figure import NamedFigure
from boresight.reports.schema.records import CONTROL
from boresight.scenarios.errors import BoresightError


@dataclass(frozen=True, slots=True, eq=False)
class ComparisonFiles:
    """Paths of a written comparison, and its tables for the terminal."""

    folder: Path
    markdown: Path
    tables: tuple[Path, ...]
    figures: tuple[Path, ...]
    grids: tuple[Grid, ...]


def write_comparison(found: RunComparison, folder: Path, command: str = "") -> ComparisonFiles:
    """Write ``compare.md``, ``subjects.csv``, ``differences.csv``, ``consistency.csv`` and the figures of a comparison.

    Raises
    ------
    BoresightError
        If the folder cannot be written.
    """
    grids = tuple(comparison_grids(found))
    tables = {"subjects.csv": subject_table(found), "differences.csv": contrast_table(found)}
    tables |= {"consistency.csv": consistency_table(found)}
    figures = list(comparison_figures(found))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, table in tables.items():
            table.to_csv(folder / name, index=False, lineterminator="\n")
        for one in figures:
            add_provenance(one.figure, found.runs)
        pictures = [path for one in figures for path in save_figure(one.figure, folder / one.stem)]
        markdown = folder / "compare.md"
        markdown.write_text(_markdown(found, grids, figures, command), encoding="utf-8")
    except OSError as error:
        raise BoresightError(
            f"{folder}: the comparison cannot be written: {error.strerror}; choose another --out"
        ) from error
    return ComparisonFiles(folder, markdown, tuple(folder / name for name in tables), tuple(pictures), grids)


def comparison_grids(found: RunComparison) -> Iterator[Grid]:
    """Yield the tables of a comparison, those without rows left out."""
    yield subject_grid(found)
    differences = contrast_grid(found)
    if differences is not None:
        yield differences
    consistency = consistency_grid(found)
    if consistency is not None:
        yield consistency


def notes(found: RunComparison) -> Iterator[str]:
    """Yield notes on the compared runs, and on what limits the comparison."""
    for run in found.runs:
        done, total = run.progress()
        made = f"{run.manifest.name}, seed {run.manifest.seed}, {done} of {total} trials"
        yield f"{run.folder}: {made}" + (", not finished" if done < total else "")
        yield from known_lines(run)
    n = sum(len(run.rows) for run in found.runs)
    pooled = sum(int(is_pooled_control(run, found.factors).sum()) for run in found.runs)
    if pooled:
        yield f"Left out: the {CONTROL}, which is no estimator, as all estimators are pooled."
    if len(found.trials) < n - pooled:
        yield f"Left out: trials without a crater to go by, {n - pooled - len(found.trials)} of {n - pooled}."
    named = [one for one in found.subjects if one.estimator != CONTROL]
    if len(named) > 1 and not found.contrasts:
        yield "No two subjects share views, priors or tracks, so no differences are given: --unpaired gives them."
    yield from (line for run in found.runs for line in run.manifest.credits)


def _markdown(found: RunComparison, grids: Sequence[Grid], figures: Sequence[NamedFigure], command: str) -> str:
    parts = [f"# {as_title(found.metric.label)} compared", "\n".join(f"- {note}" for note in notes(found))]
    parts += [grid.markdown() for grid in grids]
    parts += [f"![{figure.alt}]({figure.stem}.png)\n\n{figure.caption}" for figure in figures]
    parts += [f"To make this again: `{command}`"] if command else []
    return "\n\n".join(parts) + "\n"
