"""Campaign file: scenarios x estimators x trials from one seed, and grids of scenario variations."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, JsonValue, ValidationError

from boresight.scenarios.spec.base import PlainValue, SpecModel, rule
from boresight.scenarios.spec.scenario import NAME_PATTERN, NAMED

_LABEL = r"^[A-Za-z0-9][A-Za-z0-9._+-]*$"
_CLASS = r"^[^\x00-\x1f\x7f:][^\x00-\x1f\x7f]*:[A-Za-z_][A-Za-z0-9_]*$"
"""``module:Class`` or ``file.py:Class``."""

_NAME = re.compile(r"[a-z0-9._-]+")
MOST_SCENARIOS = 1000


class AxisSpec(SpecModel):
    """One factor: a key of the scenario with its values, or named levels with their overrides."""

    alternatives: ClassVar = (("values", "levels"),)

    label: str = Field("", description="What is varied and in which unit, for tables and figures")
    key: str | None = Field(None, description="The dotted key that takes the values")
    values: tuple[float, ...] | None = Field(None, min_length=2, description="Numbers; the first is the reference")
    levels: dict[str, Mapping[str, PlainValue]] | None = Field(
        None, min_length=2, description="Overrides by the name of the level; the first is the reference"
    )

    @rule
    def _check(self) -> None:
        if (self.key is None) != (self.values is None):
            raise ValueError("values belong to a key: give both, or levels with their overrides")
        if len(set(self.overrides)) < len(self.values or ()):
            raise ValueError("values must differ in their first six digits")
        wrong = [name for name in self.overrides if not _NAME.fullmatch(name)]
        if wrong:
            raise ValueError(f"the level {wrong[0]!r} may hold small letters, digits and . _ - alone")

    @property
    def overrides(self) -> dict[str, Mapping[str, JsonValue]]:
        """Overrides by the name of the level; a value's name is the value in six digits."""
        if self.levels is not None:
            return self.levels
        # 1e+06 would not match the pattern of names.
        named = {f"{value:g}".replace("+", ""): value for value in self.values or ()}
        return {name: {str(self.key): value} for name, value in named.items()}


class GridSpec(SpecModel):
    """Axes and a design over them.

    ``full`` runs every combination. ``one-at-a-time`` runs the reference, all axes at their first level, and each
    other level of each axis by itself. ``two-level`` runs a fraction of the combinations of the first and the last
    level of every axis in which main effects are not confounded with each other or with two-factor interactions
    (resolution IV).
    """

    design: Literal["full", "one-at-a-time", "two-level"] = Field("full", description="Which combinations run")
    axes: dict[str, AxisSpec] = Field(min_length=1, description="What is varied, by name")

    @rule
    def _check(self) -> None:
        wrong = [name for name in self.axes if not _NAME.fullmatch(name)]
        if wrong:
            raise ValueError(f"the axis {wrong[0]!r} may hold small letters, digits and . _ - alone")
        size = 1
        for axis in self.axes.values():
            size *= len(axis.overrides)
        if self.design == "full" and size > MOST_SCENARIOS:
            raise ValueError(f"{size} combinations are too many; a campaign has {MOST_SCENARIOS} scenarios at most")


class EstimatorSpec(SpecModel):
    """An estimator with its options and a unique label for tables.

    A campaign writes the name alone, ``prior``, or the name with options, ``{landmark-harris: {images: 200}}``.
    ``module:Class`` or ``file.py:Class`` is a class that is not registered. The option ``label`` distinguishes two
    entries of the same estimator; it is the name by default, or that of the class.
    """

    name: str = Field(pattern=f"{_LABEL}|{_CLASS}", description="Name of the estimator")
    label: str = Field(pattern=_LABEL, description="Its name in tables")
    options: Mapping[str, PlainValue] = Field(default_factory=dict, description="Options of the estimator")


def _read_estimator(value: object) -> EstimatorSpec:
    """Convert ``name`` or ``{name: {option: value}}`` to an `EstimatorSpec`."""
    if isinstance(value, EstimatorSpec):
        return value
    if isinstance(value, str):
        value = {value: {}}
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError("write an estimator as its name, or as {name: {option: value}}")
    ((name, options),) = value.items()
    options = {} if options is None else options
    if not re.fullmatch(f"{_LABEL}|{_CLASS}", name) or not isinstance(options, dict):
        raise ValueError(f"the options of {name!r} are not a mapping: write {{name: {{option: value}}}}")
    label = options.get("label", name.rpartition(":")[2])
    if not re.fullmatch(_LABEL, str(label)):
        raise ValueError(f"the label {label!r} of {name} may hold letters, digits and . _ + - alone")
    return EstimatorSpec(
        name=name, label=str(label), options={key: option for key, option in options.items() if key != "label"}
    )


EstimatorEntry = Annotated[
    EstimatorSpec,
    BeforeValidator(_read_estimator, json_schema_input_type=str | dict[str, dict[str, JsonValue] | None]),
]


class RequirementSpec(SpecModel):
    """A requirement on a design, as ``position_error_m < 30 in 99.73 % at 90 %``, and who must meet it.

    At least the share of all trials lies below the limit, failures counted as misses, to be shown with that confidence.
    The measure is one that the kind of trial is compared by, a number of its rows, ``seconds``, or, without a limit,
    ``solved`` or ``success``.
    """

    that: str = Field(description="MEASURE < LIMIT in SHARE % at CONFIDENCE %")
    estimators: tuple[str, ...] = Field((), description="Labels of those that must meet it; all if left out")
    scenarios: tuple[str, ...] = Field((), description="Scenarios in which; all if left out")


