"""What a report tells of sequences: errors after whole revolutions, and along the frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from matplotlib.figure import Figure

from reports.figures.traces import draw_traces
from reports.measures import DEVIATION, SEQUENCE, Record, find
from reports.run_data import RunData
from reports.statistics import MEAN, MEDIAN, P95, RMS
from reports.tables import NO_VALUE, Grid, counts, number, value_of

_LABELS = {
    "error_after_1_m": "position error after 1 revolution",
    "error_after_2_m": "position error after 2 revolutions",
    "landmark_rmse_m": "landmark RMSE",
    "settled_landmark_rmse_m": "landmark RMSE without new ones",
    "mean_position_nees": "mean NEES of the position (3 expected)",
}
_NOTE = (
    "A landmark RMSE is over the landmarks that a frame sees, all frames of a sequence together; new ones are those"
    " that the frame is the first to see. The tails dominate means and deviations."
)


def sequence_grid(records: Sequence[Record]) -> Grid | None:
    """Tabulate what the trials of sequences come to; None if there are none."""
    lines = [r for r in records if r.stage == SEQUENCE and r.statistic == MEDIAN.name]
    heads = ("scenario", "estimator", "number", "median [95 %]", "mean +- deviation", "RMS", "95 %", "unit", "trials")
    rows = tuple(
        (
            line.scenario,
            line.estimator,
            _LABELS[line.measure],
            value_of(line, interval=True),
            _mean_and_deviation(records, line),
            *(value_of(_other(records, line, statistic.name)) for statistic in (RMS, P95)),
            line.unit,
            counts(line),
        )
        for line in lines
    )
    return Grid("Sequences", heads, rows, frozenset({0, 1, 2, 7}), _NOTE) if rows else None


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


def sequence_figures(run: RunData) -> Iterator[tuple[str, Figure, str, str]]:
    """Draw the errors along the frames of each scenario: scenario, figure, caption and description."""
    if run.epochs.empty:  # not a run of sequences
        return
    for scenario in dict.fromkeys(scenario for scenario, _ in run.pairs()):
        here = run.epochs[run.epochs["scenario"] == scenario]
        labels = [name for where, name in run.pairs() if where == scenario]
        by_label = {name: here[here["estimator"] == name] for name in labels}
        title = f"Errors along the orbit, {scenario}"
        trials = here["trial"].nunique()
        yield (
            scenario,
            draw_traces(by_label, title, run.manifest.credits),
            f"{title}: median over {trials} trials, and the band of 5 to 95 % of them; a trial that failed ends with"
            " its last good frame.",
            f"Position error and landmark error against the anomaly for {', '.join(labels)}.",
        )
