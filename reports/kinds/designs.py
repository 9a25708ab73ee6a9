"""Tables and figures of a grid of scenarios: errors by level, and paired changes between levels.

A change is the ratio of geometric means over the same trials, whose views and priors are the same in every scenario:
``exp(mean_t(ln e_t - ln e'_t))``. It is paired, one bad trial does not decide it, and the effects of several axes
multiply.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from boresight.reports.compare.figures import cumulative_figure, summary_figure
from boresight.reports.compare.subjects import compared
from boresight.reports.figures.comparison import Effect, HeatMap, draw_curves, draw_effects, draw_heat_maps
from boresight.reports.figures.named import NamedFigure, file_stem
from boresight.reports.figures.style import Points
from boresight.reports.kinds.pooled import extreme_grid, is_wide, level_grids, pooled_trials
from boresight.reports.run.clusters import clusters_of, image_set
from boresight.reports.run.data import GridAxis, RunData, ScenarioGrid
from boresight.reports.run.outcomes import MEANING, errors_by_stage, final_stage, succeeded
from boresight.reports.schema.grid import NO_VALUE, Grid, number, of_ended
from boresight.reports.schema.kinds import SEQUENCE_COLUMNS
from boresight.reports.schema.records import CONTROL, SEQUENCE, as_title, stage_label
from boresight.reports.schema.tables import kind_schema, measure_label, measure_of, unit_of
from boresight.reports.statistics.measured import MEAN, MEDIAN, Measured, measure
from boresight.reports.statistics.paired import main_effects
from boresight.reports.tables import interval

POSITION, ATTITUDE, CENTROID = "position_error_m", "attitude_error_deg", "centroid_offset_px"
REVOLUTION_ERRORS = tuple(name for name in SEQUENCE_COLUMNS if name.startswith("error_after_"))
_REPORTED = "diagnostics"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Quantity compared between scenarios: an error of an estimator after a stage, '' for the final one.

    The stage ``diagnostics`` stands for numbers that the estimator reports, ``sequence`` for what a trial of a sequence
    comes to.
    """

    estimator: str
    stage: str
    measure: str

    @property
    def label(self) -> str:
        """In words, with the unit."""
        if self.stage == CONTROL:
            return f"prior, {unit_of(self.measure)}"
        after = f" {stage_label(self.stage)}" if self.stage not in ("", _REPORTED, SEQUENCE) else ""
        return f"{measure_label(self.measure)}{after}, {unit_of(self.measure)}"


def outcomes(run: RunData) -> list[Outcome]:
    """List the outcomes of a run: what there is of centroiding, then the final position and attitude.

    The attitude is none of an estimator that leaves it as it was, such as centroiding alone. Of sequences, list the
    errors after whole revolutions that they are long enough for.
    """
    if kind_schema(run.manifest.experiment).frames:
        names = dict.fromkeys(name for _, name in run.pairs())
        reached = [name for name in REVOLUTION_ERRORS if run.rows[name].notna().any()]
        return [Outcome(estimator, SEQUENCE, name) for estimator in names for name in reached or [POSITION]]
    found = []
    for estimator in dict.fromkeys(name for _, name in run.pairs() if name != CONTROL):
        scenario = next(where for where, name in run.pairs() if name == estimator)
        stages = errors_by_stage(run, scenario, estimator)
        told = run.table("diagnostics")
        if ((told["estimator"] == estimator) & (told["name"] == CENTROID)).any():
            found.append(Outcome(estimator, _REPORTED, CENTROID))
        if "centroid" in stages and final_stage(run, scenario, estimator) != "centroid":
            found.append(Outcome(estimator, "centroid", POSITION))
        found.append(Outcome(estimator, "", POSITION))
        rows = run.rows[(run.rows["estimator"] == estimator) & (run.rows["status"] == "ok")]
        turned = (rows[ATTITUDE] - rows[f"prior_{ATTITUDE}"]).abs() > 1e-9
        if rows.empty or turned.any():
            found.append(Outcome(estimator, "", ATTITUDE))
    return found


