"""The tables that the terminal shows of a run."""

from __future__ import annotations

from pathlib import Path

from rich.console import Group

from boresight.reports.kinds import Content, brief_grids
from boresight.reports.pages.content import read_content
from boresight.reports.pages.rich_tables import rich_parts


def console_table(run: Path | Content) -> Group:
    """Build the main tables of a run, and the verdicts where values are published.

    Parameters
    ----------
    run
        A run folder, or the content of a report that was just written.
    """
    content = read_content(run) if isinstance(run, Path) else run
    return Group(*(part for grid in brief_grids(content) for part in rich_parts(grid)))
