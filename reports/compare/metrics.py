"""Metrics by which runs are compared: a number of each trial, and the prior's number that a failure counts with."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.data import TRIAL_KEY, RunData, in_order_of
from boresight.reports.schema.common import COMPONENTS, POSE_COLUMNS, POSE_METRICS
from boresight.reports.schema.kinds.crater_detection import CENTRE_ERROR, COMMON_CENTRE_ERROR, FALSE_ALARMS, MISSED
from boresight.reports.schema.kinds.crater_matching import MATCHING, WRONG
from boresight.reports.schema.kinds.orbit_determination import ORBIT_COLUMNS
from boresight.reports.schema.kinds.sequence import SEQUENCE_COLUMNS
from boresight.reports.schema.tables import is_error, kind_schema, measure_label, unit_of
from boresight.scenarios.errors import BoresightError

_AFTER = re.compile(r"error_after_([1-9]\d*)_m")
_TURN_DEG = 360.0
_SAME_FRAME_DEG = 1e-6

N_FINDABLE = "n_there"
"""Column: number of craters that could be found or matched."""


def crater_numbers(run: RunData) -> Mapping[str, pd.DataFrame]:
    """Return the numbers of a run that is about craters in images, by their names; none of another run.

    Each is a column of a table with `N_FINDABLE` and a row for each trial and method (`TRIAL_KEY`). A share with a zero
    denominator is NaN: that of false alarms where no detection is false or of a detectable crater, that of missed
    craters where there are none.
    """
    if not run.table("crater_matches").empty:
        matched = run.table("crater_matches")
        made, common = matched["n_correct"] + matched["n_wrong"], matched["n_common"]
        shares = {MISSED: _percent(matched["n_missed"], common), WRONG: _percent(matched["n_wrong"], made)}
        return dict.fromkeys(MATCHING, matched.assign(**shares, **{N_FINDABLE: common}))
    if not run.table("crater_images").empty:
        counts = detection_counts(run)
        missed, false = counts[N_FINDABLE] - counts["n_hits"], counts["n_false"]
        shares = {MISSED: _percent(missed, counts[N_FINDABLE]), FALSE_ALARMS: _percent(false, false + counts["n_hits"])}
        numbers = dict.fromkeys((MISSED, FALSE_ALARMS, CENTRE_ERROR), counts.assign(**shares))
        return numbers | {COMMON_CENTRE_ERROR: _common_centres(run)}
    return {}


def detection_counts(run: RunData) -> pd.DataFrame:
    """Count the detections of each image that reach the detector's own threshold.

    Returns
    -------
    counts
        A row for each row of the run: `TRIAL_KEY`, `N_FINDABLE` (detectable craters), ``n_kept`` (detections),
        ``n_hits`` (detectable craters found), ``n_false`` (detections that are no crater) and `CENTRE_ERROR` of the
        hits.
    """
    found = run.table("detections")[run.table("detections")["kept"].astype(bool)]
    hits = found[found["detectable"].astype(bool)]
    rows = run.rows[TRIAL_KEY].merge(
        run.table("crater_images")[["scenario", "trial", "n_detectable"]], on=["scenario", "trial"]
    )
    tables = {"n_kept": found, "n_hits": hits, "n_false": found[found["crater"] < 0]}
    counted = {name: _count(rows, table) for name, table in tables.items()}
    centre = in_order_of(rows, hits.groupby(TRIAL_KEY)[CENTRE_ERROR].median())
    return rows.rename(columns={"n_detectable": N_FINDABLE}).assign(**counted, **{CENTRE_ERROR: centre})


def _common_centres(run: RunData) -> pd.DataFrame:
    """Return `TRIAL_KEY`, `N_FINDABLE` (detectable craters found by all methods) and their `COMMON_CENTRE_ERROR`."""
    found = run.table("detections")
    hits = found[found["kept"].astype(bool) & found["detectable"].astype(bool)]
    methods = run.rows.groupby("scenario")["estimator"].nunique()
    finders = hits.groupby(["scenario", "trial", "crater"])["estimator"].transform("nunique")
    common = hits[finders == hits["scenario"].map(methods)]
    centre = in_order_of(run.rows, common.groupby(TRIAL_KEY)[CENTRE_ERROR].median())
    return run.rows[TRIAL_KEY].assign(**{N_FINDABLE: _count(run.rows, common), COMMON_CENTRE_ERROR: centre})


def _count(rows: pd.DataFrame, table: pd.DataFrame) -> NDArray[np.float64]:
    """Count the lines of a table that belong to each row."""
    return np.nan_to_num(in_order_of(rows, table.groupby(TRIAL_KEY).size()), nan=0.0)


def _percent(part: pd.Series, whole: pd.Series) -> pd.Series:
    return 100.0 * part / whole.where(whole > 0)


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of each trial: an error, or a diagnostic of the method.

    Parameters
    ----------
    name
        A column of the rows, `LATERAL`, `BORESIGHT`, ``error_after_K_m`` (sequences, after K revolutions), one of
        `ORBIT_COLUMNS`, one of what `reports.compare.metrics` has, or a number that estimators report.
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
        return measure_label(self.name)

    @property
    def axis(self) -> str:
        """In words, with the unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    @property
    def is_error(self) -> bool:
        """Whether smaller is better; False for numbers that methods report, such as a count of landmarks."""
        return is_error(self.name) or _AFTER.fullmatch(self.name) is not None


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
    posed = [name for name in POSE_METRICS if all(column in rows for column in COMPONENTS.get(name, (name,)))]
    names = [name for name in posed if rows[COMPONENTS.get(name, (name,))[0]].notna().any()]
    names += [name for name in SEQUENCE_COLUMNS if name in rows and rows[name].notna().any()]
    if not run.table("epochs").empty:
        turns = int((float(run.table("epochs")["anomaly_deg"].max()) + _SAME_FRAME_DEG) // _TURN_DEG)
        names += [f"error_after_{k}_m" for k in range(1, turns + 1)]
    names += list(_tables(run))
    reported = run.table("diagnostics")["name"].astype(str).unique()
    return list(dict.fromkeys([*names, *sorted(reported)]))


def _default(known: Sequence[str], run: RunData) -> str:
    after = [int(found[1]) for found in map(_AFTER.fullmatch, known) if found]
    if run.table("epochs").empty or not after:
        usual = kind_schema(run.manifest.experiment).metrics[0]
        return usual if usual in known else known[0]
    return f"error_after_{max(after)}_m"


def metric_values(run: RunData, metric: Metric) -> pd.Series:
    """Return the metric of every row of a run, in the order of its rows; NaN where a trial has none.

    Signed errors count by their size.
    """
    rows, name = run.rows, metric.name
    if name in POSE_METRICS:
        ok = (rows["status"] == "ok").to_numpy()
        return pd.Series(np.where(ok, _size(rows, "", name), np.nan), index=rows.index)
    if name in rows and rows[name].notna().any():
        return rows[name].astype(float)
    tables = _tables(run)
    if name in tables:
        return _laid_on(rows, tables[name], name).where(rows["status"] == "ok").abs()
    turns = _AFTER.fullmatch(name)
    if turns and not run.table("epochs").empty:
        end = (run.table("epochs")["anomaly_deg"] - int(turns[1]) * _TURN_DEG).abs() < _SAME_FRAME_DEG
        return _laid_on(rows, run.table("epochs")[end], "position_error_m")
    return _laid_on(rows, run.table("diagnostics")[run.table("diagnostics")["name"] == name], "value")


def prior_values(run: RunData, metric: Metric) -> pd.Series | None:
    """Return the same of the prior, known of every trial with one; None of a metric that the prior has not."""
    if metric.name not in POSE_METRICS or run.rows[f"prior_{POSE_COLUMNS[0]}"].isna().all():
        return None
    return pd.Series(_size(run.rows, "prior_", metric.name), index=run.rows.index)


def nothing_to_find(run: RunData, metric: Metric) -> pd.Series:
    """Return which rows of a run cannot have the metric: no crater could be found, or none was found by all methods."""
    table = crater_numbers(run).get(metric.name)
    if table is None:
        return pd.Series(False, index=run.rows.index)
    nothing = _laid_on(run.rows, table, N_FINDABLE) == 0.0
    return nothing & (run.rows["status"] != "error") & metric_values(run, metric).isna()


def _tables(run: RunData) -> Mapping[str, pd.DataFrame]:
    """Return the tables with one line for each trial and estimator, by the numbers in them that trials go by."""
    orbits = {
        name: run.table("orbits")
        for name in ORBIT_COLUMNS
        if name in run.table("orbits") and run.table("orbits")[name].notna().any()
    }
    return orbits | {name: table for name, table in crater_numbers(run).items() if table[name].notna().any()}


def _size(rows: pd.DataFrame, prefix: str, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    columns = [f"{prefix}{column}" for column in COMPONENTS.get(name, (name,))]
    return np.asarray(np.linalg.norm(rows[columns].to_numpy(dtype=np.float64), axis=1))


def _laid_on(rows: pd.DataFrame, table: pd.DataFrame, column: str) -> pd.Series:
    """Take a column of a detail table to the rows that it belongs to."""
    found = table.drop_duplicates(TRIAL_KEY).set_index(TRIAL_KEY)[column]
    return pd.Series(in_order_of(rows, found), index=rows.index)