class DesignData:
    """A run of a grid of scenarios, with the errors of an outcome by scenario and trial."""

    def __init__(self, run: RunData, design: ScenarioGrid) -> None:
        self.run = run
        self.design = design
        done = set(run.rows["scenario"])
        self._variations = {one.name: one for one in design.scenarios if one.name in done}
        self._errors: dict[tuple[str, Outcome], pd.Series] = {}

    def levels(self, scenario: str) -> dict[str, str]:
        """Return a scenario's level of each axis, in the order of the axes."""
        own = self._variations[scenario].levels
        return {axis.name: own[axis.name] for axis in self.design.axes}

    def bases(self) -> dict[str, list[str]]:
        """Group the scenarios that have been run by the one that they vary."""
        groups: dict[str, list[str]] = {}
        for name, one in self._variations.items():
            groups.setdefault(one.base, []).append(name)
        return groups

    def errors(self, scenario: str, outcome: Outcome) -> pd.Series:
        """Return the errors by trial; trials without an estimate, or which did not reach the stage, have none."""
        key, run = (scenario, outcome), self.run
        if key not in self._errors:
            if outcome.stage == _REPORTED:
                told = run.of(scenario, outcome.estimator, "diagnostics")
                errors = told[told["name"] == outcome.measure].set_index("trial")["value"]
            elif outcome.stage == SEQUENCE:  # of every trial that came so far, whether or not it failed later
                errors = run.of(scenario, outcome.estimator).set_index("trial")[outcome.measure]
            else:
                stages = errors_by_stage(run, scenario, outcome.estimator)
                table = stages.get(outcome.stage or final_stage(run, scenario, outcome.estimator))
                errors = pd.Series(dtype=float) if table is None else table.set_index("trial")[outcome.measure]
            self._errors[key] = errors.dropna().astype(float)
        return self._errors[key]

    def pooled(self, names: Sequence[str], outcome: Outcome) -> pd.DataFrame:
        """Return all trials of an estimator in some scenarios, with their errors and levels; see `pooled_trials`."""
        tables = {_REPORTED: self.run.table("diagnostics"), "": self.run.rows, SEQUENCE: self.run.rows}
        tables[CONTROL] = self.run.rows.assign(**{POSITION: self.run.rows[f"prior_{POSITION}"]})
        rows, errors = (
            table[(table["estimator"] == outcome.estimator) & table["scenario"].isin(names)]
            for table in (self.run.rows, tables.get(outcome.stage, self.run.table("stages")))
        )
        column = outcome.measure
        if outcome.stage == _REPORTED:
            errors, column = errors[errors["name"] == outcome.measure], "value"
        elif outcome.stage == "":
            errors = errors[errors["status"] == "ok"]
        elif outcome.stage not in tables:
            errors = errors[errors["stage"] == outcome.stage]
        levels = pd.DataFrame.from_dict({name: [*self.levels(name).values()] for name in names}, orient="index")
        return pooled_trials(self.run, errors.assign(value=errors[column]), rows, levels)

    def trials(self, scenario: str, outcome: Outcome) -> int:
        """Count the trials of a scenario, with and without an estimate."""
        return len(self.run.of(scenario, outcome.estimator))

    def priors(self, names: Sequence[str], estimator: str) -> list[Outcome]:
        """Return the position error of the prior that an estimator began with, where its trials have one."""
        prior = Outcome(estimator, CONTROL, POSITION)
        return [prior] if any(len(self.errors(name, prior)) for name in names) else []

    def median(self, scenario: str, outcome: Outcome) -> Measured:
        """Return the median error with its interval."""
        errors = self.errors(scenario, outcome)
        return measure(errors.to_numpy(), self._clusters(scenario, errors), (MEDIAN,))[0]

    def printed_median(self, scenario: str, outcome: Outcome) -> str:
        """Print the median error with its interval, and of how many trials where others have none."""
        cell, trials = interval(self.median(scenario, outcome)), self.trials(scenario, outcome)
        return of_ended(cell, len(self.errors(scenario, outcome)), trials)

    def ok(self, scenarios: Sequence[str], outcome: Outcome) -> str:
        """Print n_ok/n over scenarios."""
        n_ok = sum(len(self.errors(name, outcome)) for name in scenarios)
        return f"{n_ok}/{sum(self.trials(name, outcome) for name in scenarios)}"

    def counts(self, scenarios: Sequence[str], outcome: Outcome) -> tuple[str, ...]:
        """Print the trials behind a median and, where trials have priors, those that succeeded, over scenarios."""
        solved = self.ok(scenarios, outcome)
        if not self.priors(scenarios, outcome.estimator):
            return (solved,)
        good = [succeeded(self.run.of(name, outcome.estimator)) for name in scenarios]
        return (solved, f"{sum(int(own.sum()) for own in good)}/{sum(map(len, good))}")

    def change(self, scenario: str, against: str, outcome: Outcome) -> Measured:
        """Return the ratio of geometric means between two scenarios, over the trials known to both."""
        errors = (self.errors(name, outcome).clip(lower=1e-12) for name in (scenario, against))
        logs = pd.concat([np.log(series) for series in errors], axis=1, join="inner")
        difference = logs.iloc[:, 0] - logs.iloc[:, 1]
        found = measure(difference.to_numpy(), self._clusters(scenario, difference), (MEAN,))[0]
        return found.each(lambda end: float(np.exp(end)))

    def _clusters(self, scenario: str, by_trial: pd.Series) -> NDArray[np.generic]:
        return clusters_of(self.run, pd.DataFrame({"scenario": scenario, "trial": by_trial.index}))

    def effects(self, names: Sequence[str], outcome: Outcome) -> list[Measured]:
        """Return the main effect of each axis between its first and last level; of images or data bases without."""
        levels = {name: self.levels(name).values() for name in names}
        firsts = [axis.levels[0] for axis in self.design.axes]
        high = {name: [a != b for a, b in zip(own, firsts, strict=True)] for name, own in levels.items()}
        found = main_effects({name: self.errors(name, outcome) for name in names}, high)
        seen = any(image_set(self.run.manifest.scenarios[name]) for name in names)
        return [Measured(one.value) for one in found] if seen or self.run.databases > 1 else found


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
    axes = [axis for axis in data.design.axes if axis.values is not None]  # noqa: PD011  levels of an axis
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
    numbers = dict(zip(axis.levels, axis.values or (), strict=True))  # noqa: PD011  levels of an axis
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
