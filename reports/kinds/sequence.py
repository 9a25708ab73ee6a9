"""Report of sequences: errors after whole revolutions and along the frames, means against each other, and vision.

For means against each other trials are resampled whole, both errors of a trial together, so that what two estimators
have in common cancels; where sequences see images, whole sets of images are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.subjects import compared
from boresight.reports.compare.tables import subject_tables
from boresight.reports.figures.followed import revolution_figure, revolution_series, trace_figure
from boresight.reports.figures.named import NamedFigure
from boresight.reports.figures.sequences import POSITION
from boresight.reports.kinds import Content, ReportKind, Tables
from boresight.reports.kinds.design_data import REVOLUTION_ERRORS
from boresight.reports.kinds.designs import design_figures, design_grids
from boresight.reports.published import Comparison
from boresight.reports.run.clusters import clusters_of, groups, pooled_scenarios, pools
from boresight.reports.run.data import RunData
from boresight.reports.schema.grid import (
    ESTIMATOR,
    NO_VALUE,
    SCENARIO,
    UNIT,
    Grid,
    GridColumn,
    counts,
    number,
    of_ended,
    record_column,
    record_grid,
    scenario_grids,
    text_column,
)
from boresight.reports.schema.kinds import SEQUENCE_COLUMNS
from boresight.reports.schema.records import RATIO, REDUCTION, SEQUENCE, Key, Record, as_title
from boresight.reports.schema.tables import measure_label, measure_of
from boresight.reports.statistics.consistency import consistency_grid
from boresight.reports.statistics.intervals import interval_of_sums
from boresight.reports.statistics.measured import DEVIATION, MEAN, MEDIAN, P95, RMS, Measured, Sample, measure_deviation
from boresight.reports.statistics.paired import BETTER, SIGN_TEST, sign_test
from boresight.reports.tables import diagnostic_grid, timing_grid
from boresight.reports.verdicts import comparison_grid
from boresight.scenarios.arrays import FloatArray

ERROR_RATIOS = {"error_after_1_ratio": "error_after_1_m", "error_after_2_ratio": "error_after_2_m"}
"""The error that each ratio of errors is of."""
_CYCLE_RATIO = {"cycle_seconds_ratio": "seconds"}
_ON = ["scenario", "trial"]
VISION = "vision"
"""Stage of what the vision layer did to the images, whatever estimator used its tracks."""
_VISION = {
    "n_features": "features_per_image",
    "repeatability": "repeatability_share",
    "n_matches": "matches_per_image",
    "right_share": "right_share",
    "n_kept": "kept_per_image",
    "kept_right_share": "kept_right_share",
    "lost_right": "lost_right_share",
    "survival": "track_survival_share",
    "n_tracks": "tracks_per_image",
    "n_wrong": "wrong_per_image",
    "error_px": "track_error_px",
    "sigma_px": "track_sigma_px",
}
_VISION_NOTE = (
    "Mean over the frames of a trial, then over trials. The starts on one set of images are not independent of each"
    " other: intervals are over sets, and one set by itself has none."
)
_SIGN_NOTE = (
    "A set of images counts once, by the sign of the median difference of the errors from its starts; p of the exact"
    " two-sided sign test."
)
_RATIO_NOTE = (
    "Mean error of the line's estimator over that of the column's, over the trials of which both have one, with its"
    " 95 % interval; both follow the same tracks. Below 1 the line's estimator is the better."
)
_BRIEF = {"error_after_1_m": "1 revolution m", "error_after_2_m": "2 revolutions m", "landmark_rmse_m": "landmarks m"}
_NOTE = (
    "A landmark RMSE is over the landmarks that a frame sees, all frames of a sequence together; new ones are those"
    " that the frame is the first to see. As seen last: each landmark once, as estimated when it was seen for the last"
    " time, if it was seen twice or more. The tails dominate means and deviations."
)


@dataclass(frozen=True, slots=True, eq=False)
class _PairedErrors:
    """Two errors (k, 2) of the same trials, where both are known, of the ``n`` trials that both have."""

    errors: FloatArray
    clusters: NDArray[np.generic]
    n: int

    @classmethod
    def of(cls, run: RunData, one: pd.DataFrame, other: pd.DataFrame, error: str, on: list[str]) -> _PairedErrors:
        """Join the rows of two estimators or scenarios, which have one for each trial."""
        # Not by pandas' merge, which takes 10 ms for a few rows: a run has hundreds of pairs.
        theirs = dict(zip(zip(*(other[name] for name in on), strict=True), other[error], strict=True))
        keys = list(zip(*(one[name] for name in on), strict=True))
        both = one.take([row for row, key in enumerate(keys) if key in theirs])
        errors = np.column_stack([both[error], [theirs[key] for key in keys if key in theirs]]).astype(np.float64)
        known = np.isfinite(errors).all(axis=1)
        return cls(errors[known], clusters_of(run, both.take(np.flatnonzero(known))), len(both))

    def measured(self, of_means: Callable[[FloatArray], FloatArray]) -> Measured:
        """Evaluate ``of_means`` of the two mean errors (..., 2)."""
        if len(self.errors) < 2:
            return Measured(None)
        numbers = np.column_stack([self.errors, np.ones(len(self.errors))])
        interval = interval_of_sums(numbers, self.clusters, lambda sums: of_means(sums[:, :2] / sums[:, 2:]))
        return Measured(float(of_means(self.errors.mean(axis=0))), *interval)


def _each_pair(
    run: RunData, table: pd.DataFrame, errors: Mapping[str, str]
) -> Iterator[tuple[Sample, str, _PairedErrors]]:
    """Yield the errors of every two estimators in each group of scenarios, by the names of their ratios.

    Scenarios that are pooled have none by themselves: the starts on one set of images say nothing of another.
    """
    pooled = pooled_scenarios(run)
    for name, members in groups(run):
        own = table[table["scenario"].isin(members if name not in pooled else ())]
        rows = {str(label): part[[*_ON, *errors.values()]] for label, part in own.groupby("estimator")}
        for one, other in permutations(rows, 2):
            for ratio, error in errors.items():
                both = _PairedErrors.of(run, rows[one], rows[other], error, _ON)
                yield Sample(name, one, RATIO, both.n, other), ratio, both


def ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean error of every estimator of sequences over that of every other one, on the same trials.

    Sign tests accompany it: each independent unit counts once, by the sign of its median difference.
    """
    for sample, name, both in _each_pair(run, run.rows, ERROR_RATIOS) if len(run.table("epochs")) else ():
        if len(both.errors):
            yield sample.record(name, MEAN.name, both.measured(_ratio), len(both.errors))
            share, chance, decided = sign_test(both.errors[:, 0] - both.errors[:, 1], both.clusters)
            yield sample.record(name, BETTER, share, decided)
            yield sample.record(name, SIGN_TEST, chance, decided)


