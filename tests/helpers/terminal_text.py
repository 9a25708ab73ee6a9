"""What the terminal shows of a run."""

import io

from rich.console import Console

from boresight.reports.kinds import brief_grids
from boresight.reports.pages.content import read_content
from boresight.reports.pages.rich_tables import rich_parts


def terminal_lines(run, width=80):
    """Print the tables of a run folder, or of a report's content, in a terminal of so many columns."""
    return printed_lines(brief_grids(run if hasattr(run, "records") else read_content(run)), width)


def printed_lines(grids, width=80):
    """Print tables in a terminal of so many columns."""
    out = io.StringIO()
    Console(file=out, width=width, force_terminal=False).print(*(part for grid in grids for part in rich_parts(grid)))
    return out.getvalue().splitlines()
