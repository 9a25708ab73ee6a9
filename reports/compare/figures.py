"""The figures of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from boresight.reports.compare.conditions import (
    ATTITUDE,
    ConditionTables,
    axis_label,
    binned_errors,
    frames_by_condition,
    prepare_frames,
    trials_by_condition,
)
from boresight.reports.compare.metrics import Metric
from boresight.reports.compare.subjects import RunComparison, Subject
from boresight.reports.compare.tables import differing_level, subject_consistencies
from boresight.reports.compare.trials import ESTIMATOR, run_names
from boresight.reports.figures.comparison import (
    CoverageCurve,
    SubjectSummary,
    draw_binned_errors,
    draw_coverage,
    draw_summaries,
)
from boresight.reports.figures.pose import draw_cumulative_errors
from boresight.reports.figures.style import PlotStyle, plot_styles
from boresight.reports.run.data import TRIAL_KEY
from boresight.reports.schema.labels import as_title
from boresight.reports.schema.named_figure import NamedFigure, file_stem
from boresight.reports.schema.records import CONTROL
from boresight.reports.statistics.consistency import normalised_label
from boresight.reports.statistics.measured import Measured


def comparison_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw all figures for which there are data; captions give the number of solved trials of each subject."""
    counts = "; ".join(f"{found.label(one.names)} {one.n_ok}/{one.n}" for one in found.subjects)
    groups = subjects_by_group(found)
    by_group = (figure for group, own in groups.items() for figure in _group_figures(found, group, own))
    for figure in (summary_figure(found), *consistency_figures(found), *by_group):
        yield replace(figure, caption=f"{figure.caption} Solved trials: {counts}.")


def _group_figures(found: RunComparison, group: str, subjects: Mapping[str, Subject]) -> Iterator[NamedFigure]:
    yield cumulative_figure(found, group, subjects)
    split = _tables_by_condition(found, subjects)
    if split is not None and split.conditions:
        yield conditions_figure(found, group, split)


