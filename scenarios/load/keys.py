"""Keys of a model in words, for the reference and the terminal, and as JSON Schema, for editors."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import groupby
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BeforeValidator, TypeAdapter
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from boresight.scenarios.load.explain import bounds_of, interval
from boresight.scenarios.load.merge import Models
from boresight.scenarios.spec.base import LEFT_OUT, SpecModel, rule_of
from boresight.scenarios.spec.campaign import CampaignSpec
from boresight.scenarios.spec.distribution import Law
from boresight.scenarios.spec.scenario import ScenarioSpec
from boresight.scenarios.spec.vectors import Law3

# The ends of names, longest first, so that `_m_s2` is not taken for `_s2`.
_UNITS = {
    "_m2_kg": "m²/kg", "_m3_s2": "m³/s²", "_m_s2": "m/s²", "_m_s": "m/s", "_per_deg3": "1/deg³", "_per_deg2": "1/deg²",
    "_per_deg": "1/deg", "_e_per_s": "electrons/s", "_e_per_dn": "electrons/DN", "_px2": "px²", "_px": "px",
    "_urad": "µrad", "_rad": "rad", "_deg": "deg", "_km": "km", "_m": "m", "_s": "s", "_h": "h", "_days": "days",
    "_au": "au", "_dn": "DN", "_e": "electrons",
}  # fmt: skip
_PLAIN = {float: "number", int: "whole number", bool: "true or false", str: "text"}


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a file in words, named as a file writes it, without its section.

    ``type`` has the range of a number, ``unit`` is '' without one, ``default`` is as YAML writes it and None for a
    required key, ``meaning`` has no full stop. ``sections`` are models of the section that it holds: none for a plain
    value, several for alternatives.
    """

    name: str
    type: str
    unit: str
    default: str | None
    meaning: str
    sections: Models


def keys_of(model: type[SpecModel]) -> tuple[Key, ...]:
    """Return the keys of a model in their order."""
    return tuple(_key(name, field, model) for name, field in model.model_fields.items())


def unit_of_key(name: str) -> str:
    """Return the unit that the end of a key's name says, '' if it says none."""
    name = f"_{name}".removesuffix("_max").removesuffix("_min")
    return next((unit for end, unit in _UNITS.items() if name.endswith(end) and (name != end or end == "_days")), "")


def words_of(thing: type) -> str:
    """Return a docstring as plain text; empty if there is none of its own."""
    return inspect.cleandoc(thing.__doc__ or "")


def _key(name: str, field: FieldInfo, model: type[SpecModel]) -> Key:
    sections, told, written = _sections(field.annotation), field.description, field.alias or name
    if not told and len(sections) == 1:
        told = words_of(sections[0]).split("\n\n")[0].replace("\n", " ")
    default = _default(field)
    return Key(
        written,
        _type(field.annotation, interval(bounds_of(field)), field.metadata),
        unit_of_key(written) if _numeric(field.annotation) else "",
        "the name of the file" if default is None and name in model.own else default,
        (told or "").removesuffix("."),
        sections,
    )


def _law(annotation: Any) -> bool:
    """Return whether an annotation is the model of a distribution: a value in a file, not a section."""
    return isinstance(annotation, type) and issubclass(annotation, Law | Law3)


def _sections(annotation: Any) -> Models:
    """Return the models of the sections that an annotation allows, in lists and by names too."""
    if get_origin(annotation) is Annotated and _input_type(get_args(annotation)[1:]) is not None:
        return ()
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        return () if _law(annotation) else (annotation,)
    return tuple(dict.fromkeys(model for part in get_args(annotation) for model in _sections(part)))


def _input_type(metadata: Sequence[Any]) -> Any:
    """Return what a file may write in place of the annotated type; None if just that."""
    return next((one.json_schema_input_type for one in metadata if isinstance(one, BeforeValidator)), None)


def _numeric(annotation: Any) -> bool:
    """Return whether an annotation contains a number."""
    return annotation in (float, int) or _law(annotation) or any(_numeric(part) for part in get_args(annotation))


