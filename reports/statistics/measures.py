"""The tidy table of a report: every measured number, its interval, and the trials behind it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.run.clusters import clusters_of, groups, rows_by_group
from boresight.reports.run.data import RunData, select
from boresight.reports.run.outcomes import errors_by_stage, final_stage, succeeded
from boresight.reports.schema.common import POSE_COLUMNS
from boresight.reports.schema.kinds.sequence import SEQUENCE_COLUMNS
from boresight.reports.schema.records import CONTROL, DIAGNOSTICS, FAILURES_AT_PRIOR, SEQUENCE, Record
from boresight.reports.schema.tables import unit_of
from boresight.reports.statistics.measured import (
    DEVIATION,
    MEAN,
    MEDIAN,
    P75,
    P95,
    RMS,
    ROOT_MEDIAN_SQUARE,
    Measured,
    Statistic,
    measure,
    measure_deviation,
    share_of,
)

MIN_LANDMARKS = 4
"""Landmarks that fix a pose."""
_REDUCTIONS = {"position_reduction_m": POSE_COLUMNS[0], "attitude_reduction_deg": POSE_COLUMNS[1]}
_MAGNITUDE = (MEDIAN, RMS, P75, P95)
_COMPONENT = (ROOT_MEDIAN_SQUARE, RMS)
_POSE_STATISTICS = dict(zip(POSE_COLUMNS, (_MAGNITUDE, _MAGNITUDE, _COMPONENT, _COMPONENT, _COMPONENT), strict=True))


@dataclass(frozen=True, slots=True)
class _RecordKey:
    """The fields that a group of records has in common, and their total count n."""

    scenario: str
    estimator: str
    stage: str
    n: int
    reference: str = ""

    def record(self, name: str, statistic: str, measured: Measured, n_ok: int) -> Record:
        return Record(
            self.scenario,
            self.estimator,
            self.stage,
            self.reference,
            name,
            unit_of(name),
            statistic,
            measured.value,
            measured.low,
            measured.high,
            n_ok,
            self.n,
        )

    def records(
        self, name: str, values: pd.Series, clusters: NDArray[np.generic], statistics: Sequence[Statistic]
    ) -> list[Record]:
        """Evaluate ``statistics`` over the finite ``values``."""
        numbers = values.to_numpy(dtype=np.float64)
        known = np.isfinite(numbers)
        measured = measure(numbers[known], clusters[known], statistics)
        n_ok = int(known.sum())
        return [self.record(name, s.name, m, n_ok) for s, m in zip(statistics, measured, strict=True)]

    def share(self, name: str, yes: NDArray[np.bool_], clusters: NDArray[np.generic]) -> Record:
        """Measure the share of the marked trials."""
        found = share_of(yes, clusters)
        percent = (None if number is None else 100.0 * number for number in (found.value, found.low, found.high))
        return self.record(name, MEAN.name, Measured(*percent), len(yes))

    def pose_records(self, errors: pd.DataFrame, clusters: NDArray[np.generic]) -> list[Record]:
        """Evaluate the statistics of the five pose errors."""
        return [
            record
            for name in POSE_COLUMNS
            for record in self.records(name, errors[name], clusters, _POSE_STATISTICS[name])
        ]


def measure_run(run: RunData) -> tuple[Record, ...]:
    """Measure everything that the run's tables allow, in the order of the report."""
    parts: tuple[Callable[[RunData], list[Record]], ...] = (
        pose_measures,
        reference_measures,
        improvement_measures,
        landmark_measures,
        database_measures,
        diagnostic_measures,
        timing_measures,
        sequence_measures,
    )
    return tuple(record for part in parts for record in part(run))


def pose_measures(run: RunData) -> list[Record]:
    """Measure pose errors after each stage, those with failures counted at the error of their prior, and success."""
    records = []
    for scenario, estimator in run.posed_pairs():
        rows = select(run.rows, scenario, estimator)
        stages = errors_by_stage(run, scenario, estimator)
        if estimator != CONTROL:
            ok = (rows["status"] == "ok").to_numpy()
            stages[FAILURES_AT_PRIOR] = rows.assign(
                **{name: np.where(ok, rows[name], rows[f"prior_{name}"]) for name in POSE_COLUMNS}
            )
        for stage, errors in stages.items():
            errors = errors.assign(scenario=scenario)
            records += _RecordKey(scenario, estimator, stage, len(rows)).pose_records(errors, clusters_of(run, errors))
        if estimator != CONTROL:
            key = _RecordKey(scenario, estimator, final_stage(run, scenario, estimator), len(rows))
            records.append(key.share("success_share", succeeded(rows), clusters_of(run, rows)))
    return records


def reference_measures(run: RunData) -> list[Record]:
    """Measure final pose errors against each further reference pose; those against the truth are measured elsewhere."""
    records = []
    for scenario, estimator in run.pairs():
        table = select(run.table("references"), scenario, estimator)
        n = len(select(run.rows, scenario, estimator))
        # An estimator's errors against the truth are measured from its stages; the control has no stages.
        known = set() if estimator == CONTROL else {run.truth_name(scenario)}
        further = set(table["reference"]) - known
        for reference in sorted(further):
            errors = table[table["reference"] == reference]
            key = _RecordKey(scenario, estimator, final_stage(run, scenario, estimator), n, str(reference))
            records += key.pose_records(errors, clusters_of(run, errors))
    return records


