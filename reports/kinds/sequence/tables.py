"""Tables of sequences: errors after whole revolutions, and along the frames."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from boresight.reports.figures.axes import band_label
from boresight.reports.figures.sequences import (
    AFTER_REVOLUTIONS,
    LANDMARKS,
    POSITION,
    draw_revolutions,
    draw_starts,
    draw_traces,
)
from boresight.reports.kinds.designs.tables import design_grids
from boresight.reports.kinds.sequence.contrasts import ERROR_RATIOS
from boresight.reports.kinds.sequence.vision import vision_grid
from boresight.reports.run.clusters import clusters_of, pooled_scenarios, pools
from boresight.reports.run.data import RunData, select
from boresight.reports.schema.grid import NO_VALUE, Grid, counts, number, of_ended, value_of, value_of_ended
from boresight.reports.schema.labels import as_title, count_of
from boresight.reports.schema.named_figure import NamedFigure, file_stem
from boresight.reports.schema.records import RATIO, SEQUENCE, Record, find
from boresight.reports.schema.tables import measure_label
from boresight.reports.statistics.consistency import consistency_grid
from boresight.reports.statistics.measured import DEVIATION, MEAN, MEDIAN, P95, RMS
from boresight.reports.statistics.paired import BETTER, SIGN_TEST
from boresight.reports.tables import diagnostic_grid, timing_grid
from boresight.reports.verdicts import ComparedValue, comparison_grid

_NUMBERED = re.compile(r"(?P<stem>.+)-(?P<number>\d+)")

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


def sequence_grids(records: Sequence[Record], compared: Sequence[ComparedValue], run: RunData) -> list[Grid]:
    """List the tables of a run of sequences; where one thing at a time is varied, those of the grid alone."""
    design = run.manifest.grid
    if design is not None and design.design == "one-at-a-time":
        return design_grids(run)
    shown = without_pooled(run, records)
    found = (
        comparison_grid(compared),
        *ratio_grids(shown),
        *sign_grids(shown, run),
        sequence_grid(shown),
        consistency_grid(shown),
        vision_grid(shown),
        *design_grids(run),
        diagnostic_grid(shown),
        timing_grid(shown),
    )
    return [grid for grid in found if grid is not None]


def without_pooled(run: RunData, records: Sequence[Record]) -> list[Record]:
    """Leave out the scenarios that are pooled."""
    pooled = pooled_scenarios(run)
    return [record for record in records if record.scenario not in pooled]


def ratio_grids(records: Sequence[Record]) -> Iterator[Grid]:
    """Tabulate the mean error of each estimator over that of each other one, a grid for each scenario and error."""
    ratios = [r for r in records if r.stage == RATIO and r.measure in ERROR_RATIOS and r.statistic == MEAN.name]
    for scenario, name in dict.fromkeys((r.scenario, r.measure) for r in ratios):
        own = [r for r in ratios if (r.scenario, r.measure) == (scenario, name)]
        labels = list(dict.fromkeys(label for r in own for label in (r.estimator, r.reference)))
        rows = tuple(
            (one, *(value_of_ended(find(own, estimator=one, reference=other), interval=True) for other in labels))
            for one in labels
        )
        title = f"{as_title(measure_label(name))}, {scenario}"
        yield Grid(title, ("mean error of / over", *labels), rows, frozenset({0}), _RATIO_NOTE)


def sign_grids(records: Sequence[Record], run: RunData) -> Iterator[Grid]:
    """Tabulate in how many sets of images each estimator is better than each other one, a grid for each pool."""
    pooled = {pool.name for pool in pools(run)}
    tests = [r for r in records if r.stage == RATIO and r.statistic == BETTER and r.scenario in pooled and r.n_ok]
    for scenario in dict.fromkeys(r.scenario for r in tests):
        rows = []
        for test in (r for r in tests if r.scenario == scenario):
            key = {"scenario": scenario, "estimator": test.estimator, "reference": test.reference}
            chance = find(records, **key, stage=RATIO, measure=test.measure, statistic=SIGN_TEST)
            better = f"{round((test.value or 0.0) * test.n_ok)}/{test.n_ok}"
            quantity = measure_label(test.measure.replace("_ratio", "_m"))
            rows.append((quantity, test.estimator, test.reference, better, value_of(chance)))
        heads = ("quantity", "estimator", "against", "sets in which better", "p")
        yield Grid(f"Sign tests, {scenario}", heads, tuple(rows), frozenset({0, 1, 2}), _SIGN_NOTE)


def sequence_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate the results of sequences; None if there are none."""
    lines = [r for r in records if r.stage == SEQUENCE and r.statistic == MEDIAN.name]
    heads = ("scenario", "estimator", "number", "median [95 %]", "mean +- deviation", "RMS", "95 %", "unit", "trials")
    rows = tuple(
        (
            line.scenario,
            line.estimator,
            measure_label(line.measure),
            value_of_ended(line, interval=True),
            of_ended(_mean_and_deviation(records, line), line.n_ok, line.n),
            *(value_of_ended(_other(records, line, statistic.name)) for statistic in (RMS, P95)),
            line.unit,
            counts(line),
        )
        for line in lines
    )
    return Grid("Sequences", heads, rows, frozenset({0, 1, 2, 7}), _NOTE) if rows else None


