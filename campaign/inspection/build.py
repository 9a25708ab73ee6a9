"""Pages of inspected cases: recompute a case, compare it with the stored one, write its data and draw it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from boresight.campaign.inspection.recompute import ORDER, Case, Choice, Recomputed, recompute, worst_cases
from boresight.campaign.inspection.show import CaseFigures, CaseFiles, Show, show_of
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import RunFolder
from boresight.campaign.trial.images import write_image
from boresight.reports.figures.named import NamedFigure
from boresight.reports.pages.build import LEAD
from boresight.reports.pages.document import CasePage, write_document
from boresight.reports.run.data import read_run
from boresight.reports.schema.grid import NO_VALUE, Grid, number
from boresight.reports.schema.records import CONTROLS, as_title
from boresight.reports.schema.tables import TABLES, measure_label, schema
from boresight.scenarios.atomic import write_atomically, write_text

_SHORT = ("stages", "references", "diagnostics", "orbits", "crater_matches")
"""Tables with few rows per case, shown on its page; longer ones are only written as Parquet."""


def case_figures(campaign: ResolvedCampaign, folder: RunFolder, worst: int) -> Iterator[NamedFigure]:
    """Draw the first figure of the trial in the middle, and of each of the ``worst`` trials.

    The former is of the first scenario and its first method that measures. None if recomputing a trial takes minutes.
    """
    show = show_of(campaign.spec.experiment)
    if worst == 0 or show is None or show.long(campaign):
        return
    run = read_run(folder.path)
    label = next((label for label in campaign.labels if label not in CONTROLS), campaign.labels[0])
    cases, ranked_by = worst_cases(run, len(run.rows), Choice(campaign.scenarios[0].spec.name, label), None)
    for figure in islice(draw_case(recompute(campaign, folder, cases[len(cases) // 2]), show, campaign).figures, 1):
        rank = f"In the middle of {len(cases)}, from the worst to the best by {measure_label(ranked_by)}"
        yield replace(figure, stem=LEAD, caption=f"{rank}: {figure.caption}")
    cases, ranked_by = worst_cases(run, worst, Choice(), None)
    for place, case in enumerate(cases, start=1):
        again = recompute(campaign, folder, case)
        for figure in islice(draw_case(again, show, campaign).figures, 1):
            reason = f" ({again.row['reason']})" if again.row["reason"] else ""
            words = (
                f"Worst {place} of {len(cases)} by {ORDER} {measure_label(ranked_by)}: {again.row['status']}{reason};"
                f" {figure.caption}"
                f" All of it: boresight inspect {folder.path} --scenario {case.scenario} --estimator {case.estimator}"
                f" --trial {case.trial}"
            )
            yield replace(figure, stem=f"worst_{place}", caption=words)


def _keep(again: Recomputed, show: Show | None, folder: Path) -> None:
    """Write the tables of a case as Parquet, its images as TIFF, and the estimate as JSON."""
    for name, records in again.records.items():
        if records:
            table = pa.Table.from_pylist([dict(record) for record in records], schema=schema(name))
            write_atomically(folder / "tables" / f"{name}.parquet", partial(pq.write_table, table))
    shown = CaseFiles() if show is None or again.shown is None else show.kept(again.shown)
    for name, image in shown.images.items():
        write_image(folder / f"{name}.tiff", image)
    if shown.estimate is not None:
        write_text(folder / "estimate.json", json.dumps(shown.estimate, indent=1) + "\n")


def inspect_case(
    campaign: ResolvedCampaign, folder: RunFolder, case: Case, out: Path, pdf: bool
) -> tuple[Recomputed, Path]:
    """Recompute one case, write its data to a folder below ``out``, and draw its stages; also return its page.

    Raise BoresightError if its world cannot be rebuilt, or a file cannot be written.
    """
    again, place, show = recompute(campaign, folder, case), out / case.stem, show_of(campaign.spec.experiment)
    _keep(again, show, place)
    drawn = draw_case(again, show, campaign)
    row, manifest = again.row, folder.read_manifest() or {}
    facts = (
        ("Run", str(folder.path)),
        ("Campaign", campaign.spec.title or campaign.spec.name),
        ("Status", f"{row['status']}: {row['reason']}" if row["reason"] else str(row["status"])),
        ("Recomputed", str(again.comparison)),
        ("Seed", str(campaign.seed)),
        ("Commit", str(manifest.get("commit") or "")),
        ("Image", str(row.get("image") or "")),
    )
    named = ["--scenario", case.scenario, "--estimator", case.estimator, "--trial", str(case.trial)]
    page = CasePage(
        product="boresight inspect",
        title=str(case),
        facts=[(name, value) for name, value in facts if value],
        notes=drawn.notes,
        grids=list(_grids(again)),
        figures=list(drawn.figures),
        command=shlex.join(["boresight", "inspect", str(folder.path), *named]),
        traceback=again.traceback,
        said=again.said,
        credits=drawn.credits,
    )
    kinds = ("png", "pdf") if pdf else ("png",)
    return again, write_document(page, place, "index.html", kinds=kinds)


def draw_case(again: Recomputed, show: Show | None, campaign: ResolvedCampaign) -> CaseFigures:
    """Draw the completed stages of a case, or return a note that there is nothing to draw."""
    if show is not None and again.shown is not None:
        return show.draw(again)
    kind = campaign.spec.experiment
    why = f"trials of {kind} hold numbers alone" if show is None else "the trial ended before an estimator saw anything"
    return CaseFigures([], notes=[f"There is nothing to draw: {why}."])


def _grids(again: Recomputed) -> Iterator[Grid]:
    """Yield the row of a case with the meaning of its values, and its short tables."""
    meanings = {column.name: column.meaning for column in TABLES["rows"]}
    key = ("trial", "scenario", "estimator", "status", "reason", "image")
    known = [(name, value) for name, value in again.row.items() if name not in key and value is not None]
    cells = tuple((name, _cell(value), meanings[name]) for name, value in known)
    yield Grid("Row", ("column", "value", "meaning"), cells, frozenset({0, 2}))
    for name in (name for name in _SHORT if again.records.get(name)):
        records = again.records[name]
        columns = tuple(c for c in records[0] if c not in key[:3])
        rows = tuple(tuple(_cell(record.get(column)) for column in columns) for record in records)
        text = frozenset(i for i, column in enumerate(columns) if isinstance(records[0][column], str))
        yield Grid(as_title(name.replace("_", " ")), columns, rows, text)


def _cell(value: object) -> str:
    if value is None:
        return NO_VALUE
    return number(value) if isinstance(value, float) else str(value)