def cycle_ratio_records(run: RunData) -> Iterator[Record]:
    """Set the mean cycle time of every estimator of sequences over that of every other one, trial by trial.

    The median over the trials: those in which a worker compiles a method take a hundred times as long.
    """
    cycles = run.table("timings")[run.table("timings")["stage"] == "cycle"]
    for sample, name, both in _each_pair(run, cycles, _CYCLE_RATIO) if len(run.table("epochs")) else ():
        if (both.errors > 0.0).all():  # a method tells its times itself, and may not measure them
            yield from sample.records(name, _ratio(both.errors), both.clusters, (MEDIAN,))


def reduction_records(run: RunData, comparison: Comparison) -> Iterator[Record]:
    """Work out the reductions that a paper prints: ``100 (1 - mean(e) / mean(e'))``.

    What is set against what: another scenario, or another estimator on the same one. The trials of two scenarios are
    not the same tracks: resampling them together is one way of pairing what is independent.
    """
    pairs = run.pairs()
    scenarios = {scenario for scenario, _ in pairs}
    for published in comparison.values:  # noqa: PD011  a tuple of published values, not a table
        for scenario, estimator in pairs if published.stage == REDUCTION else ():
            if estimator == published.estimator and published.scenario in ("", scenario):
                against = published.against
                other = (against, estimator) if against in scenarios else (scenario, against)
                if other in pairs:
                    mine, theirs = (run.of(*pair) for pair in ((scenario, estimator), other))
                    error = f"{published.measure.removesuffix('_reduction')}_m"
                    both = _PairedErrors.of(run, mine, theirs, error, ["trial"])
                    sample = Sample(scenario, estimator, REDUCTION, both.n, against)
                    yield sample.record(published.measure, MEAN.name, both.measured(_reduction), len(both.errors))


def _ratio(means: FloatArray) -> FloatArray:
    return np.asarray(means[..., 0] / means[..., 1], dtype=np.float64)


def _reduction(means: FloatArray) -> FloatArray:
    return np.asarray(100.0 * (1.0 - _ratio(means)), dtype=np.float64)


def _mean_and_deviation(key: Key, known: Mapping[Key, Record]) -> str:
    mean, deviation = (known.get(key._replace(statistic=name)) for name in (MEAN.name, DEVIATION))
    if mean is None or mean.value is None:
        return NO_VALUE
    spread = "" if deviation is None or deviation.value is None else f" +- {number(deviation.value)}"
    return of_ended(f"{number(mean.value)}{spread}", known[key].n_ok, known[key].n)


