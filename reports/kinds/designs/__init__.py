"""Report on a grid of scenarios."""

from __future__ import annotations

from boresight.reports.kinds import ReportKind
from boresight.reports.kinds.designs.figures import design_figures
from boresight.reports.kinds.designs.tables import design_grids

REPORT = ReportKind(
    tables=lambda content: design_grids(content.run),
    brief=lambda content: design_grids(content.run, brief=True),
    figures=lambda content: design_figures(content.run),
)