def _type(annotation: Any, bounds: str = "", metadata: Sequence[Any] = ()) -> str:
    """Return a type in words; ``bounds`` are of the number in it."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        ours = FieldInfo.from_annotation(annotation)
        return _type(parts[0], bounds or interval(bounds_of(ours)), parts[1:])
    if _input_type(metadata) is not None:
        return _type(_input_type(metadata))
    if origin is Literal:
        return _either([str(part) for part in parts])
    if origin in (Union, UnionType):
        told = [_type(part, bounds) for part in parts if part is not NoneType]
        if any("{choice:" in one for one in told):  # every law of a number, which the reference lists once
            told = [*(one for one in told if not one.startswith("{")), "distribution"]
        return _either(list(dict.fromkeys(told)))
    if origin in (tuple, list):
        return _list(parts, bounds)
    if annotation in _PLAIN:
        return f"{_PLAIN[annotation]} {bounds}".strip()
    if _law(annotation):
        return words_of(annotation).split("``")[1]
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        return "section"
    if isinstance(origin or annotation, type) and issubclass(origin or annotation, Mapping):
        return "section of names"
    return "any value"


def _list(parts: tuple[Any, ...], bounds: str) -> str:
    """Return the type of a list in words: ``list of 2 numbers``."""
    if parts[-1] is Ellipsis:
        return f"list of {_plural(_type(parts[0], bounds))}"
    told = [_type(part, bounds) for part in parts]
    runs = [(one, len(list(same))) for one, same in groupby(told)]
    return "list of " + " and ".join(f"{count} {_plural(one)}" if count > 1 else f"a {one}" for one, count in runs)


def _plural(one: str) -> str:
    """Return ``numbers in [0, 1]`` for ``number in [0, 1]``."""
    word = next((word for word in ("whole number", "number", "text", "section", "list") if one.startswith(word)), "")
    return one.replace(word, f"{word}s", 1) if word else one


def _either(told: list[str]) -> str:
    return told[0] if len(told) == 1 else f"{', '.join(told[:-1])} or {told[-1]}"


def _default(field: FieldInfo) -> str | None:
    """Return the default as YAML writes it; of a section only what differs from the defaults of its keys."""
    if rule_of(field) is not None:
        return "left out"
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        return None
    if isinstance(value, SpecModel):
        fields = type(value).model_fields
        changed = {key for key in fields if getattr(value, key) != fields[key].get_default(call_default_factory=True)}
        shown = value.model_dump(mode="json", include=changed | ({"kind"} & set(fields)))
        return as_yaml(shown) if shown else "the defaults of its keys"
    return "left out" if value is None else as_yaml(TypeAdapter(object).dump_python(value, mode="json"))


def as_yaml(value: object) -> str:
    """Write a plain value as YAML in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {as_yaml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_yaml, value)) + "]"
    if isinstance(value, float):
        whole = value.is_integer() and abs(value) < 1e9
        return f"{value:.0f}" if whole else f"{value:.6g}"
    return value or "''" if isinstance(value, str) else json.dumps(value)


DIALECT = "https://json-schema.org/draft/2020-12/schema"
_MODELS: Mapping[str, type[SpecModel]] = {"scenario": ScenarioSpec, "campaign": CampaignSpec}
_PART = "Part"
_EXTENDS = {
    "description": "Files that this one builds on: names of the catalogue or paths from this file, the first lowest",
    "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
}


def json_schema(kind: Literal["scenario", "campaign"]) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a scenario or campaign file.

    A file that extends another may omit any key, so that only types are checked; a file without ``extends`` must
    contain the required keys as well.
    """
    model = _MODELS[kind]
    whole = model.model_json_schema(by_alias=True)
    definitions: dict[str, Any] = whole.pop("$defs", {})
    for definition in definitions.values():
        for key in definition.get("properties", {}).values():
            if LEFT_OUT in key:  # the length follows from the scenario: its default is no number
                del key["default"]
    whole["properties"]["extends"] = _EXTENDS
    filled = {"name", *(key for key, field in model.model_fields.items() if isinstance(field.default, SpecModel))}
    whole["required"] = [key for key in whole.get("required", []) if key not in filled]
    definitions[model.__name__] = whole
    parts = {name + _PART: _as_part(definition) for name, definition in definitions.items()}
    return {
        "$schema": DIALECT,
        "title": f"boresight {kind}",
        "$ref": f"#/$defs/{model.__name__}{_PART}",
        "if": {"not": {"required": ["extends"]}},
        "then": {"$ref": f"#/$defs/{model.__name__}"},
        "$defs": {**definitions, **parts},
    }


def _as_part(node: Any) -> Any:
    """Copy a schema without its required keys; references point to partial definitions."""
    if isinstance(node, list):
        return [_as_part(item) for item in node]
    if not isinstance(node, Mapping):
        return deepcopy(node)
    part = {key: _as_part(value) for key, value in node.items() if key not in {"required", "discriminator", "not"}}
    if isinstance(node.get("not"), Mapping):
        # Mutually exclusive keys are expressed as "not required together", which applies to partial files too.
        part["not"] = deepcopy(node["not"])
    if isinstance(part.get("$ref"), str):
        part["$ref"] += _PART
    if "oneOf" in part:
        part["anyOf"] = part.pop("oneOf")
    return part
