"""JSON Schema of scenario and campaign files, for completion and checks in editors."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, Literal

from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import CampaignSpec
from boresight.scenarios.spec.length import LEFT_OUT
from boresight.scenarios.spec.scenario import ScenarioSpec

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
