"""The tables and figures of a run's report, by the kind of its trials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from reports.kinds.kind import Content, report_kind
from reports.run.conditional import of_what_was_drawn
from reports.run.data import RunData
from reports.run.known import short_line
from reports.schema.grid import Grid
from reports.schema.named_figure import NamedFigure
from reports.tables.general import failure_grid
from reports.verdicts.tables import claim_grid, verdict_grid


def report_grids(content: Content) -> list[Grid]:
    """List the tables of a report, in order; of a grid of scenarios, those of the grid alone."""
    found = report_kind(content.run).tables(content)
    grids = (grid for grid in (*found, claim_grid(content.claims), failure_grid(content.run)) if grid is not None)
    return _headed(content.run, list(of_what_was_drawn(grids, content.run)))


def brief_grids(content: Content) -> list[Grid]:
    """List what the terminal shows at the end of a run."""
    found = report_kind(content.run).brief(content)
    told = (verdict_grid(content.compared), claim_grid([one for one in content.claims if not one.claim.unmeasured]))
    grids = (grid for grid in (*found, *told) if grid is not None)
    return _headed(content.run, list(of_what_was_drawn(grids, content.run)))


def _headed(run: RunData, grids: list[Grid]) -> list[Grid]:
    """Put what was known on board beside the headline: the first table, if it does not say so already."""
    if not grids or grids[0].known:
        return grids
    return [replace(grids[0], known=short_line(run)), *grids[1:]]


def draw_figures(content: Content) -> Iterator[NamedFigure]:
    """Draw every figure that the run's tables allow; of a grid of scenarios those of the grid alone."""
    yield from report_kind(content.run).figures(content)
