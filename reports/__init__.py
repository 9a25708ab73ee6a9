"""What is told: statistics, tables, figures and the report page.

From Python: `read_run` gives the tables of a run folder, `summary` every number of its report with n and interval,
and `write_report` what the command ``report`` writes.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reports.build import write_report
    from reports.content import summary
    from reports.run_data import read_run

__all__ = ["read_run", "summary", "write_report"]

_HOMES = {
    "read_run": "reports.run_data",
    "summary": "reports.content",
    "write_report": "reports.build",
}


def __getattr__(name: str) -> Any:
    """Import a function when it is asked for: pandas and Matplotlib take most of a start-up."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
