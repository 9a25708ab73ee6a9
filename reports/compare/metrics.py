"""Metrics by which runs are compared: a number of each trial, and the prior's number that a failure counts with."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.data import TRIAL_KEY, RunData, in_order_of
from boresight.reports.run.outcomes import revolution_ends
from boresight.reports.schema.common import COMPONENTS, POSE_COLUMNS, POSE_METRICS
from boresight.reports.schema.kinds.craters import CENTRE_ERROR, COMMON_CENTRE_ERROR, MISSED, WRONG
from boresight.reports.schema.kinds.orbit_determination import ORBIT_COLUMNS
from boresight.reports.schema.kinds.sequence import SEQUENCE_COLUMNS
from boresight.reports.schema.tables import is_error, kind_schema, measure_label, unit_of
from boresight.scenarios.errors import BoresightError

_AFTER = re.compile(r"error_after_([1-9]\d*)_m")


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of each trial, by its name: one of `trial_numbers`."""

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
        return measure_label(self.name)

    @property
    def axis(self) -> str:
        """In words, with the unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    @property
    def is_error(self) -> bool:
        """Whether smaller is better; False for numbers that methods report, such as a count of landmarks."""
        return is_error(self.name) or _AFTER.fullmatch(self.name) is not None


def trial_numbers(run: RunData) -> dict[str, pd.Series]:
    """Return all numbers by which trials of a run can be compared, each in the order of its rows; NaN for none.

    They are the errors of poses, what rows hold of whole sequences, ``error_after_K_m`` (of sequences, after K
    revolutions), the errors of orbits, shares and errors of craters, and the numbers that estimators report. Signed
    errors count by their size; errors of poses, orbits and craters are of trials with an estimate.
    """
    rows, epochs, orbits, reported = run.rows, run.table("epochs"), run.table("orbits"), run.table("diagnostics")
    ok, found = rows["status"] == "ok", dict[str, pd.Series]()
    for name in POSE_METRICS:
        size = _size(rows, "", name)
        if size.notna().any():
            found[name] = size.where(ok)
    found |= {name: rows[name].astype(float) for name in SEQUENCE_COLUMNS if rows[name].notna().any()}
    for k, ends in revolution_ends(epochs):
        found.setdefault(f"error_after_{k}_m", _of_rows(rows, ends, "position_error_m"))
    measured = {name: _of_rows(rows, orbits, name) for name in ORBIT_COLUMNS if name in orbits}
    counts = crater_counts(run)
    if counts is not None:
        measured |= {name: counts[name] for name in kind_schema(run.manifest.experiment).metrics}
    for name, values in measured.items():
        if values.notna().any():
            found.setdefault(name, values.where(ok).abs())
    once = reported.drop_duplicates([*TRIAL_KEY, "name"])
    numbers = once.pivot(index=TRIAL_KEY, columns="name", values="value")  # noqa: PD010  pivot_table drops NaN
    numbers = numbers.reindex(pd.MultiIndex.from_frame(rows[TRIAL_KEY])).set_axis(rows.index)
    for name in sorted(map(str, numbers)):
        found.setdefault(name, numbers[name].astype(float))
    return found


def metric_values(run: RunData, metric: Metric) -> pd.Series:
    """Return the metric of every row of a run, in the order of its rows; NaN where a trial has none."""
    return trial_numbers(run).get(metric.name, pd.Series(np.nan, index=run.rows.index))


def prior_values(run: RunData, metric: Metric) -> pd.Series | None:
    """Return the same of the prior, known of every trial with one; None of a metric that the prior has not."""
    if metric.name not in POSE_METRICS or run.rows[f"prior_{POSE_COLUMNS[0]}"].isna().all():
        return None
    return _size(run.rows, "prior_", metric.name)


def nothing_to_find(run: RunData, metric: Metric) -> pd.Series:
    """Return which rows of a run cannot have the metric: no crater could be found, or none was found by all methods."""
    counts = crater_counts(run)
    if counts is None or metric.name not in counts:
        return pd.Series(False, index=run.rows.index)
    there = counts["common" if metric.name == COMMON_CENTRE_ERROR else "there"]
    return (there == 0.0) & (run.rows["status"] != "error") & metric_values(run, metric).isna()


def choose_metric(name: str | None, runs: Sequence[RunData]) -> Metric:
    """Take the named metric; without a name the usual one of the kind of trial, or else the first that a run has.

    Of sequences it is the position error after the last whole revolution.

    Raises
    ------
    BoresightError
        If a run has no such number; the message lists what it has.
    """
    for run in runs:
        known = list(trial_numbers(run))
        if not known:
            raise BoresightError(f"{run.folder}: its trials have no number to go by; see boresight report {run.folder}")
        after = [int(found[1]) for found in map(_AFTER.fullmatch, known) if found]
        usual = kind_schema(run.manifest.experiment).metrics[0]
        if name is None and after and not run.table("epochs").empty:
            name = f"error_after_{max(after)}_m"
        elif name is None:
            name = usual if usual in known else known[0]
        if name not in known:
            raise BoresightError(f"--metric {name}: {run.folder} has no such number: choose one of {', '.join(known)}")
    return Metric(name or POSE_COLUMNS[0])


def missed_or_wrong(run: RunData) -> pd.Series | None:
    """Count missed and wrong craters of each row of a run, in order; None of a run without detections or matches."""
    counts = crater_counts(run)
    return None if counts is None else counts["missed"] + counts["wrong"]


def crater_counts(run: RunData) -> pd.DataFrame | None:
    """Count craters in images for each row of a run, in order; None of a kind of trial without missed craters.

    Returns
    -------
    counts
        ``there`` (craters that could be found, or matched), ``missed`` of them, ``right`` and ``wrong`` (detections
        that reach the detector's own threshold, or matches). The metrics of the kind: shares (%), NaN where they have a
        zero denominator, and, of detections, the median errors of the centres of those that are right, and of the
        craters that all methods found, which are ``common``.
    """
    rows, metrics = run.rows, kind_schema(run.manifest.experiment).metrics
    if MISSED not in metrics or run.table("crater_matches" if WRONG in metrics else "crater_images").empty:
        return None
    if WRONG in metrics:
        columns = {"there": "n_common", "missed": "n_missed", "right": "n_correct", "wrong": "n_wrong"}
        matched = run.table("crater_matches")
        counts = pd.DataFrame({name: _of_rows(rows, matched, column) for name, column in columns.items()})
        centres: dict[str, NDArray[np.float64]] = {}
    else:
        image = ["scenario", "trial"]
        kept = run.table("detections")[run.table("detections")["kept"].astype(bool)]
        hits = kept[kept["detectable"].astype(bool)]
        finders = hits.groupby([*image, "crater"])["estimator"].transform("nunique")
        methods = hits["scenario"].map(rows.groupby("scenario")["estimator"].nunique())
        common = hits[finders == methods]
        lines = {"right": hits, "wrong": kept[kept["crater"] < 0], "common": common}
        counted = {name: in_order_of(rows, table.groupby(TRIAL_KEY).size()) for name, table in lines.items()}
        there = rows[image].merge(run.table("crater_images"), "left", image)["n_detectable"].to_numpy(dtype=np.float64)
        counts = pd.DataFrame(counted, index=rows.index).fillna(0.0).assign(there=there)
        counts["missed"] = counts["there"] - counts["right"]
        centres = {
            name: in_order_of(rows, table.groupby(TRIAL_KEY)[CENTRE_ERROR].median())
            for name, table in ((CENTRE_ERROR, hits), (COMMON_CENTRE_ERROR, common))
        }
    shares = {MISSED: ("missed", counts["there"]), metrics[1]: ("wrong", counts["right"] + counts["wrong"])}
    percent = {name: 100.0 * counts[part] / whole.where(whole > 0) for name, (part, whole) in shares.items()}
    return counts.assign(**percent, **centres)


def _size(rows: pd.DataFrame, prefix: str, name: str) -> pd.Series:
    """Return the length of an error of poses, from the columns that are its components."""
    columns = [f"{prefix}{column}" for column in COMPONENTS.get(name, (name,))]
    return pd.Series(np.linalg.norm(rows[columns].to_numpy(dtype=np.float64), axis=1), index=rows.index)


def _of_rows(rows: pd.DataFrame, table: pd.DataFrame, column: str) -> pd.Series:
    """Return a column of a detail table in the order of the rows that it belongs to."""
    found = table.drop_duplicates(TRIAL_KEY).set_index(TRIAL_KEY)[column]
    return pd.Series(in_order_of(rows, found), index=rows.index)
