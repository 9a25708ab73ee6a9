"""The figures of a comparison: summary, coverage of covariances, cumulative errors, errors by conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from boresight.reports.compare.subjects import RunComparison, Subject
from boresight.reports.compare.tables import differing_level, subject_consistencies
from boresight.reports.compare.trials import CONDITIONS, ESTIMATOR, run_names
from boresight.reports.figures.comparison import draw_binned_errors, draw_coverage
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.pose import draw_cumulative_errors
from boresight.reports.figures.style import GREY, Points, finish, grid_figure, mark_decades, styled
from boresight.reports.run.data import TRIAL_KEY
from boresight.reports.schema.column import BORESIGHT, LATERAL, Measure
from boresight.reports.schema.craters import DETECTION, MATCHING
from boresight.reports.schema.records import CONTROL, as_title
from boresight.reports.schema.tables import measure_of
from boresight.reports.statistics.consistency import normalised_label
from boresight.reports.statistics.measured import MEDIAN, Measured, measure, percent, share_of
from boresight.scenarios.arrays import FloatArray

ATTITUDE = "attitude_error_deg"
SUCCESS = "success"
RADIAL, TRANSVERSE = "radial_error_m", "transverse_error_m"
_LABELS: Mapping[str, str] = {
    "n_landmarks": "landmarks used",
    "prior": "error of the prior",
    "distance_m": "distance to the body, m",
    LATERAL: "across boresight, m",
    BORESIGHT: "along boresight, m",
    ATTITUDE: "attitude, deg",
    SUCCESS: "success, %",
    RADIAL: "radial, m",
    TRANSVERSE: "transverse, m",
}
Tables = Mapping[str, pd.DataFrame]
"""Label of each subject to its rows: conditions, errors, ``failed`` and ``cluster``."""
Chosen = tuple[tuple[str, ...], tuple[str, ...]]
"""Columns of the errors that have values, and of the conditions that differ between rows."""
OWN_BINS = "n_landmarks"
_LINE_IN = 0.32
_MARKS = (("D", 4), ("|", 7), ("|", 10), ("|", 13))
"""Marker and size of the RMS, and of the 75th, 95th and 99th percentiles."""
_BIN_TRIALS = 20
_MOST_BINS = 8
_FRAMES = 60
_FEWEST = 5


def comparison_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw all figures for which there are data; captions give the number of solved trials of each subject."""
    counts = "; ".join(f"{found.label(one.names)} {one.n_ok}/{one.n}" for one in found.subjects)
    figures = [summary_figure(found), *consistency_figures(found)]
    for group, subjects in found.groups.items():
        figures += [cumulative_figure(found, group, subjects), *conditions_figure(found, group, subjects)]
    return (replace(figure, caption=f"{figure.caption} Solved trials: {counts}.") for figure in figures)


