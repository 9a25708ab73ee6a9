"""What a report tells of trials of single images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from reports.kinds.designs.report import REPORT as OF_DESIGN
from reports.kinds.kind import Content, ReportKind, Tables
from reports.kinds.single_image.figures import image_figures
from reports.kinds.single_image.sensitivity import mesh_variants, sensitivity_grid
from reports.kinds.single_image.tradeoff import trade_grid
from reports.published import Comparison
from reports.run.data import RunData
from reports.run.derived import derived_records
from reports.schema.grid import Grid
from reports.schema.named_figure import NamedFigure
from reports.schema.records import CONTROL, Record
from reports.statistics.consistency import consistency_grid
from reports.statistics.paired import paired_grid
from reports.statistics.roc import outlier_grid
from reports.tables.general import detail_grid, diagnostic_grid, pose_grids, reference_grid, timing_grid
from reports.verdicts.tables import comparison_grid


def records(run: RunData, comparison: Comparison | None) -> Iterator[Record]:
    """Yield what follows from the scenario alone, where the paper names the body's radius."""
    if comparison is not None and comparison.radius_m:
        yield from derived_records(run, comparison.radius_m)


def tables(content: Content) -> Tables:
    """List the tables of single images, or of the grid that their scenarios are."""
    measured, run = content.records, content.run
    if run.manifest.grid is not None:
        return OF_DESIGN.tables(content)
    return (
        *pose_grids(measured, run),
        reference_grid(measured, run),
        comparison_grid(content.compared),
        trade_grid(run),
        detail_grid(measured),
        diagnostic_grid(measured),
        paired_grid(measured),
        consistency_grid(measured),
        sensitivity_grid(measured, mesh_variants(run)),
        outlier_grid(measured),
        timing_grid(measured),
    )


def pose_brief(content: Content) -> list[Grid]:
    """List the errors of poses for the terminal."""
    several = len({r.estimator for r in content.records if r.estimator and r.stage != CONTROL}) > 1
    counted = (*(["estimator"] if several else []), "stage", "solved", "success")
    return [grid.keep(*counted, "position m", "attitude deg") for grid in pose_grids(content.records, content.run)]


def brief(content: Content) -> Tables:
    """List what the terminal shows."""
    return pose_brief(content) if content.run.manifest.grid is None else OF_DESIGN.brief(content)


def figures(content: Content) -> Iterable[NamedFigure]:
    """Draw the figures of single images, or of the grid that their scenarios are."""
    return image_figures(content) if content.run.manifest.grid is None else OF_DESIGN.figures(content)


REPORT = ReportKind(records=records, tables=tables, brief=brief, figures=figures)
