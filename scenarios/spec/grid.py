"""Many scenarios from one: named axes, and which of their combinations are run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, JsonValue, model_validator

from scenarios.spec.base import PlainValue, SpecModel

_NAME = re.compile(r"[a-z0-9._-]+")
MOST_SCENARIOS = 1000


class AxisSpec(SpecModel):
    """One thing that is varied: a key of the scenario with its values, or named levels with their overrides."""

    alternatives: ClassVar = (("values", "levels"),)

    label: str = Field("", description="What is varied and in which unit, for tables and figures")
    key: str | None = Field(None, description="The dotted key that takes the values")
    values: tuple[float, ...] | None = Field(None, min_length=2, description="Numbers; the first is the reference")
    levels: dict[str, Mapping[str, PlainValue]] | None = Field(
        None, min_length=2, description="Overrides by the name of the level; the first is the reference"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.key is None) != (self.values is None):
            raise ValueError("values belong to a key: give both, or levels with their overrides")
        if len(set(self.overrides)) < len(self.values or ()):
            raise ValueError("values must differ in their first six digits")
        wrong = [name for name in self.overrides if not _NAME.fullmatch(name)]
        if wrong:
            raise ValueError(f"the level {wrong[0]!r} may hold small letters, digits and . _ - alone")
        return self

    @property
    def overrides(self) -> dict[str, Mapping[str, JsonValue]]:
        """What each level overrides, by its name; a value's name is the value in six digits."""
        if self.levels is not None:
            return self.levels
        named = {f"{value:g}".replace("+", ""): value for value in self.values or ()}
        return {name: {str(self.key): value} for name, value in named.items()}


class GridSpec(SpecModel):
    """Axes and a design over them.

    ``full`` runs every combination. ``one-at-a-time`` runs the reference, all axes at their first level, and each
    other level of each axis by itself. ``two-level`` runs a fraction of the combinations of the first and the last
    level of every axis in which no main effect is mixed up with another or with an effect of two axes (resolution IV).
    """

    design: Literal["full", "one-at-a-time", "two-level"] = "full"
    axes: dict[str, AxisSpec] = Field(min_length=1, description="What is varied, by name")

    @model_validator(mode="after")
    def _check(self) -> Self:
        wrong = [name for name in self.axes if not _NAME.fullmatch(name)]
        if wrong:
            raise ValueError(f"the axis {wrong[0]!r} may hold small letters, digits and . _ - alone")
        size = 1
        for axis in self.axes.values():
            size *= len(axis.overrides)
        if self.design == "full" and size > MOST_SCENARIOS:
            raise ValueError(f"{size} combinations are too many; a campaign has {MOST_SCENARIOS} scenarios at most")
        return self
