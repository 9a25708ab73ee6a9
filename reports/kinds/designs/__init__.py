"""Report on a grid of scenarios."""

from __future__ import annotations

from boresight.reports.kinds import Content, ReportKind
from boresight.reports.kinds.designs.figures import design_figures
from boresight.reports.kinds.designs.tables import design_grids
from boresight.reports.schema.grid import Grid


def brief(content: Content) -> list[Grid]:
    """List the tables of a grid for the terminal, without changes from level to level."""
    grids = design_grids(content.run)
    return [grid.keep(*(column for column in grid.columns if column != "change")) for grid in grids]


REPORT = ReportKind(
    tables=lambda content: design_grids(content.run),
    brief=brief,
    figures=lambda content: design_figures(content.run),
)
