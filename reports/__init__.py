"""Statistics, tables, figures and the report page of stored runs.

From Python: `read_run` gives the tables of a run folder, `summary` every number of its report with n and interval,
and `write_report` what the command ``report`` writes.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from boresight.reports.pages.build import write_report
    from boresight.reports.pages.content import summary
    from boresight.reports.run.data import read_run

__all__ = ["read_run", "summary", "write_report"]

_HOMES = {
    "read_run": "boresight.reports.run.data",
    "summary": "boresight.reports.pages.content",
    "write_report": "boresight.reports.pages.build",
}


def __getattr__(name: str) -> Any:
    """Import a function at its first use: pandas and Matplotlib take most of the start-up time."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
