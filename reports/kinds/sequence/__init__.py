"""Report of sequences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from boresight.reports.compare.metrics import Metric
from boresight.reports.compare.subjects import compared
from boresight.reports.compare.tables import subject_grid
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.designs import REPORT as DESIGN_REPORT
from boresight.reports.kinds.designs.tables import POSITION, REVOLUTION_ERRORS
from boresight.reports.kinds.sequence.contrasts import cycle_ratio_records, ratio_records, reduction_records
from boresight.reports.kinds.sequence.tables import sequence_brief, sequence_figures, sequence_grid, sequence_grids
from boresight.reports.kinds.sequence.vision import vision_records
from boresight.reports.published import Comparison
from boresight.reports.run.clusters import pools
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.named_figure import NamedFigure
from boresight.reports.schema.records import Record


def records(run: RunData, comparison: Comparison | None) -> Iterable[Record]:
    """Measure vision, and errors and times of estimators against each other."""
    reductions = reduction_records(run, comparison) if comparison else ()
    return (*vision_records(run), *reductions, *ratio_records(run), *cycle_ratio_records(run))


def brief(content: Content) -> Tables:
    """List what the terminal shows: of a grid of scenarios its axes, and before them what is pooled."""
    if content.run.manifest.grid is None:
        return [*_errors_at_the_end(content.run), *sequence_brief(content.records)]
    own = [pool.name for pool in pools(content.run)]
    pooled = sequence_grid([record for record in content.records if record.scenario in own])
    return [pooled, *DESIGN_REPORT.brief(content)]


def _errors_at_the_end(run: RunData) -> list[Grid]:
    """Tabulate the position errors at the last frame of sequences of less than a revolution."""
    if run.rows[list(REVOLUTION_ERRORS)].notna().any(axis=None) or run.rows[POSITION].isna().all():
        return []
    whole = subject_grid(compared((run,), Metric(POSITION)))
    shown = [head for head in whole.columns if head in ("estimator", "scenario", "solved") or head.startswith("median")]
    return [replace(whole.keep(*shown), note="")]


def figures(content: Content) -> Iterable[NamedFigure]:
    """Draw errors along the frames, or, where one thing varies at a time, over the axes."""
    grid = content.run.manifest.grid
    if grid is not None and grid.design == "one-at-a-time":
        return DESIGN_REPORT.figures(content)
    return sequence_figures(content.run)


REPORT = ReportKind(
    records=records,
    tables=lambda content: sequence_grids(content.records, content.compared, content.run),
    brief=brief,
    figures=figures,
)
