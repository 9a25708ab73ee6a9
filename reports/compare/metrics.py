"""What runs are compared by: an error of each trial, and the error that a failure is counted with."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from reports.labels import measure_label
from reports.measures import SEQUENCE_COLUMNS
from reports.records import unit_of
from reports.run_data import POSE_COLUMNS, RunData
from scenarios.errors import BoresightError

LATERAL, BORESIGHT = "lateral_error_m", "boresight_error_m"
COMPONENTS: Mapping[str, tuple[str, ...]] = {
    LATERAL: ("position_error_x_m", "position_error_y_m"),
    BORESIGHT: ("position_error_z_m",),
}
"""Errors across and along the camera's boresight, by the columns whose root sum of squares they are."""

ORBIT_COLUMNS = (
    "arc_rms_m", "arc_median_m", "arc_p90_m", "predicted_error_m", "residual_rms_px", "wrong_left_share",
    "right_edited_share",
)  # fmt: skip
"""Of orbit determination: columns of the table ``orbits``; the position error is that at the epoch."""
MISSED, WRONG = "missed_share", "wrong_share"
"""Of crater matching: craters in both images that were not matched, and matches that are wrong, of all of either."""

_POSED = (*POSE_COLUMNS, *COMPONENTS)
_AFTER = re.compile(r"error_after_([1-9]\d*)_m")
_LABELS = {
    LATERAL: "position error across the boresight",
    BORESIGHT: "position error along the boresight",
}
_TURN_DEG = 360.0
_SAME_FRAME_DEG = 1e-6


@dataclass(frozen=True, slots=True)
class Metric:
    """An error, smaller being better.

    Parameters
    ----------
    name
        A column of the rows, `LATERAL`, `BORESIGHT`, ``error_after_K_m`` (sequences, after K revolutions), one of
        `ORBIT_COLUMNS`, `MISSED`, `WRONG` or a number that estimators report.
    """

    name: str

    @property
    def unit(self) -> str:
        """Unit, '' where it has none."""
        return unit_of(self.name)

    @property
    def label(self) -> str:
        """In words, without the unit."""
        turns = _AFTER.fullmatch(self.name)
        if turns:
            return f"position error after {turns[1]} revolution{'' if turns[1] == '1' else 's'}"
        return _LABELS.get(self.name) or measure_label(self.name)

    @property
    def axis(self) -> str:
        """In words, with the unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label


def choose_metric(name: str | None, runs: Sequence[RunData]) -> Metric:
    """Take the named metric; without a name the position error, of sequences after the last whole revolution.

    Of runs without a position error, as those of crater matching, it is the first number that they have.

    Raises
    ------
    BoresightError
        If a run has no such number; the message lists what it has.
    """
    for run in runs:
        known = metric_names(run)
        if not known:
            raise BoresightError(f"{run.folder}: its trials have no number to go by; see boresight report {run.folder}")
        if name is None:
            name = _default(known, run)
        if name not in known:
            raise BoresightError(f"--metric {name}: {run.folder} has no such number: choose one of {', '.join(known)}")
    return Metric(name or POSE_COLUMNS[0])


def metric_names(run: RunData) -> list[str]:
    """List what a run can be compared by: errors that it holds for at least one trial."""
    rows = run.rows
    posed = [name for name in _POSED if all(column in rows for column in COMPONENTS.get(name, (name,)))]
    names = [name for name in posed if rows[COMPONENTS.get(name, (name,))[0]].notna().any()]
    names += [name for name in SEQUENCE_COLUMNS if name in rows and rows[name].notna().any()]
    if not run.epochs.empty:
        turns = int((float(run.epochs["anomaly_deg"].max()) + _SAME_FRAME_DEG) // _TURN_DEG)
        names += [f"error_after_{k}_m" for k in range(1, turns + 1)]
    names += list(_tables(run))
    reported = run.diagnostics["name"].astype(str).unique()
    return list(dict.fromkeys([*names, *sorted(reported)]))


def names_before_a_run(experiment: str) -> tuple[str, ...]:
    """List the metrics that are sure to be told of an experiment of this kind before it has run."""
    return ("position_error_m", *SEQUENCE_COLUMNS) if experiment == "sequence" else _POSED


def _default(known: Sequence[str], run: RunData) -> str:
    after = [int(found[1]) for found in map(_AFTER.fullmatch, known) if found]
    if run.epochs.empty or not after:
        return POSE_COLUMNS[0] if POSE_COLUMNS[0] in known else known[0]
    return f"error_after_{max(after)}_m"


def metric_values(run: RunData, metric: Metric) -> pd.Series:
    """Return the metric of every row of a run, in the order of its rows; NaN where a trial has none.

    Signed errors count by their size.
    """
    rows, name = run.rows, metric.name
    if name in _POSED:
        ok = (rows["status"] == "ok").to_numpy()
        return pd.Series(np.where(ok, _size(rows, "", name), np.nan), index=rows.index)
    if name in rows:
        return rows[name].astype(float)
    tables = _tables(run)
    if name in tables:
        return _laid_on(rows, tables[name], name).where(rows["status"] == "ok").abs()
    turns = _AFTER.fullmatch(name)
    if turns and not run.epochs.empty:
        end = (run.epochs["anomaly_deg"] - int(turns[1]) * _TURN_DEG).abs() < _SAME_FRAME_DEG
        return _laid_on(rows, run.epochs[end], "position_error_m")
    return _laid_on(rows, run.diagnostics[run.diagnostics["name"] == name], "value")


def prior_values(run: RunData, metric: Metric) -> pd.Series | None:
    """Return the same of the prior, known of every trial with one; None of a metric that the prior has not."""
    if metric.name not in _POSED or run.rows[f"prior_{POSE_COLUMNS[0]}"].isna().all():
        return None
    return pd.Series(_size(run.rows, "prior_", metric.name), index=run.rows.index)


def _tables(run: RunData) -> Mapping[str, pd.DataFrame]:
    """Return the tables with one line for each trial and estimator, by the numbers in them that trials go by."""
    found = {name: run.orbits for name in ORBIT_COLUMNS if name in run.orbits and run.orbits[name].notna().any()}
    matched = run.crater_matches
    if matched.empty:
        return found
    made, common = matched["n_correct"] + matched["n_wrong"], matched["n_common"]
    shares = {MISSED: matched["n_missed"] / common.where(common > 0), WRONG: matched["n_wrong"] / made.where(made > 0)}
    return found | dict.fromkeys(shares, matched.assign(**shares))


def _size(rows: pd.DataFrame, prefix: str, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    columns = [f"{prefix}{column}" for column in COMPONENTS.get(name, (name,))]
    return np.asarray(np.linalg.norm(rows[columns].to_numpy(dtype=np.float64), axis=1))


def _laid_on(rows: pd.DataFrame, table: pd.DataFrame, column: str) -> pd.Series:
    """Take a column of a detail table to the rows that it belongs to."""
    key = ["scenario", "estimator", "trial"]
    found = table.drop_duplicates(key).set_index(key)[column].astype(float)
    return pd.Series(found.reindex(pd.MultiIndex.from_frame(rows[key])).to_numpy(), index=rows.index)