def consistency_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw, for each kind of normalised error, the coverage of the covariance that subjects claim."""
    claims = list(subject_consistencies(found))
    for kind in dict.fromkeys(errors.name for _, errors in claims):
        of_subject = {subject.names: errors for subject, errors in claims if errors.name == kind}
        for group, subjects in found.groups.items():
            own = {label: of_subject[one.names] for label, one in subjects.items() if one.names in of_subject}
            styles = {label: found.styles[subjects[label].names] for label in own}
            title = _title(found, normalised_label(kind), group)
            if own:
                yield NamedFigure(
                    file_stem("consistency", kind, *filter(None, [group])),
                    draw_coverage(own, styles, title, found.credits),
                    f"{title}: share of the trials whose normalised squared error lies within the quantile given on the"
                    " abscissa of the chi-square distribution. On the diagonal the covariance is true, below it too"
                    " small. Grey: 95 % band at each abscissa for true covariances and the smallest number of"
                    " independent trials among the curves.",
                    f"Coverage against claimed coverage for {', '.join(own)}.",
                )


def cumulative_figure(found: RunComparison, group: str, subjects: Mapping[str, Subject]) -> NamedFigure:
    """Draw the share of all trials with an error below the abscissa."""
    tables = {label: found.of(one) for label, one in subjects.items()}
    panels = {"value": found.metric.axis}
    if found.metric.name != ATTITUDE and any(table[ATTITUDE].notna().any() for table in tables.values()):
        panels[ATTITUDE] = "attitude error, deg"
    title = _title(found, "Cumulative error", group)
    return NamedFigure(
        file_stem("cumulative", *filter(None, [group])),
        draw_cumulative_errors(
            {label: (table, len(table)) for label, table in tables.items()}, title, found.credits, panels,
            {label: found.styles[one.names] for label, one in subjects.items()},
        ),
        f"{title}: share of all trials with an error below the abscissa; a curve ends at the share of trials with an"
        " error, so that failures lower it.",
        f"Cumulative shares of {', '.join(panels.values())} for {', '.join(tables)}.",
    )  # fmt: skip


def _frames(found: RunComparison, trials: pd.DataFrame) -> pd.DataFrame:
    """Gather the frames of trials; frames of the same ``cluster`` are not independent."""
    parts = []
    for run, name in zip(found.runs, run_names(found.runs), strict=True):
        if {"true_x_m", "radial_m"} <= set(run.table("epochs").columns):
            own = trials.loc[trials["run"] == name, [*TRIAL_KEY, "cluster"]]
            parts.append(run.table("epochs").merge(own, on=TRIAL_KEY))
    return prepare_frames(pd.concat(parts, ignore_index=True)) if parts else pd.DataFrame()


def conditions_figure(found: RunComparison, group: str, subjects: Mapping[str, Subject]) -> Iterator[NamedFigure]:
    """Draw errors of frames of sequences, else of trials, against conditions; nothing without errors or frames."""
    tables = {label: found.of(one) for label, one in subjects.items() if one.estimator != CONTROL and one.n_ok}
    frames = any(len(run.table("epochs")) for run in found.runs)
    metric = measure_of("position_error_m") if frames else found.metric
    if frames:
        tables = {label: _frames(found, table) for label, table in tables.items()}
    if not tables or not all(map(len, tables.values())):
        return
    errors, conditions = frames_by_condition(tables) if frames else trials_by_condition(tables, metric)
    if not conditions:
        return
    labels = {**_LABELS, "value": metric.axis, "prior": f"{_LABELS['prior']}, {metric.unit}"}
    panels = {
        (labels[error], labels.get(one, measure_of(one).axis)): dict(binned_errors(tables, error, one))
        for error in errors
        for one in conditions
    }
    over = "the solved trials"
    if frames:
        over = "evenly spaced frames of each trial (fewer than 120), with intervals over whole trials,"
    title = _title(found, "Errors by conditions", group)
    styles = {label: found.styles[subjects[label].names] for label in tables}
    yield NamedFigure(
        file_stem("conditions", *filter(None, [group])),
        draw_binned_errors(panels, styles, title, found.credits),
        f"{title}: medians over {over} in bins of equal numbers, with 95 % intervals. Success: share of all trials of a"
        " bin.",
        f"Binned errors of {', '.join(tables)} against {', '.join(dict.fromkeys(key[1] for key in panels))}.",
    )


def summary_figure(found: RunComparison) -> NamedFigure:
    """Draw errors, success and differences of all subjects."""
    order = {one.names: place for place, one in enumerate(found.subjects)}
    # The median difference of a subject to the first one that it is compared with; the levels in which those differ.
    differences, levels = dict[tuple[str, ...], Measured](), set[str]()
    for one in sorted(found.contrasts, key=lambda contrast: order[contrast.second]):
        if one.first not in differences:
            differences[one.first] = one.median
            levels.add(differing_level(one))
    title = ", ".join(filter(None, (as_title(found.metric.label), found.shared)))
    return NamedFigure(
        "compare",
        draw_summaries(found, differences, levels.pop() if len(levels) == 1 else "the first", title),
        f"{title}: median with its 95 % interval, RMS and percentiles over the solved trials, the median of all trials"
        " with failures counted, success rates, and the median of the paired differences to the first subject that"
        " differs in one factor only.",
        f"Errors, success rates and differences of {', '.join(found.label(one.names) for one in found.subjects)}.",
    )


@styled
def draw_summaries(
    found: RunComparison, differences: Mapping[tuple[str, ...], Measured], against: str, title: str
) -> Figure:
    """Draw errors, success rates and differences, a line for each subject, from top to bottom.

    ``differences`` are the median differences to the reference subject, by the names of a subject; ``against`` names
    that reference. The control has no success rate.
    """
    subjects, axis = found.subjects, found.metric.axis
    shown = [True, any(one.estimator != CONTROL for one in subjects), bool(differences)]
    widths = [width for width, there in zip((2.2, 1.0, 1.4), shown, strict=True) if there]
    figure, places = grid_figure(1, 1, width_in=7.5 + 1.2 * shown[2], height_in=1.75 + _LINE_IN * len(subjects))
    places[0, 0].remove()
    panels = list(figure.subplots(1, len(widths), squeeze=False, sharey=True, width_ratios=widths)[0])
    _draw_errors(panels[0], found)
    if shown[1]:
        success = panels[1]
        for row, one in enumerate(subjects):
            if one.estimator != CONTROL:
                _draw_interval(success, row, percent(one.success), found.styles[one.names].colour)
        low, high = success.get_xlim()
        success.set_xlim(max(low, 0.0), min(high, 101.0))
        success.set_xlabel("success, %")
    if shown[2]:
        right = panels[-1]
        right.axvline(0.0, color=GREY, linewidth=1.0)
        for row, one in enumerate(subjects):
            if one.names in differences:
                _draw_interval(right, row, differences[one.names], found.styles[one.names].colour)
        low, high = right.get_xlim()
        edge = 0.06 * (max(high, 0.0) - min(low, 0.0))
        right.set_xlim(min(low, -edge), max(high, edge))
        unit = axis.rsplit(", ", 1)[-1] if ", " in axis else ""
        right.set_xlabel(f"median difference to\n{against}{f', {unit}' if unit else ''}")
    panels[0].set_yticks(range(len(subjects)), [found.label(one.names) for one in subjects])
    panels[0].set_ylim(len(subjects) - 0.4, -0.6)
    return finish(figure, title, found.credits, legend=panels[0])


def _draw_errors(axes: Axes, found: RunComparison) -> None:
    for row, one in enumerate(found.subjects):
        colour, (median, *further) = found.styles[one.names].colour, one.solved
        _draw_interval(axes, row, median, colour)
        for measured, (marker, size) in zip(further, _MARKS, strict=True):
            if measured.value is not None:
                axes.plot(measured.value, row, marker, color=colour, markersize=size, markerfacecolor="white")
        counted = one.counted[0].value if found.metric.error else None
        if counted is not None and np.isfinite(counted) and counted != median.value:
            axes.plot(counted, row, "o", color=colour, markersize=7, markerfacecolor="none")
    # The marks are explained in grey, as the colour is that of the subject.
    marks = {"o": "median, 95 % interval", "D": "RMS", "|": "75th, 95th, 99th percentile"}
    for marker, label in marks.items():
        axes.plot([], [], marker, color=GREY, label=label, markerfacecolor="white" if marker == "D" else GREY)
    axes.plot([], [], "o", color=GREY, markerfacecolor="none", markersize=7, label="median, failures counted")
    axes.set_xlabel(found.metric.axis)
    if axes.dataLim.x0 > 0.0:  # Zero has no place on a logarithmic axis.
        axes.set_xscale("log")
        mark_decades(axes.xaxis)


def _draw_interval(axes: Axes, row: int, measured: Measured, colour: str) -> None:
    """Draw a value as a point and its interval as a thick bar."""
    if measured.value is None:
        return
    if measured.low is not None and measured.high is not None:
        axes.hlines(row, measured.low, measured.high, color=colour, linewidth=4.0, alpha=0.45)
    axes.plot(measured.value, row, "o", color=colour, markersize=5)


def _title(found: RunComparison, what: str, group: str) -> str:
    """Return the title of a figure of one group."""
    return ", ".join(filter(None, (what, group, found.shared if ESTIMATOR in found.varied else "")))


def trials_by_condition(tables: Tables, metric: Measure) -> Chosen:
    """Choose errors and conditions of the trials of single images."""
    components = (LATERAL, BORESIGHT, ATTITUDE)
    errors = components if metric.name in components else ("value", *components)
    # The shares of craters found or matched are computed from their number, so it is not one of their conditions.
    given = [name for name in CONDITIONS if name != OWN_BINS or metric.name not in (*DETECTION, *MATCHING)]
    return _chosen(tables, errors, (*given, "prior"))


def prepare_frames(epochs: pd.DataFrame) -> pd.DataFrame:
    """Choose fewer than 120 evenly spaced frames of each sequence; more add little, as frames are correlated."""
    stride = max(1, int(epochs["frame"].max() + 1) // _FRAMES)
    kept = epochs[epochs["frame"] % stride == 0]
    distance = np.linalg.norm(kept[[f"true_{axis}_m" for axis in "xyz"]].to_numpy(dtype=np.float64), axis=1)
    return kept.assign(
        value=kept["position_error_m"],
        **{RADIAL: kept["radial_m"].abs(), TRANSVERSE: np.hypot(kept["along_m"], kept["cross_m"])},
        distance_m=distance,
        failed=False,
    )


def frames_by_condition(tables: Tables) -> Chosen:
    """Choose errors and conditions of the frames of sequences; success is a property of whole sequences."""
    along = "anomaly_deg" if any(table["anomaly_deg"].notna().any() for table in tables.values()) else "time_s"
    return _chosen(tables, ("value", RADIAL, TRANSVERSE), (along, "distance_m", "n_landmarks"))


def _chosen(tables: Tables, errors: Sequence[str], conditions: Sequence[str]) -> Chosen:
    whole = pd.concat(tables.values())
    known = [name for name in errors if whole[name].notna().any()]
    success = [SUCCESS] if whole["failed"].any() else []
    return (*known, *success), tuple(name for name in conditions if _varies(whole[name]))


def _varies(values: pd.Series) -> bool:
    known = values.dropna().to_numpy(dtype=np.float64)
    return len(known) > 0 and float(np.ptp(known)) > 1e-6 * max(float(np.abs(known).max()), 1e-12)


def binned_errors(tables: Tables, error: str, condition: str) -> Iterator[tuple[str, Points]]:
    """Yield medians of an error, or success rates, in bins of a condition, for each subject whose condition varies.

    The abscissa of a bin is the median of its condition. Bins of fewer than five independent trials are left out. All
    subjects have the same bins, except for the number of landmarks, which may differ widely between estimators.
    """
    varying = {label: table for label, table in tables.items() if _varies(table[condition])}
    for label, table in varying.items():
        edges = _bin_edges([table] if condition == OWN_BINS else list(varying.values()), condition)
        known = table[table[condition].notna() & (table[error].notna() if error != SUCCESS else True)]
        place = np.clip(np.searchsorted(edges, known[condition].to_numpy(), side="right") - 1, 0, len(edges) - 2)
        points = []
        for _, own in known.groupby(place):
            clusters = own["cluster"].to_numpy()
            if error == SUCCESS:
                found = percent(share_of(~own["failed"].to_numpy(dtype=bool), clusters))
            else:
                found = measure(own[error].to_numpy(dtype=np.float64), clusters, (MEDIAN,))[0]
            if len(np.unique(clusters)) >= _FEWEST and None not in (found.value, found.low, found.high):
                points.append((float(own[condition].median()), found.value, found.low, found.high))
        if points:
            x, y, *ends = np.array(points, dtype=np.float64).T
            yield label, Points(x, y, np.column_stack(ends))


def _bin_edges(tables: Sequence[pd.DataFrame], condition: str) -> FloatArray:
    """Choose edges (b + 1,) of bins that contain equal numbers of rows of all tables together."""
    longest = max(int(table.loc[table[condition].notna(), "cluster"].nunique()) for table in tables)
    bins = int(np.clip(longest // _BIN_TRIALS, 1, _MOST_BINS))
    values = pd.concat([table[condition].dropna() for table in tables])
    return np.unique(np.quantile(values.to_numpy(dtype=np.float64), np.linspace(0.0, 1.0, bins + 1)))
