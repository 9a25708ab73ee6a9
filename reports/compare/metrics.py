"""What runs are compared by: an error of each trial, and the error that a failure is counted with."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from reports.compare.craters import DETECTION, MATCHING, THERE, crater_numbers
from reports.run.data import POSE_COLUMNS, TRIAL_KEY, RunData, in_order_of
from reports.schema.labels import measure_label
from reports.schema.records import unit_of
from reports.statistics.measures import SEQUENCE_COLUMNS
from scenarios.errors import BoresightError

LATERAL, BORESIGHT = "lateral_error_m", "boresight_error_m"
COMPONENTS: Mapping[str, tuple[str, ...]] = {
    LATERAL: ("position_error_x_m", "position_error_y_m"),
    BORESIGHT: ("position_error_z_m",),
}
"""Errors across and along the camera's boresight, by the columns whose root sum of squares they are."""

_OF_ARC = ("arc_rms_m", "arc_median_m", "arc_p90_m", "predicted_error_m", "residual_rms_px")
ORBIT_COLUMNS = (*_OF_ARC, "wrong_left_share", "right_edited_share")
"""Of orbit determination: columns of the table ``orbits``; the position error is that at the epoch."""
_POSED = (*POSE_COLUMNS, *COMPONENTS)
_ERRORS = frozenset({*_POSED, *SEQUENCE_COLUMNS, *ORBIT_COLUMNS, *DETECTION, *MATCHING})
_USUAL = (POSE_COLUMNS[0], "landmarks", "detections_an_image")
"""What runs are compared by unless something is named: of poses, of data bases of landmarks, of surveys."""
_AFTER = re.compile(r"error_after_([1-9]\d*)_m")
_LABELS = {
    LATERAL: "position error across the boresight",
    BORESIGHT: "position error along the boresight",
}
_BEFORE: Mapping[str, tuple[str, ...]] = {
    "sequence": ("position_error_m", *SEQUENCE_COLUMNS),
    "crater-detection": DETECTION,
    "crater-matching": MATCHING,
    "orbit-determination": ("position_error_m", *_OF_ARC),
    "crater-navigation": ("position_error_m", *_OF_ARC),
    "landmark-database": ("landmarks", "facets", "candidates", "kept_clusters"),
    "image-survey": ("detections_an_image", "few_craters_share", "similar_image_share", "hits_a_crater"),
}
_TURN_DEG = 360.0
_SAME_FRAME_DEG = 1e-6


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of each trial: an error, or what a method reports beside its result.

    Parameters
    ----------
    name
        A column of the rows, `LATERAL`, `BORESIGHT`, ``error_after_K_m`` (sequences, after K revolutions), one of
        `ORBIT_COLUMNS`, one of what `reports.compare.craters` has, or a number that estimators report.
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

    @property
    def is_error(self) -> bool:
        """Whether smaller is better; of what methods report, as a count of landmarks, nobody can say."""
        return self.name in _ERRORS or _AFTER.fullmatch(self.name) is not None


def choose_metric(name: str | None, runs: Sequence[RunData]) -> Metric:
    """Take the named metric; without a name the position error, of sequences after the last whole revolution.

    Of data bases it is the number of landmarks, of surveys that of detections in an image, and of other runs without a
    position error, as those of crater matching, the first number that they have.

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
    return _BEFORE.get(experiment, _POSED)


def _default(known: Sequence[str], run: RunData) -> str:
    after = [int(found[1]) for found in map(_AFTER.fullmatch, known) if found]
    if run.epochs.empty or not after:
        return next((name for name in _USUAL if name in known), known[0])
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


def nothing_to_find(run: RunData, metric: Metric) -> pd.Series:
    """Tell of which rows of a run the metric says nothing: no crater was to be found, or none was found by all."""
    table = crater_numbers(run).get(metric.name)
    if table is None:
        return pd.Series(False, index=run.rows.index)
    nothing = _laid_on(run.rows, table, THERE) == 0.0
    return nothing & (run.rows["status"] != "error") & metric_values(run, metric).isna()


def _tables(run: RunData) -> Mapping[str, pd.DataFrame]:
    """Return the tables with one line for each trial and estimator, by the numbers in them that trials go by."""
    orbits = {name: run.orbits for name in ORBIT_COLUMNS if name in run.orbits and run.orbits[name].notna().any()}
    return orbits | {name: table for name, table in crater_numbers(run).items() if table[name].notna().any()}


def _size(rows: pd.DataFrame, prefix: str, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    columns = [f"{prefix}{column}" for column in COMPONENTS.get(name, (name,))]
    return np.asarray(np.linalg.norm(rows[columns].to_numpy(dtype=np.float64), axis=1))


def _laid_on(rows: pd.DataFrame, table: pd.DataFrame, column: str) -> pd.Series:
    """Take a column of a detail table to the rows that it belongs to."""
    found = table.drop_duplicates(TRIAL_KEY).set_index(TRIAL_KEY)[column]
    return pd.Series(in_order_of(rows, found), index=rows.index)
