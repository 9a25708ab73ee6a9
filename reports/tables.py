"""Tables that several kinds of trial share: pose errors, diagnostics, times and failures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from boresight.reports.run.data import RunData
from boresight.reports.run.limits import short_line
from boresight.reports.run.outcomes import MEANING, unsolved
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, number, value_of
from boresight.reports.schema.labels import stage_label
from boresight.reports.schema.records import CONTROL, DIAGNOSTICS, FAILURES_AT_PRIOR, Record, find
from boresight.reports.schema.tables import measure_label, measures
from boresight.reports.statistics.measured import MEAN, MEDIAN, P95, RMS, ROOT_MEDIAN_SQUARE, Measured
from boresight.scenarios.known import correlated

_POSE_HEADS = ("position m", "RMS", "95th", "x", "y", "z", "attitude deg", "RMS", "95th")

_SMALL_P = 1e-3


def interval(measured: Measured, scale: float = 1.0) -> str:
    """Print a value with its 95 % interval, in units of 1 / ``scale``."""
    if measured.value is None:
        return NO_VALUE
    value = _bounded(scale * measured.value)
    if measured.low is None or measured.high is None:
        return value
    return f"{value} [{_bounded(scale * measured.low)}, {_bounded(scale * measured.high)}]"


def _bounded(value: float) -> str:
    return "∞" if math.isinf(value) else number(value)


def chance(p: float | None) -> str:
    """Print the p of a test."""
    return f"< {_SMALL_P:g}" if p is not None and p < _SMALL_P else number(p)


def pose_grids(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate pose errors after each stage, a grid for each scenario."""
    note = (
        "Median with its 95 % interval, RMS and 95th percentile of the error; x, y, z: root-median-square "
        "along the camera axes (x right, y down, z along the boresight), in m. "
        f"{MEANING} Failures at prior: every trial, one without an estimate with the error of its prior."
    )
    heads = ("estimator", "stage", "solved", "success", *_POSE_HEADS)
    own = [r for r in records if r.measure == "position_error_m" and r.statistic == MEDIAN.name and r.reference == ""]
    grids = []
    for scenario in dict.fromkeys(r.scenario for r in own):
        lines = _pose_lines([r for r in own if r.scenario == scenario])
        rows = tuple(
            (_who(line), stage_label(line.stage), counts(line), _success(records, line), *_pose_cells(records, line))
            for line in lines
        )
        known = short_line(run, scenario=scenario)
        grids.append(Grid(f"Pose error, {scenario}", heads, rows, frozenset({0, 1}), note, known))
    return grids


def _pose_lines(own: Sequence[Record]) -> list[Record]:
    """Choose the lines of one scenario: the common prior once; failures at the prior where there are any."""
    priors = [r for r in own if r.stage == CONTROL]
    later = [r for r in own if r.stage != CONTROL]
    failed = {r.estimator for r in later if r.n_ok < r.n}
    return priors[:1] + [r for r in later if r.stage != FAILURES_AT_PRIOR or r.estimator in failed]


def _success(records: Sequence[Record], line: Record) -> str:
    """Print the successes of all trials on the line of an estimator's final stage."""
    key = {"scenario": line.scenario, "estimator": line.estimator, "stage": line.stage}
    share = find(records, **key, measure="success_share", statistic=MEAN.name)
    return NO_VALUE if share is None or share.value is None else f"{round(share.value * share.n / 100.0)}/{share.n}"


def _who(line: Record) -> str:
    return "" if line.stage == CONTROL else line.estimator


def _pose_cells(records: Sequence[Record], line: Record) -> tuple[str, ...]:
    """Cells of `_POSE_HEADS`."""

    def get(measure: str, statistic: str) -> Record | None:
        return find(
            records,
            scenario=line.scenario,
            estimator=line.estimator,
            stage=line.stage,
            reference=line.reference,
            measure=measure,
            statistic=statistic,
        )

    def magnitude(name: str) -> list[str]:
        return [
            value_of(get(name, MEDIAN.name), interval=True),
            value_of(get(name, RMS.name)),
            value_of(get(name, P95.name)),
        ]

    axes = [value_of(get(f"position_error_{axis}_m", ROOT_MEDIAN_SQUARE.name)) for axis in "xyz"]
    return (*magnitude("position_error_m"), *axes, *magnitude("attitude_error_deg"))


