"""What a report tells of trials of crater detection."""

from __future__ import annotations

from reports.kinds.crater_detection.figures import crater_figures
from reports.kinds.crater_detection.rates import crater_brief, crater_grids, crater_records, shown
from reports.kinds.crater_detection.rims import rim_grid
from reports.kinds.kind import Content, ReportKind, Tables
from reports.tables.general import timing_grid
from reports.verdicts.tables import comparison_grid


def tables(content: Content) -> Tables:
    """List the tables of a report."""
    return (
        *crater_grids(content.records, content.run),
        rim_grid(list(shown(content.run))),
        comparison_grid(content.compared),
        timing_grid(content.records),
    )


REPORT = ReportKind(
    records=lambda run, comparison: crater_records(run),
    tables=tables,
    brief=lambda content: crater_brief(content.records),
    figures=lambda content: () if content.run.craters.empty else crater_figures(content.run),
)
