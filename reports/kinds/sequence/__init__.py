"""Report of sequences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from boresight.reports.compare.subjects import compared
from boresight.reports.compare.tables import subject_tables
from boresight.reports.figures.named import NamedFigure
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.designs import POSITION, REVOLUTION_ERRORS, design_figures, design_grids
from boresight.reports.kinds.sequence.contrasts import cycle_ratio_records, ratio_records, reduction_records
from boresight.reports.kinds.sequence.tables import (
    ratio_grids,
    sequence_brief,
    sequence_figures,
    sequence_grid,
    sequence_measures,
    sign_grids,
    vision_grid,
    vision_records,
    without_pooled,
)
from boresight.reports.published import Comparison
from boresight.reports.run.clusters import pools
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import Grid
from boresight.reports.schema.records import Record
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.consistency import consistency_grid
from boresight.reports.tables import diagnostic_grid, timing_grid
from boresight.reports.verdicts import comparison_grid


def records(run: RunData, comparison: Comparison | None) -> Iterable[Record]:
    """Measure whole sequences, vision, and errors and times of estimators against each other."""
    reductions = reduction_records(run, comparison) if comparison else ()
    return (
        *sequence_measures(run), *vision_records(run), *reductions, *ratio_records(run), *cycle_ratio_records(run),
    )  # fmt: skip


def tables(content: Content) -> Tables:
    """List the tables of a run of sequences; where one thing at a time is varied, those of the grid alone."""
    run = content.run
    if run.manifest.grid is not None and run.manifest.grid.design == "one-at-a-time":
        return design_grids(run)
    shown = without_pooled(run, content.records)
    return (
        comparison_grid(content.compared),
        *ratio_grids(shown),
        *sign_grids(shown, run),
        sequence_grid(shown),
        consistency_grid(shown),
        vision_grid(shown),
        *design_grids(run),
        diagnostic_grid(shown),
        timing_grid(shown),
    )


def brief(content: Content) -> Tables:
    """List what the terminal shows: of a grid of scenarios its axes, and before them what is pooled."""
    if content.run.manifest.grid is None:
        return [*_errors_at_the_end(content.run), *sequence_brief(content.records)]
    own = [pool.name for pool in pools(content.run)]
    pooled = sequence_grid([record for record in content.records if record.scenario in own])
    return [pooled, *design_grids(content.run, brief=True)]


def _errors_at_the_end(run: RunData) -> list[Grid]:
    """Tabulate the position errors at the last frame of sequences of less than a revolution."""
    if run.rows[list(REVOLUTION_ERRORS)].notna().any(axis=None) or run.rows[POSITION].isna().all():
        return []
    whole, _ = subject_tables(compared((run,), measure_of(POSITION)))
    names = ("estimator", "scenario", "trials", "solved")
    shown = [head for head in whole.columns if head in names or head.startswith("median")]
    return [replace(whole.keep(*shown), note="")]


def figures(content: Content) -> Iterable[NamedFigure]:
    """Draw errors along the frames, or, where one thing varies at a time, over the axes."""
    grid = content.run.manifest.grid
    if grid is not None and grid.design == "one-at-a-time":
        return design_figures(content.run)
    return sequence_figures(content.run)


REPORT = ReportKind(records=records, tables=tables, brief=brief, figures=figures)
