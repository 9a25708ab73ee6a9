"""Figures of a grid of scenarios."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.reports.compare.figures import cumulative_figure, summary_figure
from boresight.reports.compare.subjects import compared
from boresight.reports.figures.scenario_grids import Effect, HeatMap, draw_curves, draw_effects, draw_heat_maps
from boresight.reports.figures.style import Points
from boresight.reports.kinds.designs.tables import ATTITUDE, POSITION, DesignData, Outcome, outcomes
from boresight.reports.run.data import GridAxis, RunData
from boresight.reports.schema.grid import number
from boresight.reports.schema.labels import stage_label
from boresight.reports.schema.named_figure import NamedFigure, file_stem
from boresight.reports.schema.records import CONTROL, SEQUENCE
from boresight.reports.schema.tables import kind_schema, measure_label, measure_of, unit_of
from boresight.reports.statistics.measured import Measured


def design_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw what a run's grid shows."""
    design = run.manifest.grid
    if design is None:
        return
    data, found = DesignData(run, design), outcomes(run)
    if kind_schema(run.manifest.experiment).frames:
        if design.design == "one-at-a-time":
            for base, names in data.bases().items():
                yield from _sequences(data, base, names)
        return
    if design.design == "full" and len(design.axes) == 1:
        # The errors of every estimator at each level of a single axis are drawn with the figures of a comparison.
        if run.rows[POSITION].notna().any():
            both = compared((run,), measure_of(POSITION))
            yield summary_figure(both)
            for level, subjects in both.groups.items():
                yield cumulative_figure(both, level, subjects)
        return
    draw = {"full": _matrix, "one-at-a-time": _curves, "two-level": _effects}[design.design]
    for base, names in data.bases().items():
        for estimator in dict.fromkeys(outcome.estimator for outcome in found):
            own = [outcome for outcome in found if outcome.estimator == estimator]
            yield from draw(data, base, names, own)


def _matrix(data: DesignData, base: str, names: list[str], own: list[Outcome]) -> Iterator[NamedFigure]:
    """Heat maps of two axes; grids of more have their tables alone."""
    if len(data.design.axes) != 2:
        return
    down, across = data.design.axes
    by_levels = {tuple(data.levels(name).values()): name for name in names}
    estimator = own[0].estimator
    title = f"{down.name} against {across.name}, {base}, {estimator}"
    matrices = []
    for outcome in own:
        values = np.full((len(down.levels), len(across.levels)), np.nan)
        texts = [["" for _ in across.levels] for _ in down.levels]
        for i, row in enumerate(down.levels):
            for j, column in enumerate(across.levels):
                name = by_levels.get((row, column))
                median = data.median(name, outcome) if name else Measured(None)
                values[i, j] = median.bar[0]
                interval = "" if median.low is None else f"\n[{number(median.low)}, {number(median.high)}]"
                texts[i][j] = f"{number(median.value)}{interval}\n{data.ok([name], outcome) if name else ''}"
        matrices.append(HeatMap(outcome.label, down.levels, across.levels, values, texts))
    yield NamedFigure(
        file_stem(f"matrix_{base}_{estimator}"),
        draw_heat_maps(matrices, down.label, across.label, title),
        f"{title}: median error with its 95 % interval, and the trials behind it, of all.",
        f"Heat maps of {', '.join(matrix.title for matrix in matrices)} over {down.label} and {across.label}.",
    )


def _curves(data: DesignData, base: str, names: list[str], own: list[Outcome]) -> Iterator[NamedFigure]:
    """Median error against each axis that has values, a figure for position and one for attitude."""
    estimator = own[0].estimator
    for measure in (POSITION, ATTITUDE):
        group = [Outcome(estimator, CONTROL, measure), *(o for o in own if o.measure == measure)]
        group = [o for o in group if len(data.errors(names[0], o))]
        title = f"{measure_label(measure)} against each error of knowledge, {base}, {estimator}"
        if group:  # else no trial at the reference came to an end
            yield from _over_axes(data, names, group, f"{measure.split('_')[0]}_{base}_{estimator}", title, "")