def consistency_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw, for each kind of normalised error, the coverage of the covariance that subjects claim."""
    claims, styles = list(subject_consistencies(found)), subject_styles(found)
    for kind in dict.fromkeys(one.kind for one in claims):
        for group, subjects in subjects_by_group(found).items():
            labels = {one.names: label for label, one in subjects.items()}
            own = {labels[one.subject.names]: one for one in claims if one.kind == kind and one.subject.names in labels}
            drawn = [
                CoverageCurve(
                    f"{label} (n = {len(one.ratios)})",
                    styles[one.subject.names],
                    one.ratios * one.degrees / one.expected,
                    one.degrees,
                    len(np.unique(one.clusters)),
                )
                for label, one in own.items()
            ]
            title = _title(found, normalised_label(kind), group)
            if drawn:
                yield NamedFigure(
                    file_stem("consistency", kind, *filter(None, [group])),
                    draw_coverage(drawn, title, credit_lines(found)),
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
    own, title = subject_styles(found), _title(found, "Cumulative error", group)
    return NamedFigure(
        file_stem("cumulative", *filter(None, [group])),
        draw_cumulative_errors(
            {label: (table, len(table)) for label, table in tables.items()}, title, credit_lines(found), panels,
            {label: own[one.names] for label, one in subjects.items()},
        ),
        f"{title}: share of all trials with an error below the abscissa; a curve ends at the share of trials with an"
        " error, so that failures lower it.",
        f"Cumulative shares of {', '.join(panels.values())} for {', '.join(tables)}.",
    )  # fmt: skip


def _tables_by_condition(found: RunComparison, subjects: Mapping[str, Subject]) -> ConditionTables | None:
    """Choose frames of sequences, else trials; None where no estimator has an error or a sequence no frames."""
    tables = {label: found.of(one) for label, one in subjects.items() if one.estimator != CONTROL and one.n_ok}
    if not tables:
        return None
    if all(run.table("epochs").empty for run in found.runs):
        return trials_by_condition(tables, found.metric)
    framed = {label: _frames(found, table) for label, table in tables.items()}
    return frames_by_condition(framed) if all(len(table) for table in framed.values()) else None


def _frames(found: RunComparison, trials: pd.DataFrame) -> pd.DataFrame:
    """Gather the frames of trials; frames of the same ``cluster`` are not independent."""
    parts = []
    for run, name in zip(found.runs, run_names(found.runs), strict=True):
        if {"true_x_m", "radial_m"} <= set(run.table("epochs").columns):
            own = trials.loc[trials["run"] == name, [*TRIAL_KEY, "cluster"]]
            parts.append(run.table("epochs").merge(own, on=TRIAL_KEY))
    return prepare_frames(pd.concat(parts, ignore_index=True)) if parts else pd.DataFrame()


def conditions_figure(found: RunComparison, group: str, split: ConditionTables) -> NamedFigure:
    """Draw errors against conditions."""
    own, subjects = subject_styles(found), subjects_by_group(found)[group]
    frames = "frame" in next(iter(split.tables.values()))
    metric = Metric("position_error_m") if frames else found.metric
    panels = {
        (axis_label(error, metric), axis_label(condition, metric)): dict(binned_errors(split, error, condition))
        for error in split.errors
        for condition in split.conditions
    }
    over = "the solved trials"
    if frames:
        over = "evenly spaced frames of each trial (fewer than 120), with intervals over whole trials,"
    title = _title(found, "Errors by conditions", group)
    styles = {label: own[subjects[label].names] for label in split.tables}
    return NamedFigure(
        file_stem("conditions", *filter(None, [group])),
        draw_binned_errors(panels, styles, title, credit_lines(found)),
        f"{title}: medians over {over} in bins of equal numbers, with 95 % intervals. Success: share of all trials of a"
        " bin.",
        f"Binned errors of {', '.join(split.tables)} against {', '.join(dict.fromkeys(key[1] for key in panels))}.",
    )


def summary_figure(found: RunComparison) -> NamedFigure:
    """Draw errors, success and differences of all subjects."""
    own, order = subject_styles(found), {one.names: place for place, one in enumerate(found.subjects)}
    # Of a subject the level that differs in the first one that it is compared with, and the median difference.
    bases: dict[tuple[str, ...], tuple[str, Measured]] = {}
    for one in sorted(found.contrasts, key=lambda contrast: order[contrast.second]):
        bases.setdefault(one.first, (differing_level(one), one.median))
    standings = [
        SubjectSummary(
            found.label(one.names),
            own[one.names].colour,
            one.solved,
            one.counted if found.metric.is_error else one.solved,
            None if one.estimator == CONTROL else one.success,
            bases[one.names][1] if one.names in bases else None,
        )
        for one in found.subjects
    ]
    against = {name for name, _ in bases.values()}
    reference = against.pop() if len(against) == 1 else "the first"
    title = ", ".join(filter(None, (as_title(found.metric.label), found.shared)))
    return NamedFigure(
        "compare",
        draw_summaries(standings, found.metric.axis, reference, title, credit_lines(found)),
        f"{title}: median with its 95 % interval, RMS and percentiles over the solved trials, the median of all trials"
        " with failures counted, success rates, and the median of the paired differences to the first subject that"
        " differs in one factor only.",
        f"Errors, success rates and differences of {', '.join(found.label(one.names) for one in found.subjects)}.",
    )


def subject_styles(found: RunComparison) -> dict[tuple[str, ...], PlotStyle]:
    """Return the style of each subject: that of its estimator, or its own where estimators are pooled."""
    keys = [one.estimator or found.label(one.names) for one in found.subjects]
    drawn = plot_styles(keys)
    return {one.names: drawn[key] for one, key in zip(found.subjects, keys, strict=True)}


def credit_lines(found: RunComparison) -> list[str]:
    """Return the credit lines of all runs, each once."""
    return list(dict.fromkeys(line for run in found.runs for line in run.manifest.credits))


def subjects_by_group(found: RunComparison) -> dict[str, dict[str, Subject]]:
    """Group the subjects that differ in the estimator alone: name of the group to label to subject.

    Where estimators are pooled, all subjects are one group.
    """
    gathered: dict[str, dict[str, Subject]] = {}
    for one in found.subjects:
        named = dict(zip(found.factors, one.names, strict=True))
        if ESTIMATOR not in found.factors:
            gathered.setdefault("", {})[found.label(one.names)] = one
            continue
        label = named.pop(ESTIMATOR)
        kept = [level for factor, level in named.items() if factor in found.varied]
        gathered.setdefault(", ".join(kept), {})[label] = one
    return gathered


def _title(found: RunComparison, what: str, group: str) -> str:
    """Return the title of a figure of one group."""
    return ", ".join(filter(None, (what, group, found.shared if ESTIMATOR in found.varied else "")))
