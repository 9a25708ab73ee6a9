"""Validation errors as one line each: location, key, value and what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from boresight.scenarios.errors import printable
from boresight.scenarios.load.merge import Models, field_models
from boresight.scenarios.load.yaml_text import ConfigEntry, describe
from boresight.scenarios.spec.base import SpecModel

_TAG = "<tag>"
_BOUNDS = ("gt", "ge", "lt", "le")
_WANTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "string_type": "a text (quote it)",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list",
    "dict_type": "a section of keys",
    "model_type": "a section of keys",
    "mapping_type": "a section of keys",
}


@dataclass(frozen=True, slots=True)
class _ErrorLocation:
    """Location of a validation error: dotted key, deepest existing entry, and schema there."""

    key: str
    entry: ConfigEntry
    parent: Models
    field: FieldInfo | None


def explain(error: ValidationError, root: ConfigEntry, model: type[SpecModel], section: str = "") -> str:
    """Convert pydantic's errors to lines ``place: key: value is not ...``, without duplicates.

    ``section`` is the dotted key of ``root`` in its file.
    """
    lines = [_line(detail, root, model, section) for detail in error.errors(include_url=False)]
    return "\n".join(dict.fromkeys(lines))


def _line(detail: ErrorDetails, root: ConfigEntry, model: type[SpecModel], section: str) -> str:
    loc = detail["loc"]
    if detail["type"] in {"union_tag_invalid", "union_tag_not_found"}:
        loc = (*loc, _TAG, "kind")
    spot = _locate(loc, root, model)
    what = _what(detail, spot)
    key = ".".join(filter(None, (section, spot.key)))
    return printable(f"{spot.entry.place}: {key}: {what}" if key else f"{spot.entry.place}: {what}")


def _locate(loc: tuple[int | str, ...], root: ConfigEntry, model: type[SpecModel]) -> _ErrorLocation:
    """Follow ``loc`` through entries and schema; if several models are allowed, the next step is their tag."""
    keys: list[str] = []
    entry = root
    models: Models = (model,)
    parent: Models = models
    field: FieldInfo | None = None
    for step in loc:
        if isinstance(step, int) and not isinstance(entry.value, tuple):
            continue  # one value where a list of them may be
        if len(models) > 1 and not isinstance(step, int):
            tags = [(one, one.model_fields.get("kind")) for one in models]
            admitted = [one for one, kind in tags if step in (get_args(kind.annotation) if kind else one.model_fields)]
            models = models[:1] if step == _TAG else tuple(admitted[:1])
            continue
        if isinstance(step, str) and not models:
            value = entry.value
            if not isinstance(value, Mapping) or ("kind" in value and step not in value):
                continue  # the tag of a plain value, a number or a pair, or of a section in a list
        keys.append(f"[{step}]" if isinstance(step, int) else f".{step}")
        # The entry stays where the file does not contain the child.
        if isinstance(entry.value, Mapping):
            entry = entry.value.get(str(step), entry)
        elif isinstance(entry.value, tuple) and isinstance(step, int) and step < len(entry.value):
            entry = entry.value[step]
        if isinstance(step, str):
            parent = models
            field = next((model.model_fields[step] for model in models if step in model.model_fields), None)
            models = field_models(models, step)
    return _ErrorLocation("".join(keys).lstrip("."), entry, parent, field)


def _what(detail: ErrorDetails, spot: _ErrorLocation) -> str:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind == "missing" and isinstance(detail["loc"][-1], int):
        return "this value of the list is missing"
    if kind in {"missing", "union_tag_not_found"}:
        described = spot.field.description if spot.field is not None and kind == "missing" else None
        return f"this key is missing ({described})" if described else "this key is missing"
    if kind == "extra_forbidden":
        known = [field.alias or key for model in spot.parent for key, field in model.model_fields.items()]
        if not known:  # in a section of a list
            return "unknown key"
        near = difflib.get_close_matches(spot.key.rsplit(".", 1)[-1], known, n=1)
        return f"unknown key; did you mean {near[0]}?" if near else f"unknown key; known here are {', '.join(known)}"
    if kind == "value_error":
        return str(context["error"])
    if kind in {"too_short", "too_long"}:
        most = f"least {context['min_length']}" if kind == "too_short" else f"most {context['max_length']}"
        return f"has {context['actual_length']} values, not at {most}"
    return f"{describe(spot.entry)} {_fault(kind, context, spot.field, detail['msg'])}"


def _fault(kind: str, context: Mapping[str, Any], field: FieldInfo | None, message: str) -> str:
    """Return the predicate that follows the value in the message."""
    if kind == "union_tag_invalid":
        return f"is not one of {context['expected_tags']}"
    if kind == "literal_error":
        return f"is not {context['expected']}"
    if kind == "string_pattern_mismatch":
        return f"does not match {context['pattern']}"
    if kind == "no_law":
        return message
    if kind in _WANTED:
        return f"is not {_WANTED[kind]}"
    bounds = bounds_of(field)
    if not set(bounds) & set(context):
        bounds = {name: value for name, value in context.items() if name in _BOUNDS}
    return f"is not {interval(bounds)}" if bounds else f"is wrong: {message[:1].lower()}{message[1:]}"


def bounds_of(field: FieldInfo | None) -> dict[str, float]:
    """Return the bounds of a number, by ``gt``, ``ge``, ``lt`` and ``le``."""
    rules = field.metadata if field is not None else ()
    return {name: getattr(rule, name) for rule in rules for name in _BOUNDS if hasattr(rule, name)}


def interval(bounds: Mapping[str, float]) -> str:
    """Return bounds in words: ``in [0, 1)``, ``above 0``."""
    below, above = {"gt", "ge"} & set(bounds), {"lt", "le"} & set(bounds)
    if below and above:
        left = f"({bounds['gt']:g}" if "gt" in bounds else f"[{bounds['ge']:g}"
        right = f"{bounds['lt']:g})" if "lt" in bounds else f"{bounds['le']:g}]"
        return f"in {left}, {right}"
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    return " and ".join(f"{words[name]} {value:g}" for name, value in bounds.items())