def sequence_brief(records: Sequence[Record]) -> Iterator[Grid]:
    """Tabulate the medians of each scenario for the terminal, a line for each estimator."""
    found = [r for r in records if r.stage == SEQUENCE and r.statistic == MEDIAN.name and r.measure in _BRIEF]
    for scenario in dict.fromkeys(r.scenario for r in found):
        own = [r for r in found if r.scenario == scenario]
        shown = {name: head for name, head in _BRIEF.items() if any(r.measure == name for r in own)}
        rows = tuple(
            (
                label,
                counts(next(r for r in own if r.estimator == label)),
                *(value_of_ended(find(own, estimator=label, measure=name), interval=True) for name in shown),
            )
            for label in dict.fromkeys(r.estimator for r in own)
        )
        yield Grid(f"Median errors, {scenario}", ("estimator", "trials", *shown.values()), rows, frozenset({0}))


def _other(records: Sequence[Record], line: Record, statistic: str) -> Record | None:
    key = {"scenario": line.scenario, "estimator": line.estimator, "stage": SEQUENCE, "measure": line.measure}
    return find(records, **key, statistic=statistic)


def _mean_and_deviation(records: Sequence[Record], line: Record) -> str:
    mean, deviation = (_other(records, line, statistic) for statistic in (MEAN.name, DEVIATION))
    if mean is None or mean.value is None:
        return NO_VALUE
    if deviation is None or deviation.value is None:
        return number(mean.value)
    return f"{number(mean.value)} +- {number(deviation.value)}"


def sequence_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw the errors along the frames of each scenario, and where scenarios or estimators are a series, over it."""
    for scenario in dict.fromkeys(
        run.table("epochs")["scenario"]
    ):  # where no frame was estimated there is nothing to draw
        labels = [name for where, name in run.pairs() if where == scenario]
        yield NamedFigure(file_stem(f"traces_{scenario}"), *trace_figure(run, scenario, labels))
    series = revolution_series(run)
    if series:
        yield NamedFigure("revolutions", *revolution_figure(run, series))


def trace_figure(
    run: RunData, scenario: str, labels: Sequence[str], panels: Sequence[str] = (POSITION, LANDMARKS)
) -> tuple[Figure, str, str]:
    """Draw the errors of some estimators along the frames: the figure, its caption and its description."""
    here = run.table("epochs")[run.table("epochs")["scenario"] == scenario]
    title = f"Errors along the orbit, {scenario}"
    trials = here["trial"].nunique()
    return (
        draw_traces({name: here[here["estimator"] == name] for name in labels}, title, run.manifest.credits, panels),
        f"{title}: median over {count_of(trials, 'trial')}, and {band_label(trials)}; a thin line: the"
        " first trial; a trial that failed ends with its last good frame.",
        f"Position error and landmark error against the anomaly for {', '.join(labels)}.",
    )


def start_figure(run: RunData, scenario: str, estimator: str) -> tuple[Figure, str, str]:
    """Draw the errors of every trial along the frames: the figure, its caption and its description."""
    epochs = select(run.table("epochs"), scenario, estimator)
    title = f"Position error from {count_of(epochs['trial'].nunique(), 'start')}, {estimator}"
    return (
        draw_starts(epochs, title),
        f"{title}, {scenario}: a line for each trial; a line that ends early is a trial that failed there.",
        f"Position error against the anomaly for {estimator}, one line for each start.",
    )


def revolution_series(run: RunData) -> dict[str, dict[str, tuple[str, str]]]:
    """Group what forms a series: label of a line to level to (scenario, estimator); nothing where nothing does.

    Nor is there any where no trial came round once: a series is of errors after whole revolutions.

    An axis of a grid is a series for every estimator; estimators of one scenario whose labels differ in a number at
    the end alone, such as ba-slam-3 and ba-slam-5, are one.
    """
    if run.rows.reindex(columns=list(AFTER_REVOLUTIONS)).isna().all(axis=None):
        return {}
    design = run.manifest.grid
    if design is not None:
        levels = {one.name: "-".join(one.levels.values()) for one in design.scenarios}
        return _lines(
            (name, levels[scenario], (scenario, name)) for scenario, name in run.pairs() if scenario in levels
        )
    matched = ((_NUMBERED.fullmatch(name), (scenario, name)) for scenario, name in run.pairs())
    return _lines((m["stem"], m["number"], pair) for m, pair in matched if m)


def _lines(found: Iterable[tuple[str, str, tuple[str, str]]]) -> dict[str, dict[str, tuple[str, str]]]:
    lines: dict[str, dict[str, tuple[str, str]]] = {}
    for line, level, pair in found:
        lines.setdefault(line, {})[level] = pair
    return {line: levels for line, levels in lines.items() if len(levels) > 1}


def _clustered(run: RunData, rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(cluster=clusters_of(run, rows))


def revolution_figure(
    run: RunData, series: Mapping[str, Mapping[str, tuple[str, str]]], abscissa: str = ""
) -> tuple[Figure, str, str]:
    """Draw mean and deviation of the errors after each revolution over a series (figures 4.1 and 4.2)."""
    errors = {
        line: {level: _clustered(run, select(run.rows, *pair)) for level, pair in levels.items()}
        for line, levels in series.items()
    }
    axes = run.manifest.grid.axes if run.manifest.grid is not None else ()
    abscissa = abscissa or ", ".join(axis.label for axis in axes) or "views"
    title = f"Position error after whole revolutions by {abscissa}"
    return (
        draw_revolutions(errors, abscissa, title),
        f"{title}: mean over the trials; thick bar: its 95 % interval; thin bar: one standard deviation of the trials;"
        " tick: median.",
        f"Mean position error after each revolution against {abscissa} for {', '.join(series)}.",
    )
