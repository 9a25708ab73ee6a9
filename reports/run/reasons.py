"""Why trials have no estimate: reasons that differ in numbers alone are one."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from reports.run.data import RunData
from reports.schema.labels import count_of

_FRAME = r"^frame \d+: "
_NUMBER = r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])"
_MOST_LINES = 5
_MOST_CHARACTERS = 110


def unsolved(run: RunData) -> tuple[pd.DataFrame, bool]:
    """Return the rows of trials without an estimate, and whether numbers in their reasons were made one.

    Reasons that differ in numbers alone are one, with n for the number, and of sequences those of all frames.
    """
    failed = run.rows[run.rows["status"] != "ok"]
    reason = failed["reason"] if run.table("epochs").empty else failed["reason"].str.replace(_FRAME, "", regex=True)
    alike = reason.str.replace(_NUMBER, "n", regex=True)
    merged = reason.groupby(alike).transform("nunique") > 1
    return failed.assign(reason=reason.where(~merged, alike)), bool(merged.any())


def _items(tally: pd.Series) -> Iterator[tuple[str, str, str, int]]:
    for estimator, status, reason, trials in tally.reset_index().itertuples(index=False, name=None):
        yield str(estimator), str(status), str(reason), int(trials)


def reason_lines(run: RunData) -> list[str]:
    """Say in a few lines why trials have no estimate, the most frequent reason first; none where all have one."""
    failed, _ = unsolved(run)
    if failed.empty:
        return []
    tally = failed.value_counts(["estimator", "status", "reason"], sort=False).sort_index()
    tally = tally.sort_values(ascending=False, kind="stable")
    lines = [f"no estimate in {len(failed):,} of {count_of(len(run.rows), 'trial')}, each estimator's counted:"]
    for estimator, status, reason, trials in _items(tally.head(_MOST_LINES)):
        why = reason if len(reason) <= _MOST_CHARACTERS else f"{reason[: _MOST_CHARACTERS - 3]}..."
        lines.append(f"  {trials:,} {status}, {estimator}: {why}")
    if len(tally) > _MOST_LINES:
        rest = count_of(len(tally) - _MOST_LINES, "more reason")
        lines.append(f"  {int(tally.iloc[_MOST_LINES:].sum()):,} for {rest}: see the table of failures in the report")
    return lines
