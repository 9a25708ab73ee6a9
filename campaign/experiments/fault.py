"""What is stored of a trial in which a method raised."""

from __future__ import annotations

import traceback

from campaign.experiments.registry import Record, Records


def faulted(method: str, row: Record) -> Records:
    """Complete the row of a trial whose ``method`` (an estimator, a detector) raised, and keep the trace.

    To be called while the exception is handled.
    """
    reason = f"the {method} raised or returned rubbish: see the table tracebacks"
    failed: Record = {**row, "status": "error", "reason": reason, "n_landmarks": 0}
    return {"rows": [failed], "tracebacks": [{"traceback": traceback.format_exc()}]}