def reference_grid(records: Sequence[Record], run: RunData) -> Grid | None:
    """Tabulate final pose errors against the truth and each further reference; None if there is only the truth."""
    medians = [r for r in records if r.measure == "position_error_m" and r.statistic == MEDIAN.name]
    ends = {(r.scenario, r.estimator, r.stage) for r in medians if r.reference}
    lines = [r for r in medians if (r.scenario, r.estimator, r.stage) in ends]
    heads = ("estimator", "against", "ok", *_POSE_HEADS)
    aligned = dict.fromkeys(name for known in (run.known or {}).values() for name in known.aligned)
    note = "No reference pose is exact truth: each error contains the error of the pose that it is measured against."
    note = " ".join([note, *(f"{correlated(name)}." for name in aligned)])
    rows = tuple(
        (line.estimator, line.reference or run.truth_name(line.scenario), counts(line), *_pose_cells(records, line))
        for line in lines
    )
    return Grid("Scored against each reference pose", heads, rows, frozenset({0, 1}), note) if rows else None


def detail_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the improvement of each trial, landmarks and data base; None if none of them was measured."""
    listed = {name for name, measure in measures().items() if measure.detail}
    chosen = [r for r in records if r.measure in listed and r.stage != DIAGNOSTICS]
    heads = ("scenario", "estimator", "quantity", "statistic", "value [95 %]", "unit", "ok")

    def cells(r: Record) -> tuple[str, ...]:
        quantity = measure_label(r.measure) + (f" against {r.reference}" if r.reference else "")
        return (r.scenario, r.estimator, quantity, r.statistic, value_of(r, interval=True), r.unit, counts(r))

    rows = tuple(cells(r) for r in chosen)
    note = "A reduction is the prior's error minus the final error of the same trial: positive where the pose improved."
    return Grid("Improvement, landmarks and data base", heads, rows, frozenset({0, 1, 2, 3, 5}), note) if rows else None


def diagnostic_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the numbers that estimators report in addition to the pose; None if there are none."""
    lines = [r for r in records if r.stage == DIAGNOSTICS and r.statistic == MEDIAN.name]
    heads = ("scenario", "estimator", "number", "median [95 %]", "mean", "RMS", "95th percentile", "unit", "trials")

    def other(line: Record, statistic: str) -> str:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": DIAGNOSTICS, "measure": line.measure}
        return value_of(find(records, **key, statistic=statistic))

    rows = tuple(
        (
            line.scenario,
            line.estimator,
            line.measure,
            value_of(line, interval=True),
            *(other(line, statistic.name) for statistic in (MEAN, RMS, P95)),
            line.unit,
            counts(line),
        )
        for line in lines
    )
    return Grid("Diagnostics", heads, rows, frozenset({0, 1, 2, 7})) if rows else None


def diagnostic_brief(records: Sequence[Record]) -> list[Grid]:
    """List the medians of what estimators report, for the terminal."""
    found = diagnostic_grid(records)
    if found is None:
        return []
    scenario = ("scenario",) if len({row[0] for row in found.rows}) > 1 else ()
    return [found.keep(*scenario, "estimator", "number", "median [95 %]", "trials")]


def timing_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate wall time by stage; None if no times were stored."""
    lines = [r for r in records if r.measure == "seconds" and r.statistic == MEDIAN.name]
    heads = ("scenario", "estimator", "stage", "median [95 %]", "mean", "95th percentile", "trials")

    def other(line: Record, statistic: str) -> str:
        key = {"scenario": line.scenario, "estimator": line.estimator, "stage": line.stage}
        return value_of(find(records, **key, measure="seconds", statistic=statistic))

    rows = tuple(
        (
            line.scenario,
            line.estimator or NO_VALUE,
            stage_label(line.stage, timed=True),
            value_of(line, interval=True),
            other(line, MEAN.name),
            other(line, P95.name),
            str(line.n_ok),
        )
        for line in lines
    )
    return Grid("Time per stage of a trial", heads, rows, frozenset({0, 1, 2})) if rows else None


def failure_grid(run: RunData) -> Grid | None:
    """Tabulate failures by reason; None if every trial is ok."""
    failed, merged = unsolved(run)
    note = "n stands for numbers that differ from trial to trial." if merged else ""
    keys = ["scenario", "estimator", "status", "reason"]
    tally = failed.value_counts(keys, sort=False).sort_index().sort_values(ascending=False, kind="stable")
    table = tally.reset_index().astype(str)
    rows = tuple(table.itertuples(index=False, name=None))
    heads = ("scenario", "estimator", "status", "reason", "trials")
    return Grid("Failures by reason", heads, rows, frozenset({0, 1, 2, 3}), note) if rows else None
