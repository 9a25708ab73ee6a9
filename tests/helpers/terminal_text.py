"""What the terminal shows of a run."""

import io

from rich.console import Console

from boresight.reports.pages.console import console_table


def terminal_lines(run, width=80):
    """Print the tables of a run folder, or of a report's content, in a terminal of so many columns."""
    out = io.StringIO()
    Console(file=out, width=width, force_terminal=False).print(console_table(run))
    return out.getvalue().splitlines()
