"""Pages of a comparison and of a sensitivity analysis, with their tables as CSV and their figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from boresight.reports.compare.figures import comparison_figures
from boresight.reports.compare.global_sensitivity import Sensitivity, VariedKey, draw_sensitivity
from boresight.reports.compare.subjects import RunComparison
from boresight.reports.compare.tables import consistency_tables, contrast_tables, limits, subject_tables
from boresight.reports.figures.named import NamedFigure, add_provenance
from boresight.reports.pages.document import ON_BOARD, Document, write_document
from boresight.reports.run.data import RunData
from boresight.reports.run.limits import known_lines
from boresight.reports.schema.column import Measure
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import as_title, count_of
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError


def write_comparison(found: RunComparison, folder: Path, command: str = "") -> tuple[Path, tuple[Grid, ...]]:
    """Write ``compare.html``, ``compare.md``, the tables as CSV, and the figures (PNG and PDF) of a comparison.

    The tables are ``subjects.csv``, ``differences.csv`` and ``consistency.csv``. Return the path of the page, and the
    printed tables. Raises `BoresightError` if the folder cannot be written.
    """
    tables = {
        "subjects.csv": subject_tables(found),
        "differences.csv": contrast_tables(found),
        "consistency.csv": consistency_tables(found),
    }
    grids = tuple(grid for grid, _ in tables.values() if grid is not None)
    lead, *figures = comparison_figures(found)
    for one in (lead, *figures):
        add_provenance(one.figure, found.runs)
    document = Document(
        product="boresight compare",
        title=f"{as_title(found.metric.label)} compared",
        facts=list(facts(found)),
        grids=grids,
        leads=[lead],
        figures=figures,
        command=command,
        credits=found.credits,
    )
    try:
        page = write_document(document, folder, "compare.html", "compare.md")
        for name, (_, numbers) in tables.items():
            numbers.to_csv(folder / name, index=False, lineterminator="\n")
    except OSError as error:
        raise BoresightError(
            f"{folder}: the comparison cannot be written: {error.strerror}; choose another --out"
        ) from error
    return page, grids


def facts(found: RunComparison) -> Iterator[tuple[str, str]]:
    """Yield names and values of what is compared, and of what limits the comparison."""
    for run in found.runs:
        done, total = run.progress()
        made = f"{run.manifest.name}, seed {run.manifest.seed}, {done} of {total} trials"
        yield "Run", f"{run.folder}: {made}" + (", not finished" if done < total else "")
    yield from ((ON_BOARD, line) for line in dict.fromkeys(line for run in found.runs for line in known_lines(run)))
    yield from limits(found)


def write_sensitivity(
    run: RunData,
    found: Sequence[Sensitivity],
    grid: Grid,
    varied: Sequence[VariedKey],
    samples: FloatArray,
    metric: Measure,
) -> Path:
    """Write a sensitivity analysis into the folder ``sensitivity`` of a run; return the path of the page.

    The files are ``sensitivity.html``, ``sensitivity.md``, ``samples.csv`` (every sample with its outcomes),
    ``indices.csv`` and the figure.
    """
    folder = run.folder / "sensitivity"
    keys = [one.key for one in varied]
    table = pd.DataFrame(samples, columns=keys).assign(**{one.estimator: one.outcomes for one in found})
    indices = [
        {"estimator": one.estimator, "key": key, "index": name, "value": m.value, "low": m.low, "high": m.high}
        for one in found
        for name, shares in one.shares.items()
        for key, m in zip(keys, shares, strict=True)
    ]
    figure = draw_sensitivity(found, keys, samples, metric.axis)
    add_provenance(figure, [run])
    manifest = run.manifest
    page = Document(
        product="boresight sensitivity",
        title=f"Sensitivity of the {metric.label}, {manifest.name}",
        facts=[
            *(("Varied", f"{one.key} from {one.low:g} to {one.high:g}") for one in varied),
            ("Samples", f"{len(samples)}, of {count_of(manifest.trials, 'trial')} each, seed {manifest.seed}"),
            (ON_BOARD, grid.known),
            *(
                ("No effect", f"{key} changes no result of {one.estimator}, bit for bit.")
                for one in found
                for key in one.unmoved
            ),
        ],
        grids=[grid],
        leads=[
            NamedFigure(
                "sensitivity",
                figure,
                "Indices of each varied key with their 95 % intervals, and the outcome of every sample against each"
                " key. The dashed line is the outcome with no key varied.",
                "Indices and outcomes of each varied key",
            )
        ],
        command=manifest.command,
        credits=manifest.credits,
    )
    path = write_document(page, folder, "sensitivity.html", "sensitivity.md")
    table.to_csv(folder / "samples.csv", index=False, lineterminator="\n")
    pd.DataFrame(indices).to_csv(folder / "indices.csv", index=False, lineterminator="\n")
    return path
