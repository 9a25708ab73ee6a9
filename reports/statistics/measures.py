"""The tidy table of a report: every measured number, its interval, and the trials behind it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import pandas as pd

from boresight.reports.run.clusters import clusters_of, groups
from boresight.reports.run.data import RunData, select
from boresight.reports.run.outcomes import errors_by_stage, final_stage, succeeded
from boresight.reports.schema.column import POSE_COLUMNS
from boresight.reports.schema.records import CONTROL, DIAGNOSTICS, FAILURES_AT_PRIOR, Record
from boresight.reports.statistics.measured import (
    MEAN,
    MEDIAN,
    P75,
    P95,
    RMS,
    ROOT_MEDIAN_SQUARE,
    Measured,
    Sample,
    Statistic,
)

MIN_LANDMARKS = 4
"""Landmarks that fix a pose."""
_REDUCTIONS = {"position_reduction_m": POSE_COLUMNS[0], "attitude_reduction_deg": POSE_COLUMNS[1]}
_STATISTICS = {
    **dict.fromkeys(POSE_COLUMNS[:2], (MEDIAN, RMS, P75, P95)),
    **dict.fromkeys(POSE_COLUMNS[2:], (ROOT_MEDIAN_SQUARE, RMS)),
}


def measure_run(run: RunData) -> tuple[Record, ...]:
    """Measure what trials of all kinds may have, in the order of the report."""
    parts = (
        pose_measures, reference_measures, improvement_measures, landmark_measures, database_measures,
        diagnostic_measures, timing_measures,
    )  # fmt: skip
    return tuple(chain.from_iterable(part(run) for part in parts))


def table_records(
    run: RunData,
    table: pd.DataFrame,
    stage: str,
    statistics: Mapping[str, Sequence[Statistic]],
    pairs: Iterable[tuple[str, str]] | None = None,
) -> Iterator[Record]:
    """Measure columns of a table that has at most one row for each trial; n counts all trials.

    The table is of all scenarios and estimators, ``stage`` that of the records. ``statistics`` are by columns, in the
    order of the records. ``pairs`` are scenarios and estimators; without them all of the run.
    """
    for scenario, estimator in run.pairs() if pairs is None else pairs:
        own = select(table, scenario, estimator)
        sample = Sample(scenario, estimator, stage, len(select(run.rows, scenario, estimator)))
        clusters = clusters_of(run, own)
        for name, chosen in statistics.items():
            yield from sample.records(name, own[name], clusters, chosen)


def _pose_records(run: RunData, sample: Sample, errors: pd.DataFrame) -> Iterator[Record]:
    """Evaluate the statistics of the five pose errors of some trials."""
    clusters = clusters_of(run, errors)
    for name, statistics in _STATISTICS.items():
        yield from sample.records(name, errors[name], clusters, statistics)


def pose_measures(run: RunData) -> Iterator[Record]:
    """Measure pose errors after each stage, those with failures counted at the error of their prior, and success."""
    for scenario, estimator in run.posed_pairs():
        rows = select(run.rows, scenario, estimator)
        stages = errors_by_stage(run, scenario, estimator)
        if estimator != CONTROL:
            ok = (rows["status"] == "ok").to_numpy()
            stages[FAILURES_AT_PRIOR] = rows.assign(
                **{name: np.where(ok, rows[name], rows[f"prior_{name}"]) for name in POSE_COLUMNS}
            )
        for stage, errors in stages.items():
            sample = Sample(scenario, estimator, stage, len(rows))
            yield from _pose_records(run, sample, errors.assign(scenario=scenario))
        if estimator != CONTROL:
            sample = Sample(scenario, estimator, final_stage(run, scenario, estimator), len(rows))
            yield sample.share("success_share", succeeded(rows), clusters_of(run, rows))


def _final_samples(run: RunData, pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[Sample, pd.DataFrame]]:
    """Yield the rows of each scenario and estimator, and what records on their final stage are of."""
    for scenario, estimator in pairs:
        rows = select(run.rows, scenario, estimator)
        yield Sample(scenario, estimator, final_stage(run, scenario, estimator), len(rows)), rows


def reference_measures(run: RunData) -> Iterator[Record]:
    """Measure final pose errors against each further reference pose; those against the truth are measured elsewhere."""
    for sample, _ in _final_samples(run, run.pairs()):
        table = select(run.table("references"), sample.scenario, sample.estimator)
        # An estimator's errors against the truth are measured from its stages; the control has no stages.
        known = set() if sample.estimator == CONTROL else {run.truth_name(sample.scenario)}
        for reference in sorted(set(table["reference"]) - known):
            of_reference = replace(sample, reference=str(reference))
            yield from _pose_records(run, of_reference, table[table["reference"] == reference])


def improvement_measures(run: RunData) -> Iterator[Record]:
    """Measure prior error minus final error, trial by trial, over the trials that are ok (positive is better).

    Against the truth, and for real images against each further reference pose as well.
    """
    for sample, rows in _final_samples(run, (pair for pair in run.posed_pairs() if pair[1] != CONTROL)):
        ok = rows[rows["status"] == "ok"]
        prior = ok.assign(**{name: ok[f"prior_{name}"] for name in _REDUCTIONS.values()})
        yield from _reductions(run, sample, prior, ok)
        mine, control = (select(run.table("references"), sample.scenario, name) for name in (sample.estimator, CONTROL))
        for reference in sorted(set(mine["reference"]) - {run.truth_name(sample.scenario)}):
            final, before = (table[table["reference"] == reference] for table in (mine, control))
            yield from _reductions(run, replace(sample, reference=str(reference)), before, final)


def _reductions(run: RunData, sample: Sample, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Record]:
    """Measure how much smaller the errors of ``after`` are than those of ``before`` in the same trials."""
    prior = before.set_index("trial")
    for name, error in _REDUCTIONS.items():
        reduction = prior[error].reindex(after["trial"]).to_numpy() - after[error]
        yield from sample.records(name, reduction, clusters_of(run, after), (MEDIAN, MEAN))


def landmark_measures(run: RunData) -> Iterator[Record]:
    """Measure the number of landmarks an image, and the error of each recognised landmark."""
    for sample, rows in _final_samples(run, (pair for pair in run.pairs() if pair[1] != CONTROL)):
        ok = rows[(rows["status"] == "ok") & rows["n_landmarks"].notna()]
        if (ok["n_landmarks"] > 0).any():
            yield from sample.records("n_landmarks", ok["n_landmarks"], clusters_of(run, ok), (MEDIAN, MEAN))
            enough = (rows["n_landmarks"].fillna(0.0) >= MIN_LANDMARKS).to_numpy()
            yield sample.share("four_landmarks_share", enough, clusters_of(run, rows))
        marks = select(run.table("landmarks"), sample.scenario, sample.estimator)
        if len(marks):
            sample, clusters = replace(sample, n=len(marks)), clusters_of(run, marks)
            yield sample.record("landmark_observations", "count", Measured(*3 * (len(marks),)))
            yield from sample.records("landmark_error_m", marks["error_m"], clusters, (MEDIAN, RMS, P95))
            yield from sample.records("chi_square", marks["chi_square"], clusters, (MEDIAN, MEAN))


def database_measures(run: RunData) -> Iterator[Record]:
    """Count the landmarks and facets of each data base, and its bytes as it is stored; of several, of the first.

    A single data base belongs to the single estimator of a run (the control apart), even if the manifest names none.
    """
    pairs = [pair for pair in run.pairs() if pair[1] != CONTROL]
    only = pairs[0] if len(pairs) == len(run.manifest.products) == 1 else ("", "")
    for product in (one for one in run.manifest.products if one.database == 0):
        sample = Sample(*((product.scenario, product.estimator) if product.scenario else only), "database", 1)
        counts = {"landmarks": product.n_landmarks, "facets": product.n_facets, "bytes": product.bytes}
        for name, count in counts.items():
            if count is not None:
                yield sample.record(f"database_{name}", "count", Measured(count, count, count))


def diagnostic_measures(run: RunData) -> Iterator[Record]:
    """Measure each number that an estimator reports of its trials, under the stage ``diagnostics``."""
    for group, members in groups(run):
        own = run.table("diagnostics")[run.table("diagnostics")["scenario"].isin(members)]
        for (estimator, name), table in own.groupby(["estimator", "name"], sort=False):
            n = int((run.rows["scenario"].isin(members) & (run.rows["estimator"] == estimator)).sum())
            sample = Sample(group, str(estimator), DIAGNOSTICS, n)
            yield from sample.records(str(name), table["value"], clusters_of(run, table), (MEDIAN, MEAN, RMS, P95))


def timing_measures(run: RunData) -> Iterator[Record]:
    """Measure the wall time of each stage of a trial; n_ok counts the trials that have a time of it."""
    for group, members in groups(run):
        own = run.table("timings")[run.table("timings")["scenario"].isin(members)]
        rows = run.rows.loc[run.rows["scenario"].isin(members), "estimator"].value_counts()
        for (estimator, stage), times in own.groupby(["estimator", "stage"], sort=False):
            total = times.groupby(["scenario", "trial"], sort=False)[["seconds"]].sum().reset_index()
            sample = Sample(group, str(estimator), str(stage), int(rows.get(estimator, len(total))))
            yield from sample.records("seconds", total["seconds"], clusters_of(run, total), (MEDIAN, MEAN, P95))
