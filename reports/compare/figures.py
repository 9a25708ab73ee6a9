"""The figures of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import pandas as pd

from reports.compare.conditions import (
    ATTITUDE,
    Split,
    binned,
    frames_of,
    label_of,
    split_of_frames,
    split_of_trials,
)
from reports.compare.consistency import consistency_figures
from reports.compare.grids import changed
from reports.compare.looks import colours, credits_of, groups, titled
from reports.compare.metrics import Metric
from reports.compare.subjects import RunComparison, Subject
from reports.figures.comparison import draw_binned
from reports.figures.pose import draw_cumulative_errors
from reports.figures.standings import Standing, draw_standings
from reports.run.data import TRIAL_KEY
from reports.schema.labels import as_title
from reports.schema.named_figure import NamedFigure, file_stem
from reports.schema.records import CONTROL
from reports.statistics.measured import Measured


def comparison_figures(found: RunComparison) -> Iterator[NamedFigure]:
    """Draw every figure that the trials allow; captions say how many trials each subject solved, of how many."""
    counts = "; ".join(f"{found.label(one.names)} {one.n_ok}/{one.n}" for one in found.subjects)
    for figure in _figures(found):
        yield replace(figure, caption=f"{figure.caption} Solved trials: {counts}.")


def _figures(found: RunComparison) -> Iterator[NamedFigure]:
    yield standings_figure(found)
    yield from consistency_figures(found)
    for name, subjects in groups(found).items():
        yield cumulative_figure(found, name, subjects)
        split = _split(found, subjects)
        if split is not None and split.conditions:
            yield conditions_figure(found, name, split)


def cumulative_figure(found: RunComparison, group: str, subjects: Mapping[str, Subject]) -> NamedFigure:
    """Draw the share of all trials below each error."""
    tables = {label: found.of(one) for label, one in subjects.items()}
    panels = {"value": found.metric.axis}
    if found.metric.name != ATTITUDE and any(table[ATTITUDE].notna().any() for table in tables.values()):
        panels[ATTITUDE] = "attitude error, deg"
    own = colours(found)
    title = titled(found, "Cumulative error", group)
    return NamedFigure(
        file_stem("cumulative", group) if group else "cumulative",
        draw_cumulative_errors(
            {label: (table, len(table)) for label, table in tables.items()}, title, credits_of(found), panels,
            {label: own[one.names] for label, one in subjects.items()},
        ),
        f"{title}: share of all trials with an error below the abscissa; a curve ends at the share of trials with an"
        " error, so that failures lower it.",
        f"Cumulative shares of {', '.join(panels.values())} for {', '.join(tables)}.",
    )  # fmt: skip


def _split(found: RunComparison, subjects: Mapping[str, Subject]) -> Split | None:
    """Choose what is split: frames of sequences, else trials; None where there is nothing to split."""
    estimating = {label: one for label, one in subjects.items() if one.estimator != CONTROL and one.n_ok}
    if not estimating:
        return None
    if all(run.table("epochs").empty for run in found.runs):
        return split_of_trials({label: found.of(one) for label, one in estimating.items()}, found.metric)
    tables = {label: frames_of_subject(found, one) for label, one in estimating.items()}
    return split_of_frames(tables) if all(len(table) for table in tables.values()) else None


def frames_of_subject(found: RunComparison, subject: Subject) -> pd.DataFrame:
    """Gather the frames of a subject's trials, with what is independent among them."""
    trials = found.of(subject)
    parts = []
    for run in found.runs:
        if {"true_x_m", "radial_m"} <= set(run.table("epochs").columns):
            own = trials.loc[trials["run"] == run.folder.name, [*TRIAL_KEY, "cluster"]]
            parts.append(run.table("epochs").merge(own, on=TRIAL_KEY))
    return frames_of(pd.concat(parts, ignore_index=True)) if parts else pd.DataFrame()


def conditions_figure(found: RunComparison, group: str, split: Split) -> NamedFigure:
    """Draw errors against conditions."""
    own = colours(found)
    subjects = groups(found)[group]
    frames = "frame" in next(iter(split.tables.values()))
    metric = Metric("position_error_m") if frames else found.metric
    panels = {
        (label_of(error, metric), label_of(condition, metric)): dict(binned(split, error, condition))
        for error in split.errors
        for condition in split.conditions
    }
    title = titled(found, "Errors by conditions", group)
    over = "at most 60 frames of each trial, the intervals of whole trials" if frames else "the solved trials"
    return NamedFigure(
        file_stem("conditions", group) if group else "conditions",
        draw_binned(panels, {label: own[subjects[label].names] for label in split.tables}, title, credits_of(found)),
        f"{title}: medians over {over} in bins of as many each, with 95 % intervals; success: share of all trials of a"
        " bin.",
        f"Binned errors of {', '.join(split.tables)} against {', '.join(dict.fromkeys(key[1] for key in panels))}.",
    )


def standings_figure(found: RunComparison) -> NamedFigure:
    """Draw errors, success and differences of all subjects."""
    own = colours(found)
    bases = _bases(found)
    standings = [
        Standing(
            found.label(one.names),
            own[one.names],
            one.solved,
            one.counted if found.metric.is_error else one.solved,
            None if one.estimator == CONTROL else one.success,
            bases[one.names][1] if one.names in bases else None,
        )
        for one in found.subjects
    ]
    against = {name for name, _ in bases.values()}
    title = ", ".join(filter(None, (as_title(found.metric.label), found.shared)))
    return NamedFigure(
        "compare",
        draw_standings(
            standings, found.metric.axis, against.pop() if len(against) == 1 else "the first", title, credits_of(found)
        ),
        f"{title}: median with its 95 % interval, RMS and percentiles over the solved trials, the median of all trials"
        " with failures counted, success rates, and the median difference trial by trial to the first of those that"
        " differ from it in one thing.",
        f"Errors, success rates and differences of {', '.join(found.label(one.names) for one in found.subjects)}.",
    )


def _bases(found: RunComparison) -> dict[tuple[str, ...], tuple[str, Measured]]:
    """Find for every subject the first one that it is held against: what differs in it, and the difference."""
    order = {one.names: place for place, one in enumerate(found.subjects)}
    held: dict[tuple[str, ...], tuple[str, Measured]] = {}
    for one in sorted(found.contrasts, key=lambda contrast: order[contrast.second]):
        held.setdefault(one.first, (changed(one), one.median))
    return held