_COLUMNS = (
    SCENARIO,
    ESTIMATOR,
    text_column("number", lambda key: measure_label(key.measure)),
    record_column("median [95 %]", interval=True, ended=True),
    GridColumn("mean +- deviation", _mean_and_deviation),
    record_column("RMS", statistic=RMS.name, ended=True),
    record_column("95 %", statistic=P95.name, ended=True),
    UNIT,
    record_column("trials", printed=counts),
)
_SIGN_COLUMNS = (
    text_column("quantity", lambda key: measure_label(key.measure.replace("_ratio", "_m"))),
    ESTIMATOR,
    text_column("against", lambda key: key.reference),
    record_column(
        "sets in which better",
        printed=lambda test: f"{round((test.value or 0.0) * test.n_ok)}/{test.n_ok}" if test else NO_VALUE,
    ),
    record_column("p", statistic=SIGN_TEST),
)


def sequence_measures(run: RunData) -> Iterator[Record]:
    """Measure the errors of whole sequences, under the stage ``sequence``; an estimator that never ends has 0 of n."""
    for group, members in groups(run) if len(run.table("epochs")) else ():
        together = run.rows[run.rows["scenario"].isin(members)]
        names = [name for name in SEQUENCE_COLUMNS if together[name].notna().any()] or SEQUENCE_COLUMNS[:1]
        for estimator, rows in together.groupby("estimator", sort=False):
            sample, clusters = Sample(group, str(estimator), SEQUENCE, len(rows)), clusters_of(run, rows)
            for name in names:
                known = rows[name].notna().to_numpy()
                yield from sample.records(name, rows[name], clusters, (MEDIAN, MEAN, RMS, P95))
                values = rows[name].to_numpy(dtype=np.float64)[known]
                yield sample.record(name, DEVIATION, measure_deviation(values, clusters[known]), len(values))


def vision_records(run: RunData) -> list[Record]:
    """Measure the vision layer of each scenario and estimator: means over the frames of each trial.

    Right matches of a frame that were not kept are all of them where nothing was kept.
    """
    records: list[Record] = []
    frames = run.table("vision")
    right = frames["n_matches"] * frames["right_share"]
    kept = (frames["n_kept"] * frames["kept_right_share"]).where(frames["n_kept"] > 0, 0.0)
    frames = frames.assign(lost_right=1.0 - kept / right.where(right > 0.0))
    for group, members in groups(run):
        for estimator, own in frames[frames["scenario"].isin(members)].groupby("estimator", sort=False):
            trials = own.groupby(["scenario", "trial"], as_index=False)[[*_VISION]].mean()
            sample, clusters = Sample(group, str(estimator), VISION, len(trials)), clusters_of(run, trials)
            for column, name in _VISION.items():
                scale = 100.0 if name.endswith("_share") else 1.0
                records += sample.records(name, scale * trials[column], clusters, (MEAN, MEDIAN))
    return records


def without_pooled(run: RunData, records: Sequence[Record]) -> list[Record]:
    """Leave out the scenarios that are pooled."""
    pooled = pooled_scenarios(run)
    return [record for record in records if record.scenario not in pooled]


def ratio_grids(records: Sequence[Record]) -> Iterator[Grid | None]:
    """Tabulate the mean error of each estimator over that of each other one, a grid for each scenario and error."""
    ratios = [r for r in records if r.stage == RATIO and r.measure in ERROR_RATIOS and r.statistic == MEAN.name]
    for scenario, name in dict.fromkeys((r.scenario, r.measure) for r in ratios):
        own = [r for r in ratios if (r.scenario, r.measure) == (scenario, name)]
        labels = list(dict.fromkeys(label for r in own for label in (r.estimator, r.reference)))
        lines = [Key(scenario, label, RATIO, measure=name, statistic=MEAN.name) for label in labels]
        columns = (
            text_column("mean error of / over", lambda key: key.estimator),
            *(record_column(label, reference=label, interval=True, ended=True) for label in labels),
        )
        yield record_grid(f"{as_title(measure_label(name))}, {scenario}", columns, own, lines, _RATIO_NOTE)


def sign_grids(records: Sequence[Record], run: RunData) -> Iterator[Grid]:
    """Tabulate in how many sets of images each estimator is better than each other one, a grid for each pool."""
    pooled = pools(run)
    tests = [r for r in records if r.stage == RATIO and r.statistic == BETTER and r.scenario in pooled and r.n_ok]
    return scenario_grids("Sign tests", _SIGN_COLUMNS, records, tests, _SIGN_NOTE)


