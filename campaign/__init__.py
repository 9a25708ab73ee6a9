"""Who runs it: named campaigns, runner, store and command line.

From Python, ``campaign.run("quickstart", trials=50)`` returns the rows of a campaign as a pandas frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from boresight.campaign.runs.start import run

__all__ = ["run"]


def __getattr__(name: str) -> Any:
    """Import `run` when it is asked for: workers and the command line start faster without it."""
    if name == "run":
        from boresight.campaign.runs.start import run

        return run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