def improvement_measures(run: RunData) -> list[Record]:
    """Measure prior error minus final error, trial by trial, over the trials that are ok (positive is better).

    Against the truth, and for real images against each further reference pose as well.
    """
    records = []
    for scenario, estimator in run.posed_pairs():
        if estimator == CONTROL:
            continue
        rows = select(run.rows, scenario, estimator)
        ok = rows[rows["status"] == "ok"]
        prior = ok.assign(**{name: ok[f"prior_{name}"] for name in _REDUCTIONS.values()})
        key = _RecordKey(scenario, estimator, final_stage(run, scenario, estimator), len(rows))
        records += _reductions(run, key, prior, ok)
        mine, control = (select(run.table("references"), scenario, name) for name in (estimator, CONTROL))
        for reference in sorted(set(mine["reference"]) - {run.truth_name(scenario)}):
            final, before = (table[table["reference"] == reference] for table in (mine, control))
            records += _reductions(run, replace(key, reference=str(reference)), before, final)
    return records


def _reductions(run: RunData, key: _RecordKey, before: pd.DataFrame, after: pd.DataFrame) -> list[Record]:
    """Measure how much smaller the errors of ``after`` are than those of ``before`` in the same trials."""
    records, prior = [], before.set_index("trial")
    for name, error in _REDUCTIONS.items():
        reduction = prior[error].reindex(after["trial"]).to_numpy() - after[error]
        records += key.records(name, reduction, clusters_of(run, after), (MEDIAN, MEAN))
    return records


def landmark_measures(run: RunData) -> list[Record]:
    """Measure the number of landmarks an image, and the error of each recognised landmark."""
    records = []
    for scenario, estimator in run.pairs():
        if estimator == CONTROL:
            continue
        rows = select(run.rows, scenario, estimator)
        ok = rows[(rows["status"] == "ok") & rows["n_landmarks"].notna()]
        stage = final_stage(run, scenario, estimator)
        if (ok["n_landmarks"] > 0).any():
            key = _RecordKey(scenario, estimator, stage, len(rows))
            records += key.records("n_landmarks", ok["n_landmarks"], clusters_of(run, ok), (MEDIAN, MEAN))
            enough = (rows["n_landmarks"].fillna(0.0) >= MIN_LANDMARKS).to_numpy()
            records.append(key.share("four_landmarks_share", enough, clusters_of(run, rows)))
        marks = select(run.table("landmarks"), scenario, estimator)
        if len(marks):
            key, count = _RecordKey(scenario, estimator, stage, len(marks)), Measured(*3 * (len(marks),))
            records.append(key.record("landmark_observations", "count", count, len(marks)))
            clusters = clusters_of(run, marks)
            records += key.records("landmark_error_m", marks["error_m"], clusters, (MEDIAN, RMS, P95))
            records += key.records("chi_square", marks["chi_square"], clusters, (MEDIAN, MEAN))
    return records


def database_measures(run: RunData) -> list[Record]:
    """Count the landmarks and facets of each data base, and its bytes as it is stored; of several, of the first.

    A single data base belongs to the single estimator of a run (the control apart), even if the manifest names none.
    """
    records = []
    pairs = [pair for pair in run.pairs() if pair[1] != CONTROL]
    only = pairs[0] if len(pairs) == len(run.manifest.products) == 1 else ("", "")
    for product in (one for one in run.manifest.products if one.database == 0):
        scenario, estimator = (product.scenario, product.estimator) if product.scenario else only
        key = _RecordKey(scenario, estimator, "database", 1)
        counts = {"landmarks": product.n_landmarks, "facets": product.n_facets, "bytes": product.bytes}
        for name, count in ((f"database_{name}", count) for name, count in counts.items()):
            if count is not None:
                records.append(key.record(name, "count", Measured(count, count, count), 1))
    return records


def diagnostic_measures(run: RunData) -> list[Record]:
    """Measure each number that an estimator reports of its trials, under the stage ``diagnostics``."""
    records = []
    for group, members in groups(run):
        own = run.table("diagnostics")[run.table("diagnostics")["scenario"].isin(members)]
        for (estimator, name), table in own.groupby(["estimator", "name"], sort=False):
            n = int((run.rows["scenario"].isin(members) & (run.rows["estimator"] == estimator)).sum())
            key = _RecordKey(group, str(estimator), DIAGNOSTICS, n)
            records += key.records(str(name), table["value"], clusters_of(run, table), (MEDIAN, MEAN, RMS, P95))
    return records


def sequence_measures(run: RunData) -> list[Record]:
    """Measure the errors of whole sequences, under the stage ``sequence``."""
    records: list[Record] = []
    if run.table("epochs").empty:
        return records
    for group, estimator, rows in rows_by_group(run):
        key, clusters = _RecordKey(group, estimator, SEQUENCE, len(rows)), clusters_of(run, rows)
        for name in SEQUENCE_COLUMNS:
            known = rows[name].notna().to_numpy()
            if known.any():
                records += key.records(name, rows[name], clusters, (MEDIAN, MEAN, RMS, P95))
                values = rows[name].to_numpy(dtype=np.float64)[known]
                records.append(key.record(name, DEVIATION, measure_deviation(values, clusters[known]), len(values)))
    return records


def timing_measures(run: RunData) -> list[Record]:
    """Measure the wall time of each stage of a trial; n_ok counts the trials that have a time of it."""
    records = []
    for group, members in groups(run):
        own = run.table("timings")[run.table("timings")["scenario"].isin(members)]
        rows = run.rows.loc[run.rows["scenario"].isin(members), "estimator"].value_counts()
        for (estimator, stage), times in own.groupby(["estimator", "stage"], sort=False):
            total = times.groupby(["scenario", "trial"], sort=False)[["seconds"]].sum().reset_index()
            key = _RecordKey(group, str(estimator), str(stage), int(rows.get(estimator, len(total))))
            records += key.records("seconds", total["seconds"], clusters_of(run, total), (MEDIAN, MEAN, P95))
    return records
