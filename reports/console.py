"""What the terminal shows at the end of a run; it fits 80 columns."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from reports.clusters import pools
from reports.comparison_tables import verdict_grid
from reports.content import Content, read_content
from reports.crater_matching import matching_brief
from reports.designs import design_grids
from reports.grid import Grid
from reports.records import CONTROL
from reports.sequences import sequence_grid
from reports.tables import pose_grids
from scenarios.errors import printable


def console_table(run: Path | Content) -> Group:
    """Build the table of what a run is about, and the verdicts where values are published; of a grid, its tables.

    Parameters
    ----------
    run
        A run folder, or the content of a report that was just written.
    """
    content = read_content(run) if isinstance(run, Path) else run
    if not content.run.crater_matches.empty:
        brief = [*matching_brief(content.records, content.run), verdict_grid(content.compared)]
        return Group(*(rich_table(grid) for grid in brief if grid is not None))
    if content.run.manifest.grid is not None:
        own = [pool.name for pool in pools(content.run)]
        pooled = sequence_grid([record for record in content.records if record.scenario in own])
        found = [*([] if pooled is None else [pooled]), *design_grids(content.run)]
        return Group(*(rich_table(grid.keep(*(c for c in grid.columns if c != "change"))) for grid in found))
    several = len({r.estimator for r in content.records if r.estimator and r.stage != CONTROL}) > 1
    columns = (*(["estimator"] if several else []), "stage", "ok", "position m", "x", "y", "z", "attitude deg")
    grids = [*(grid.keep(*columns) for grid in pose_grids(content.records)), verdict_grid(content.compared)]
    return Group(*(rich_table(grid) for grid in grids if grid is not None))


def rich_table(grid: Grid) -> Table:
    """Lay a grid out: numbers keep to one line, texts may wrap."""
    table = Table(title=grid.title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    table.show_edge, table.padding = False, 0
    for i, column in enumerate(grid.columns):
        is_text = i in grid.text
        table.add_column(column, justify="left" if is_text else "right", no_wrap=not is_text, overflow="fold")
    for row in grid.rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    return table
