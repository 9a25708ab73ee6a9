"""Outcomes of trials: success, the reasons of failures, and the pose errors after each stage."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.data import RunData, select
from boresight.reports.schema.common import POSE_COLUMNS
from boresight.reports.schema.labels import count_of
from boresight.reports.schema.records import CONTROL
from boresight.reports.schema.tables import kind_schema

MEANING = (
    "Solved: trials with an estimate. Success: those of them whose position error is not above that of their prior,"
    " where there is a prior."
)
"""Note of a table that has these two counts."""

_FRAME = r"^frame \d+: "
_NUMBER = r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])"
_MOST_LINES = 5
_MOST_CHARACTERS = 110


def unsolved(run: RunData) -> tuple[pd.DataFrame, bool]:
    """Return the rows of trials without an estimate, and whether any of their reasons were merged.

    Reasons that differ in numbers alone are merged, with n for the number; of sequences, those of all frames.
    """
    failed = run.rows[run.rows["status"] != "ok"]
    framed = kind_schema(run.manifest.experiment).frames
    reason = failed["reason"].str.replace(_FRAME, "", regex=True) if framed else failed["reason"]
    alike = reason.str.replace(_NUMBER, "n", regex=True)
    merged = reason.groupby(alike).transform("nunique") > 1
    return failed.assign(reason=reason.where(~merged, alike)), bool(merged.any())


def _items(tally: pd.Series) -> Iterator[tuple[str, str, str, int]]:
    for estimator, status, reason, trials in tally.reset_index().itertuples(index=False, name=None):
        yield str(estimator), str(status), str(reason), int(trials)


def reason_lines(run: RunData) -> list[str]:
    """Return a few lines on why trials have no estimate, the most frequent reason first; [] where all have one."""
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


def final_stage(run: RunData, scenario: str, estimator: str) -> str:
    """Return the last stage that the estimator reports; its errors are those of the rows."""
    names = select(run.table("stages"), scenario, estimator)["stage"].unique()
    return str(names[-1]) if len(names) and names[-1] != CONTROL else "final"


def errors_by_stage(run: RunData, scenario: str, estimator: str) -> dict[str, pd.DataFrame]:
    """Collect pose errors (trial, POSE_COLUMNS) of the prior, each stage and the final estimate, in order.

    The prior is known for every trial, a stage for the trials that reached it, the final estimate for
    those that are ok.
    """
    rows = select(run.rows, scenario, estimator)
    prior = rows[["trial"]].assign(**{name: rows[f"prior_{name}"] for name in POSE_COLUMNS})
    stages = select(run.table("stages"), scenario, estimator)
    last = final_stage(run, scenario, estimator)
    between = [name for name in stages["stage"].unique() if name not in (CONTROL, last)]
    columns = ["trial", *POSE_COLUMNS]
    found = {CONTROL: prior} | {name: stages.loc[stages["stage"] == name, columns] for name in between}
    if estimator != CONTROL:
        found[last] = rows.loc[rows["status"] == "ok", columns]
    return found


def succeeded(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Mark the successful trials: an estimate, with a position error that is not above that of the trial's own prior.

    A trial has a prior where its row holds the prior's error: single images and pose convergence. In others the
    estimate alone decides, as the spacecraft would have no pose without it: of sequences (dead reckoning is one more
    estimator), of orbits (the error of the a priori orbit is a choice of the scenario), of images of craters and of
    data bases.
    """
    worse = rows["position_error_m"].to_numpy() > rows["prior_position_error_m"].to_numpy()
    return np.asarray((rows["status"] == "ok").to_numpy() & ~worse)