def _over_axes(
    data: DesignData, names: list[str], group: list[Outcome], stem: str, title: str, over: str
) -> Iterator[NamedFigure]:
    """Draw the medians of one measure over each axis that has values, if there is one."""
    axes = [axis for axis in data.design.axes if axis.values is not None]
    label, unit = measure_label(group[0].measure), unit_of(group[0].measure)
    if axes:
        panels = [(axis.label, _lines(data, names, axis, group)) for axis in axes]
        yield NamedFigure(
            file_stem(f"curves_{stem}"),
            draw_curves(panels, f"median {label}, {unit}", title),
            f"{title}: medians with 95 % intervals{over}, the other axes at their first level.",
            f"Curves of the median {label} against {', '.join(axis.label for axis in axes)}.",
        )


def _sequences(data: DesignData, base: str, names: list[str]) -> Iterator[NamedFigure]:
    """Draw all estimators of sequences together: curves over the axes with values, and the factor of every level."""
    found = outcomes(data.run)
    for measure in dict.fromkeys(outcome.measure for outcome in found):
        group = [outcome for outcome in found if outcome.measure == measure]
        what, over = f"{measure_label(measure)}, {base}", " over the trials that came so far"
        yield from _over_axes(data, names, group, f"{measure}_{base}", what, over)
        yield NamedFigure(
            file_stem(f"levels_{measure}_{base}"),
            draw_effects({o.estimator: _level_effects(data, names, o) for o in group}, what),
            f"{what}: the factor by which the error changes from the reference to each level, over the trials that came"
            " so far with both, with its 95 % interval; 1 is no effect. Beside it the trials that came so far, of all.",
            f"Points with intervals for {', '.join(o.estimator for o in group)}.",
        )


def _level_effects(data: DesignData, names: list[str], outcome: Outcome) -> list[Effect]:
    """Compare each level with the reference; where nothing can be compared, the effect is NaN and keeps its line."""
    reference, effects = names[0], []
    for axis in data.design.axes:
        for level in axis.levels[1:]:
            for name in (n for n in names[1:] if data.levels(n)[axis.name] == level):
                found = data.change(name, reference, outcome)
                value, low, high = (np.nan if x is None else x for x in (found.value, found.low, found.high))
                note = data.ok([name], outcome)
                effects.append(Effect(f"{axis.label}: {level}", value, low, high, note))
    return effects


def _lines(data: DesignData, names: list[str], axis: GridAxis, group: list[Outcome]) -> dict[str, Points]:
    """Points of each outcome along an axis: the reference and the scenarios that vary this axis alone."""
    reference = data.levels(names[0])
    along = {}
    for name in names:
        levels = data.levels(name)
        if all(levels[other.name] == reference[other.name] for other in data.design.axes if other.name != axis.name):
            along[levels[axis.name]] = name
    known = [
        (value, along[level]) for level, value in zip(axis.levels, axis.values or (), strict=True) if level in along
    ]
    lines = {}
    for outcome in group:
        bars = np.array([data.median(name, outcome).bar for _, name in known]).reshape(-1, 3)
        label = stage_label(outcome.stage) if outcome.stage not in ("", SEQUENCE) else outcome.estimator
        lines[label] = Points(np.array([value for value, _ in known]), bars[:, 0], bars[:, 1:])
    return lines


def _effects(data: DesignData, base: str, names: list[str], own: list[Outcome]) -> Iterator[NamedFigure]:
    """Draw main effects as points with intervals."""
    panels: dict[str, list[Effect]] = {}
    estimator = own[0].estimator
    for outcome in own:
        effects = []
        for axis, found in zip(data.design.axes, data.effects(names, outcome), strict=True):
            if found.value is not None and found.low is not None and found.high is not None:
                label = f"{axis.label}: {axis.levels[0]} to {axis.levels[-1]}"
                effects.append(Effect(label, found.value, found.low, found.high))
        panels[outcome.label.split(",")[0]] = effects
    if not any(panels.values()):
        return
    title = f"Main effects, {base}, {estimator}"
    yield NamedFigure(
        file_stem(f"effects_{base}_{estimator}"),
        draw_effects(panels, title),
        f"{title}: the factor by which the error changes from the first to the last level of each axis, with its"
        " 95 % interval; 1 is no effect.",
        f"Points with intervals for {', '.join(panels)}.",
    )
