"""Tables that several kinds of trial share: pose errors, diagnostics, times and failures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from boresight.reports.run.data import RunData
from boresight.reports.run.limits import short_line
from boresight.reports.run.outcomes import MEANING, tally, unsolved
from boresight.reports.schema.grid import (
    ESTIMATOR,
    NO_VALUE,
    SCENARIO,
    UNIT,
    Grid,
    GridColumn,
    counts,
    number,
    record_column,
    record_grid,
    text_column,
)
from boresight.reports.schema.records import CONTROL, DIAGNOSTICS, FAILURES_AT_PRIOR, Record, stage_label
from boresight.reports.schema.tables import measure_label, measures
from boresight.reports.statistics.measured import MEAN, MEDIAN, P95, RMS, ROOT_MEDIAN_SQUARE, Measured
from boresight.scenarios.known import correlated

_MOST_FAILURES = 40  # lines of a page


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


def _magnitude(head: str, name: str) -> tuple[GridColumn, ...]:
    return (
        record_column(head, name, MEDIAN.name, interval=True),
        record_column("RMS", name, RMS.name),
        record_column("95th", name, P95.name),
    )


def _count_of_share(share: Record | None) -> str:
    """Print a share of trials as their number of all."""
    return NO_VALUE if share is None or share.value is None else f"{round(share.value * share.n / 100.0)}/{share.n}"


_POSE_COLUMNS = (
    *_magnitude("position m", "position_error_m"),
    *(record_column(axis, f"position_error_{axis}_m", ROOT_MEDIAN_SQUARE.name) for axis in "xyz"),
    *_magnitude("attitude deg", "attitude_error_deg"),
)
_STAGE_COLUMNS = (
    text_column("estimator", lambda key: "" if key.stage == CONTROL else key.estimator),
    text_column("stage", lambda key: stage_label(key.stage)),
    record_column("solved", printed=counts),
    record_column("success", "success_share", MEAN.name, printed=_count_of_share),
    *_POSE_COLUMNS,
)
_POSE_NOTE = (
    "Median with its 95 % interval, RMS and 95th percentile of the error; x, y, z: root-median-square "
    "along the camera axes (x right, y down, z along the boresight), in m. "
    f"{MEANING} Failures at prior: every trial, one without an estimate with the error of its prior."
)
_DETAIL_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    text_column(
        "quantity", lambda key: measure_label(key.measure) + (f" against {key.reference}" if key.reference else "")
    ),
    text_column("statistic", lambda key: key.statistic),
    record_column("value [95 %]", interval=True),
    UNIT,
    record_column("ok", printed=counts),
)
_DIAGNOSTIC_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    text_column("number", lambda key: key.measure),
    record_column("median [95 %]", interval=True),
    record_column("mean", statistic=MEAN.name),
    record_column("RMS", statistic=RMS.name),
    record_column("95th percentile", statistic=P95.name),
    UNIT,
    record_column("trials", printed=counts),
)
_TIMING_COLUMNS = (
    SCENARIO,
    text_column("estimator", lambda key: key.estimator or NO_VALUE),
    text_column("stage", lambda key: stage_label(key.stage, timed=True)),
    record_column("median [95 %]", interval=True),
    record_column("mean", statistic=MEAN.name),
    record_column("95th percentile", statistic=P95.name),
    record_column("trials", printed=lambda line: str(line.n_ok) if line else NO_VALUE),
)


def _pose_medians(records: Sequence[Record]) -> list[Record]:
    return [r for r in records if r.measure == "position_error_m" and r.statistic == MEDIAN.name]


def pose_grids(records: Sequence[Record], run: RunData) -> list[Grid]:
    """Tabulate pose errors after each stage, a grid for each scenario.

    The common prior has one line, failures at the prior one where there are any.
    """
    own = [r for r in _pose_medians(records) if r.reference == ""]
    grids = []
    for scenario in dict.fromkeys(r.scenario for r in own):
        here = [r for r in own if r.scenario == scenario]
        priors, later = ([r for r in here if (r.stage == CONTROL) is prior] for prior in (True, False))
        failed = {r.estimator for r in later if r.n_ok < r.n}
        lines = [*priors[:1], *(r for r in later if r.stage != FAILURES_AT_PRIOR or r.estimator in failed)]
        known = short_line(run, scenario=scenario)
        grids.append(record_grid(f"Pose error, {scenario}", _STAGE_COLUMNS, records, lines, _POSE_NOTE, known))
    return [grid for grid in grids if grid is not None]


def reference_grid(records: Sequence[Record], run: RunData) -> Grid | None:
    """Tabulate final pose errors against the truth and each further reference; None if there is only the truth."""
    medians = _pose_medians(records)
    ends = {(r.scenario, r.estimator, r.stage) for r in medians if r.reference}
    lines = [r for r in medians if (r.scenario, r.estimator, r.stage) in ends]
    aligned = dict.fromkeys(name for known in (run.known or {}).values() for name in known.aligned)
    note = "No reference pose is exact truth: each error contains the error of the pose that it is measured against."
    note = " ".join([note, *(f"{correlated(name)}." for name in aligned)])
    against = text_column("against", lambda key: key.reference or run.truth_name(key.scenario))
    columns = (ESTIMATOR, against, record_column("ok", printed=counts), *_POSE_COLUMNS)
    return record_grid("Scored against each reference pose", columns, records, lines, note)


def detail_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the improvement of each trial, landmarks and data base; None if none of them was measured."""
    listed = {name for name, measure in measures().items() if measure.detail}
    lines = [r for r in records if r.measure in listed and r.stage != DIAGNOSTICS]
    note = "A reduction is the prior's error minus the final error of the same trial: positive where the pose improved."
    return record_grid("Improvement, landmarks and data base", _DETAIL_COLUMNS, records, lines, note)


def diagnostic_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the numbers that estimators report in addition to the pose; None if there are none."""
    lines = [r for r in records if r.stage == DIAGNOSTICS and r.statistic == MEDIAN.name]
    return record_grid("Diagnostics", _DIAGNOSTIC_COLUMNS, records, lines)


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
    return record_grid("Time per stage of a trial", _TIMING_COLUMNS, records, lines)


def failure_grid(run: RunData) -> Grid | None:
    """Tabulate failures by reason; many are counted over all scenarios. None if every trial is ok."""
    failed, merged = unsolved(run)
    notes = ["n stands for numbers that differ from trial to trial."] if merged else []
    keys = ["scenario", "estimator", "status", "reason"]
    rows = tally(failed, keys)
    if len(rows) <= _MOST_FAILURES or failed["scenario"].nunique() == 1:
        columns = (*keys, "trials")
    else:
        notes.append("The failures of each scenario are in failures.csv, in the folder of this report.")
        keys = keys[1:]
        columns = (*keys, "scenarios", "trials")
        scenarios = failed.groupby(keys)["scenario"].nunique()
        rows = [(*key, str(scenarios[tuple(key)]), trials) for *key, trials in tally(failed, keys)]
    left = frozenset(range(len(keys)))
    return Grid("Failures by reason", columns, tuple(rows), left, " ".join(notes)) if rows else None
