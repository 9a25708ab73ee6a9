"""Outcomes of trials: success, the reasons of failures, and the pose errors after each stage."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.data import RunData
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.records import CONTROL, count_of, shortened
from boresight.reports.schema.tables import kind_schema

MEANING = (
    "Solved: trials with an estimate. Success: those of them whose position error is not above that of their prior,"
    " where there is a prior."
)
"""Note of a table that has these two counts."""

_FRAME = r"^frame \d+: "
_NUMBER = r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])"
_TURN_DEG = 360.0
_SAME_FRAME_DEG = 1e-6
_SAME_DEG = 1e-9
_MOST_LINES = 5
_MOST_UNSOLVED = 20
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


def tally(failed: pd.DataFrame, keys: list[str]) -> list[tuple[str, ...]]:
    """Count trials by some columns: their texts and the number, the most frequent first."""
    counted = failed.value_counts(keys, sort=False).sort_index().sort_values(ascending=False, kind="stable")
    return list(counted.reset_index().astype(str).itertuples(index=False, name=None))


def unsolved_lines(run: RunData) -> list[str]:
    """Return a line for each method that solved no trial of a scenario, with its reasons counted; of many the first."""
    failed, _ = unsolved(run)
    lines = []
    for (scenario, estimator), rows in failed.groupby(["scenario", "estimator"], sort=False):
        n = len(run.of(str(scenario), str(estimator)))
        if len(rows) == n:
            reasons = [
                f"{int(count):,} {shortened(reason, _MOST_CHARACTERS)}" for reason, count in tally(rows, ["reason"])
            ]
            more = "" if len(reasons) <= _MOST_LINES else f"; and {count_of(len(reasons) - _MOST_LINES, 'more reason')}"
            lines.append(f"{estimator} solved 0 of {n:,} of {scenario}: {'; '.join(reasons[:_MOST_LINES])}{more}")
    rest = len(lines) - _MOST_UNSOLVED
    return [*lines[:_MOST_UNSOLVED], f"and {count_of(rest, 'more method')} in a scenario"] if rest > 0 else lines


def reason_lines(run: RunData) -> list[str]:
    """Return a few lines on why trials have no estimate, the most frequent reason first; [] where all have one."""
    failed, _ = unsolved(run)
    if failed.empty:
        return []
    reasons = tally(failed, ["estimator", "status", "reason"])
    lines = [f"no estimate in {len(failed):,} of {count_of(len(run.rows), 'trial')}, each estimator's counted:"]
    for estimator, status, reason, count in reasons[:_MOST_LINES]:
        lines.append(f"  {int(count):,} {status}, {estimator}: {shortened(reason, _MOST_CHARACTERS)}")
    rest = reasons[_MOST_LINES:]
    if rest:
        trials = sum(int(one[-1]) for one in rest)
        lines.append(f"  {trials:,} for {count_of(len(rest), 'more reason')}: see the table of failures in the report")
    return lines


def final_stage(run: RunData, scenario: str, estimator: str) -> str:
    """Return the last stage that the estimator reports; its errors are those of the rows."""
    names = run.of(scenario, estimator, "stages")["stage"].unique()
    return str(names[-1]) if len(names) and names[-1] != CONTROL else "final"


def errors_by_stage(run: RunData, scenario: str, estimator: str) -> dict[str, pd.DataFrame]:
    """Collect pose errors (trial, POSE_COLUMNS) of the prior, each stage and the final estimate, in order.

    The prior is known for every trial, a stage for the trials that reached it, the final estimate for
    those that are ok.
    """
    rows = run.of(scenario, estimator)
    columns = ["trial", *POSE_COLUMNS]
    prior = rows[["trial", *(f"prior_{name}" for name in POSE_COLUMNS)]].set_axis(columns, axis=1)
    stages = run.of(scenario, estimator, "stages")
    last = final_stage(run, scenario, estimator)
    between = [name for name in stages["stage"].unique() if name not in (CONTROL, last)]
    found = {CONTROL: prior} | {name: stages.loc[stages["stage"] == name, columns] for name in between}
    if estimator != CONTROL:
        found[last] = run.solved(scenario, estimator)[columns]
    return found


def revolution_ends(epochs: pd.DataFrame) -> Iterator[tuple[int, pd.DataFrame]]:
    """Yield the number of each whole revolution, from 1, and the frames that end it."""
    last_deg = float(epochs["anomaly_deg"].fillna(0.0).max()) if len(epochs) else 0.0
    for k in range(1, int((last_deg + _SAME_FRAME_DEG) // _TURN_DEG) + 1):
        yield k, epochs[(epochs["anomaly_deg"] - k * _TURN_DEG).abs() < _SAME_FRAME_DEG]


def keeping_attitude(rows: pd.DataFrame) -> set[str]:
    """Name the estimators whose solved trials all have the attitude error of the prior: they do not estimate it."""
    solved = rows[rows["status"] == "ok"]
    same = (solved["attitude_error_deg"] - solved["prior_attitude_error_deg"]).abs() < _SAME_DEG
    return set(solved["estimator"]) - set(solved.loc[~same, "estimator"])


def succeeded(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Mark the successful trials: an estimate, with a position error that is not above that of the trial's own prior.

    A trial has a prior where its row holds the prior's error: single images and pose convergence. In others the
    estimate alone decides, as the spacecraft would have no pose without it: of sequences (dead reckoning is one more
    estimator), of orbits (the error of the a priori orbit is a choice of the scenario), of images of craters and of
    data bases.
    """
    worse = rows["position_error_m"].to_numpy() > rows["prior_position_error_m"].to_numpy()
    return np.asarray((rows["status"] == "ok").to_numpy() & ~worse)