def sequence_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the results of sequences; None if there are none."""
    lines = [r for r in records if r.stage == SEQUENCE and r.statistic == MEDIAN.name]
    return record_grid("Sequences", _COLUMNS, records, lines, _NOTE)


def sequence_brief(records: Sequence[Record]) -> Iterator[Grid | None]:
    """Tabulate the medians of each scenario for the terminal, a line for each estimator."""
    found = [r for r in records if r.stage == SEQUENCE and r.statistic == MEDIAN.name and r.measure in _BRIEF]
    for scenario in dict.fromkeys(r.scenario for r in found):
        own = [r for r in found if r.scenario == scenario]
        first: dict[str, Record] = {}
        for record in own:
            first.setdefault(record.estimator, record)
        shown = [name for name in _BRIEF if any(r.measure == name for r in own)]
        columns = (
            ESTIMATOR,
            record_column("trials", printed=counts),
            *(record_column(_BRIEF[name], name, interval=True, ended=True) for name in shown),
        )
        yield record_grid(f"Median errors, {scenario}", columns, own, first.values())


def vision_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the vision layer; estimators that saw the same tracks share a line, None without images."""
    shared: dict[tuple[object, ...], list[Record]] = {}
    for line in records:
        if line.stage == VISION and line.statistic == MEAN.name:
            shared.setdefault((line.scenario, line.measure, line.value, line.low, line.high), []).append(line)
    whose = {alike[0].key: ", ".join(line.estimator for line in alike) for alike in shared.values()}
    columns = (
        SCENARIO,
        text_column("tracks of", lambda key: whose[key]),
        text_column("quantity", lambda key: measure_of(key.measure).axis),
        record_column("mean [95 %]", interval=True),
        record_column("trials", printed=counts),
    )
    return record_grid("Vision layer", columns, records, [alike[0] for alike in shared.values()], _VISION_NOTE)


def sequence_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw the errors along the frames of each scenario, and where scenarios or estimators are a series, over it."""
    for scenario in dict.fromkeys(run.table("epochs")["scenario"]):
        labels = [name for where, name in run.pairs() if where == scenario]
        yield trace_figure(run, scenario, labels)
    series = revolution_series(run)
    if series:
        yield revolution_figure(run, series)


def records(run: RunData, comparison: Comparison | None) -> Iterable[Record]:
    """Measure whole sequences, vision, and errors and times of estimators against each other."""
    reductions = reduction_records(run, comparison) if comparison else ()
    return (
        *sequence_measures(run), *vision_records(run), *reductions, *ratio_records(run), *cycle_ratio_records(run),
    )  # fmt: skip


def tables(content: Content) -> Tables:
    """List the tables of a run of sequences; where one thing at a time is varied, those of the grid alone."""
    run = content.run
    if run.manifest.grid is not None and run.manifest.grid.design == "one-at-a-time":
        return design_grids(run)
    shown = without_pooled(run, content.records)
    return (
        comparison_grid(content.compared),
        *ratio_grids(shown),
        *sign_grids(shown, run),
        sequence_grid(shown),
        consistency_grid(shown),
        vision_grid(shown),
        *design_grids(run),
        diagnostic_grid(shown),
        timing_grid(shown),
    )


def brief(content: Content) -> Tables:
    """List what the terminal shows: of a grid of scenarios its axes, and before them what is pooled."""
    if content.run.manifest.grid is None:
        return [*_errors_at_the_end(content.run), *sequence_brief(content.records)]
    own = pools(content.run)
    pooled = sequence_grid([record for record in content.records if record.scenario in own])
    return [pooled, *design_grids(content.run, brief=True)]


def _errors_at_the_end(run: RunData) -> list[Grid]:
    """Tabulate the position errors at the last frame of sequences of less than a revolution."""
    if run.rows[list(REVOLUTION_ERRORS)].notna().any(axis=None) or run.rows[POSITION].isna().all():
        return []
    whole, _ = subject_tables(compared((run,), measure_of(POSITION)))
    names = ("estimator", "scenario", "trials", "solved")
    shown = [head for head in whole.columns if head in names or head.startswith("median")]
    return [replace(whole.keep(*shown), note="")]


def figures(content: Content) -> Iterable[NamedFigure]:
    """Draw errors along the frames, or, where one thing varies at a time, over the axes."""
    grid = content.run.manifest.grid
    if grid is not None and grid.design == "one-at-a-time":
        return design_figures(content.run)
    return sequence_figures(content.run)


REPORT = ReportKind(records=records, tables=tables, brief=brief, figures=figures)