def _read_requirement(value: object) -> RequirementSpec:
    """Convert a text, or a mapping, to a `RequirementSpec`."""
    if isinstance(value, RequirementSpec):
        return value
    keys = {"that": value} if isinstance(value, str) else value
    try:
        return RequirementSpec.model_validate_json(json.dumps(keys))
    except (TypeError, ValidationError) as error:
        written = "its text, or as {that: text, estimators: [label], scenarios: [name]}"
        raise ValueError(f"write a requirement as {written}") from error


RequirementEntry = Annotated[
    RequirementSpec, BeforeValidator(_read_requirement, json_schema_input_type=str | RequirementSpec)
]


class CampaignSpec(SpecModel):
    """Content of a campaign file."""

    prose: ClassVar = frozenset({"name", "title", "description", "report", "requirements"})
    own: ClassVar = frozenset({"name", "title", "description"})

    name: str = Field(pattern=NAME_PATTERN, description=NAMED)
    title: str = Field("", description="Heading of the report")
    description: str = Field("", description="One line about the campaign")
    experiment: str = Field("single-image", pattern=NAME_PATTERN, description="The kind of trial")
    scenarios: tuple[str, ...] = Field(min_length=1, description="Scenarios by name, or by path from this file")
    overrides: Mapping[str, PlainValue] = Field(
        default_factory=dict, alias="set", description="Overrides of every scenario, as sections or as dotted keys"
    )
    grid: GridSpec | None = Field(None, description="Variations of every scenario, each a scenario of its own")
    estimators: tuple[EstimatorEntry, ...] = Field(min_length=1, description="name, or {name: {option: value}}")
    trials: int = Field(ge=1, le=10_000_000, description="Trials of each scenario")
    seed: int = Field(ge=0, lt=2**64, description="Every random number of the campaign follows from it")
    databases: int = Field(
        1,
        ge=1,
        le=1000,
        description="Data bases of each estimator, drawn afresh with the errors of the shape on board and, where there"
        " are craters, with another world of them, which is all that detection of craters and orbit determination have;"
        " trial t has data base t modulo their number",
    )
    report: str | None = Field(None, description="Key of the published values to set beside the results")
    requirements: tuple[RequirementEntry, ...] = Field(
        (), description="What every estimator must meet in every scenario; `run` exits with 4 if one does not"
    )

    @rule
    def _each_once(self) -> None:
        for key, values in (("scenarios", self.scenarios), ("labels", tuple(e.label for e in self.estimators))):
            twice = sorted({value for value in values if values.count(value) > 1})
            if twice:
                hint = "; give an estimator that appears twice a label" if key == "labels" else ""
                raise ValueError(f"{key} must differ, but {', '.join(twice)} appears twice{hint}")


@dataclass(frozen=True, slots=True)
class GridCell:
    """One scenario of a grid: the level of each axis by name, and the overrides of each in the order of the axes.

    ``suffix`` is added to the name of the varied scenario; '' for the reference of ``one-at-a-time``.
    """

    suffix: str
    levels: Mapping[str, str]
    overrides: tuple[Mapping[str, JsonValue], ...]


@dataclass(frozen=True, slots=True)
class GridVariation:
    """Origin of a scenario of a grid: the scenario that it varies, and its level of each axis."""

    base: str
    levels: Mapping[str, str]


def grid_cells(grid: GridSpec) -> tuple[GridCell, ...]:
    """List the scenarios of a grid, the reference first."""
    names = {axis: tuple(spec.overrides) for axis, spec in grid.axes.items()}
    if grid.design == "full":
        return tuple(_cell(grid, levels, "-".join(levels)) for levels in product(*names.values()))
    if grid.design == "two-level":
        runs = two_level_runs(len(names))
        chosen = [tuple(own[-1 if high else 0] for own, high in zip(names.values(), run, strict=True)) for run in runs]
        return tuple(_cell(grid, levels, f"run{i:02d}") for i, levels in enumerate(chosen, start=1))
    reference = tuple(own[0] for own in names.values())
    found = [_cell(grid, reference, "")]
    for place, (axis, own) in enumerate(names.items()):
        for level in own[1:]:
            found.append(_cell(grid, (*reference[:place], level, *reference[place + 1 :]), f"{axis}-{level}"))
    return tuple(found)


def two_level_runs(factors: int) -> tuple[tuple[bool, ...], ...]:
    """Return the runs of a two-level design of resolution IV: whether each factor is at its high level.

    The rows of a Hadamard matrix of order 2^m, at least the number of factors, and their negatives (fold-over). Main
    effects are orthogonal to each other and to two-factor interactions. The first run has all factors low.
    """
    matrix = np.ones((1, 1))
    while len(matrix) < factors:
        matrix = np.block([[matrix, matrix], [matrix, -matrix]])
    # Columns of a Hadamard matrix are orthogonal. The fold-over cancels the product of two columns with any third one:
    # main effects are clear of two-factor interactions.
    columns = matrix[:, :factors]
    return tuple(tuple(bool(sign < 0) for sign in row) for half in (columns, -columns) for row in half)


def _cell(grid: GridSpec, levels: tuple[str, ...], suffix: str) -> GridCell:
    overrides = tuple(axis.overrides[level] for axis, level in zip(grid.axes.values(), levels, strict=True))
    return GridCell(suffix, dict(zip(grid.axes, levels, strict=True)), overrides)
