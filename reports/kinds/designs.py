"""Tables and figures of a grid of scenarios: errors by level, and paired changes between levels.

A change is the ratio of geometric means over the same trials, whose views and priors are the same in every scenario:
``exp(mean_t(ln e_t - ln e'_t))``. It is paired, one bad trial does not decide it, and the effects of several axes
multiply.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from boresight.reports.compare.figures import cumulative_figure, summary_figure
from boresight.reports.compare.subjects import compared
from boresight.reports.figures.comparison import Effect, HeatMap, draw_curves, draw_effects, draw_heat_maps
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.style import Points
from boresight.reports.kinds.design_data import (
    ATTITUDE,
    POSITION,
    REVOLUTION_ERRORS,
    DesignData,
    Outcome,
    outcomes,
)
from boresight.reports.kinds.maps import cell_text, level_maps
from boresight.reports.kinds.pooled import extreme_grid, is_wide, level_grids
from boresight.reports.run.data import GridAxis, RunData
from boresight.reports.run.outcomes import MEANING
from boresight.reports.schema.grid import NO_VALUE, Grid
from boresight.reports.schema.records import CONTROL, SEQUENCE, as_title, stage_label
from boresight.reports.schema.tables import kind_schema, measure_label, measure_of, unit_of
from boresight.reports.statistics.measured import Measured
from boresight.reports.tables import interval

_CHANGE = "change"
_CHANGE_NOTE = (
    "Change: the ratio of geometric means of the error over the same trials, with its 95 % interval; above 1"
    " it got worse."
)
_EFFECT_NOTE = (
    "Main effect: the factor by which the error changes from the first to the last level of an axis, by least"
    " squares on its logarithm over all scenarios with a constant for each trial, with its 95 % bootstrap interval."
    " Trials are counted at either level."
)
_COUNTED = ("ok",), "ok: trials behind the median, of all."
_POSED = ("solved", "success"), MEANING
"""Headings of `DesignData.counts`, and what they mean."""


@dataclass(frozen=True, slots=True)
class _Line:
    """A row of the matrices: its levels, the scenarios of which trials are counted, and its reference, '' if none."""

    levels: tuple[str, ...]
    sides: tuple[list[str], ...]
    reference: str = ""


def design_grids(run: RunData, brief: bool = False) -> list[Grid]:
    """Tabulate a grid of scenarios, nothing for other runs: a matrix of levels and estimators for each measure.

    ``brief``: the final position error alone, without changes.
    """
    design, of_measure = run.manifest.grid, dict[str, list[Outcome]]()
    if design is None:
        return []
    for one in sorted(outcomes(run), key=lambda one: run.place_of(one.estimator)):
        of_measure.setdefault(one.label, []).append(one)
    groups = sorted(of_measure.values(), key=lambda group: (group[0].stage, group[0].measure) != ("", POSITION))
    if not groups:
        return []
    data = DesignData(run, design)
    if brief:
        measures = (POSITION, *REVOLUTION_ERRORS)
        final = [group for group in groups if group[0].stage in ("", SEQUENCE) and group[0].measure in measures]
        groups = (final or groups)[-1:]
    tabulate = _effect_grids if design.design == "two-level" else _level_grids
    found = [grid for base, names in data.bases().items() for grid in tabulate(data, base, names, groups)]
    if brief:
        return [grid.keep(*(head for head in grid.columns if not head.endswith(f", {_CHANGE}"))) for grid in found]
    return found


def _level_grids(data: DesignData, base: str, names: list[str], groups: list[list[Outcome]]) -> Iterator[Grid]:
    """Tabulate the median errors at the levels, and their changes from the reference."""
    if is_wide(data.run):
        yield from _wide_grids(data, base, names, groups)
        return
    if data.design.design == "full":
        what, heads, lines = _combinations(data, names)
    else:
        what, heads, lines = "one at a time", ("axis", "level"), _alone(data, names)
    compared = any(line.reference for line in lines)
    note = _CHANGE_NOTE if compared else ""
    if compared and data.design.design == "full":
        note += " The reference of a line is the combination whose levels agree."
    for group in groups:
        prior = data.priors(names, group[0].estimator) if group[0].measure == POSITION else []
        columns = [*heads, *(one.label for one in prior)]
        for one in group:
            columns += [one.estimator, *([f"{one.estimator}, {_CHANGE}"] if compared else [])]
        rows = []
        for line in lines:
            (name,) = line.sides[0]
            cells = [*line.levels, *(interval(data.median(name, one)) for one in prior)]
            for one in group:
                change = interval(data.change(name, line.reference, one)) if line.reference else NO_VALUE
                cells += [data.printed_median(name, one), *([change] if compared else [])]
            rows.append(tuple(cells))
        title = f"{as_title(group[0].label)}: {what}, {base}"
        yield Grid(title, tuple(columns), tuple(rows), frozenset(range(len(heads))), note)
        note = ""
    yield _count_grid(data, f"Trials: {what}, {base}", heads, lines, groups)


def _wide_grids(data: DesignData, base: str, names: list[str], groups: list[list[Outcome]]) -> Iterator[Grid]:
    """Tabulate each measure by the levels of each axis, and the extreme cells of the first measure."""
    axes = data.design.axes
    for group in groups:
        prior = data.priors(names[:1], group[0].estimator) if group[0].measure == POSITION else []
        tables = [(one.estimator if one in group else CONTROL, data.pooled(names, one)) for one in (*prior, *group)]
        title = f"{as_title(group[0].label)}, {base}"
        yield from level_grids(title, tables, axes)
        if group is groups[0]:
            yield extreme_grid(title, tables, axes)


def _combinations(data: DesignData, names: list[str]) -> tuple[str, tuple[str, ...], list[_Line]]:
    """List each combination of levels, its reference the one at which two axes of the same levels agree."""
    lines, axes = [], data.design.axes
    for name in names:
        levels, against = data.levels(name), ""
        if len(axes) == 2 and axes[0].levels == axes[1].levels:
            agreeing = levels | {axes[1].name: levels[axes[0].name]}
            against = next((other for other in names if data.levels(other) == agreeing), "")
        lines.append(_Line(tuple(levels.values()), ([name],), "" if against == name else against))
    return " against ".join(axis.name for axis in axes), tuple(axis.label for axis in axes), lines


def _alone(data: DesignData, names: list[str]) -> list[_Line]:
    """List the reference, and each other level of each axis by itself."""
    reference, *others = names
    lines = [_Line(("reference", ""), ([reference],))]
    for axis in data.design.axes:
        for level in axis.levels[1:]:
            at = [name for name in others if data.levels(name)[axis.name] == level]
            lines += [_Line((axis.label, level), ([name],), reference) for name in at]
    return lines


def _effect_grids(data: DesignData, base: str, names: list[str], groups: list[list[Outcome]]) -> Iterator[Grid]:
    """Tabulate main effects: the scenarios with an axis at its last level against those with it at its first."""
    heads, lines = ("axis", "from", "to"), []
    for axis in data.design.axes:
        levels = (axis.levels[0], axis.levels[-1])
        sides = [[name for name in names if data.levels(name)[axis.name] == level] for level in levels]
        lines.append(_Line((axis.label, *levels), tuple(sides)))
    # The prior has no line of its own: its error is that in the scenario whose levels are all first.
    priors = [interval(data.median(names[0], prior)) for prior in data.priors(names[:1], groups[0][0].estimator)]
    note = _EFFECT_NOTE + "".join(
        f" Median position error of the prior at the first levels: {error} m." for error in priors
    )
    for group in groups:
        effects = [data.effects(names, one) for one in group]
        rows = tuple((*line.levels, *(interval(found[k]) for found in effects)) for k, line in enumerate(lines))
        columns = (*heads, *(one.estimator for one in group))
        title = f"Main effects on the {group[0].label.split(',')[0]}, {base}"
        yield Grid(title, columns, rows, frozenset(range(len(heads))), note)
        note = ""
    yield _count_grid(data, f"Trials: main effects, {base}", heads, lines, groups)


def _count_grid(
    data: DesignData, title: str, heads: tuple[str, ...], lines: list[_Line], groups: list[list[Outcome]]
) -> Grid:
    """Tabulate the trials of each line that an estimator solved, and those that succeeded where there are priors."""
    last = {one.estimator: one for group in groups for one in group}
    names = [name for line in lines for side in line.sides for name in side]
    ends = {label: _POSED if data.priors(names, label) else _COUNTED for label in last}
    sides = ("",) if len(lines[0].sides) == 1 else (" from", " to")
    columns = [f"{label}, {head}{side}" for label, (own, _) in ends.items() for side in sides for head in own]
    rows = tuple(
        (*line.levels, *(n for one in last.values() for side in line.sides for n in data.counts(side, one)))
        for line in lines
    )
    meanings = " ".join(dict.fromkeys(meaning for _, meaning in ends.values()))
    return Grid(title, (*heads, *columns), rows, frozenset(range(len(heads))), meanings)


def design_figures(run: RunData) -> Iterator[NamedFigure]:
    """Draw what a run's grid shows."""
    design = run.manifest.grid
    if design is None:
        return
    if is_wide(run):
        if run.posed_pairs() and len(design.axes) > 1:
            yield from level_maps(run, design)
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
                texts[i][j] = cell_text(median, data.ok([name], outcome) if name else "")
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
    for name in (POSITION, ATTITUDE):
        group = [Outcome(estimator, CONTROL, name), *(o for o in own if o.measure == name)]
        group = [o for o in group if len(data.errors(names[0], o))]
        title = f"{measure_label(name)} against each error of knowledge, {base}, {estimator}"
        if group:  # else no trial at the reference came to an end
            yield from _over_axes(data, names, group, f"{name.split('_')[0]}_{base}_{estimator}", title, "")


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
    for name in dict.fromkeys(outcome.measure for outcome in found):
        group = [outcome for outcome in found if outcome.measure == name]
        what, over = f"{measure_label(name)}, {base}", " over the trials that came so far"
        yield from _over_axes(data, names, group, f"{name}_{base}", what, over)
        yield NamedFigure(
            file_stem(f"levels_{name}_{base}"),
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
    numbers = dict(zip(axis.levels, axis.values or (), strict=True))
    known = [(value, along[level]) for level, value in numbers.items() if level in along]
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
