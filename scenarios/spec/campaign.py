"""The campaign: scenarios x estimators x trials from one seed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, ClassVar, Self

from pydantic import BeforeValidator, Field, JsonValue, model_validator

from scenarios.spec.base import PlainValue, SpecModel
from scenarios.spec.grid import GridSpec
from scenarios.spec.scenario import NAME_PATTERN

_LABEL = r"^[A-Za-z0-9][A-Za-z0-9._+-]*$"


class EstimatorSpec(SpecModel):
    """An estimator with its options, under a label of its own in every table.

    A campaign writes the name alone, ``prior``, or the name with options, ``{landmark-harris: {images: 200}}``.
    The option ``label`` tells apart two entries of the same estimator; it is the name by default.
    """

    name: str = Field(pattern=_LABEL)
    label: str = Field(pattern=_LABEL)
    options: Mapping[str, PlainValue] = Field(default_factory=dict)


def _read_estimator(value: object) -> EstimatorSpec:
    """Turn ``name`` or ``{name: {option: value}}`` into an entry."""
    if isinstance(value, EstimatorSpec):
        return value
    if isinstance(value, str):
        value = {value: {}}
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError("write an estimator as its name, or as {name: {option: value}}")
    ((name, options),) = value.items()
    options = {} if options is None else options
    if not re.fullmatch(_LABEL, name) or not isinstance(options, dict):
        raise ValueError(f"the options of {name!r} are not a mapping: write {{name: {{option: value}}}}")
    label = options.get("label", name)
    if not re.fullmatch(_LABEL, str(label)):
        raise ValueError(f"the label {label!r} of {name} may hold letters, digits and . _ + - alone")
    return EstimatorSpec(
        name=name, label=str(label), options={key: option for key, option in options.items() if key != "label"}
    )


EstimatorEntry = Annotated[
    EstimatorSpec,
    BeforeValidator(_read_estimator, json_schema_input_type=str | dict[str, dict[str, JsonValue] | None]),
]


class CampaignSpec(SpecModel):
    """What a campaign file says."""

    prose: ClassVar = frozenset({"name", "title", "description", "report"})
    own: ClassVar = frozenset({"name", "title", "description"})

    name: str = Field(pattern=NAME_PATTERN, description="Lower case; the file's name if left out")
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
        " are craters, with another world of them, which is all that detection of craters has; trial t has data base"
        " t modulo their number",
    )
    report: str | None = Field(None, description="Key of the published values to set beside the results")

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        for key, values in (("scenarios", self.scenarios), ("labels", tuple(e.label for e in self.estimators))):
            twice = sorted({value for value in values if values.count(value) > 1})
            if twice:
                hint = "; give an estimator that appears twice a label" if key == "labels" else ""
                raise ValueError(f"{key} must differ, but {', '.join(twice)} appears twice{hint}")
        return self
