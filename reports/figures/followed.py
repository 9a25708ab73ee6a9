"""Figures of a run of sequences: errors along the frames, of every start, and after whole revolutions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.sequences import (
    AFTER_REVOLUTIONS,
    LANDMARKS,
    POSITION,
    draw_revolutions,
    draw_starts,
    draw_traces,
)
from boresight.reports.figures.style import band_label
from boresight.reports.run.clusters import clusters_of
from boresight.reports.run.data import RunData
from boresight.reports.schema.records import count_of

_NUMBERED = re.compile(r"(?P<stem>.+)-(?P<number>\d+)")


def trace_figure(
    run: RunData, scenario: str, labels: Sequence[str], panels: Sequence[str] = (POSITION, LANDMARKS)
) -> NamedFigure:
    """Draw the errors of some estimators along the frames."""
    here = run.table("epochs")[run.table("epochs")["scenario"] == scenario]
    way, along = ("orbit", "the anomaly") if here["anomaly_deg"].notna().any() else ("trajectory", "time")
    title = f"Errors along the {way}, {scenario}"
    trials = here["trial"].nunique()
    return NamedFigure(
        file_stem(f"traces_{scenario}"),
        draw_traces({name: here[here["estimator"] == name] for name in labels}, title, run.manifest.credits, panels),
        f"{title}: median over {count_of(trials, 'trial')}, and {band_label(trials)}; a thin line: the"
        " first trial; a trial that failed ends with its last good frame.",
        f"Position error and landmark error against {along} for {', '.join(labels)}.",
    )


def start_figure(run: RunData, scenario: str, estimator: str) -> NamedFigure:
    """Draw the errors of every trial along the frames."""
    epochs = run.of(scenario, estimator, "epochs")
    title = f"Position error from {count_of(epochs['trial'].nunique(), 'start')}, {estimator}"
    return NamedFigure(
        file_stem(f"starts_{scenario}"),
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
    lines: dict[str, dict[str, tuple[str, str]]] = {}
    design = run.manifest.grid
    levels = {one.name: "-".join(one.levels.values()) for one in design.scenarios} if design is not None else {}
    for scenario, name in run.pairs():
        numbered = _NUMBERED.fullmatch(name)
        if scenario in levels:
            lines.setdefault(name, {})[levels[scenario]] = (scenario, name)
        elif design is None and numbered:
            lines.setdefault(numbered["stem"], {})[numbered["number"]] = (scenario, name)
    return {line: levels for line, levels in lines.items() if len(levels) > 1}


def revolution_figure(
    run: RunData, series: Mapping[str, Mapping[str, tuple[str, str]]], abscissa: str = ""
) -> NamedFigure:
    """Draw mean and deviation of the errors after each revolution over a series (figures 4.1 and 4.2)."""
    errors = {
        line: {level: (rows := run.of(*pair)).assign(cluster=clusters_of(run, rows)) for level, pair in levels.items()}
        for line, levels in series.items()
    }
    axes = run.manifest.grid.axes if run.manifest.grid is not None else ()
    abscissa = abscissa or ", ".join(axis.label for axis in axes) or "views"
    title = f"Position error after whole revolutions by {abscissa}"
    return NamedFigure(
        "revolutions",
        draw_revolutions(errors, abscissa, title),
        f"{title}: mean over the trials; thick bar: its 95 % interval; thin bar: one standard deviation of the trials;"
        " tick: median.",
        f"Mean position error after each revolution against {abscissa} for {', '.join(series)}.",
    )
