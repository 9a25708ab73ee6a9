"""Base class of the schema's models, their fields that may be left out, canonical JSON form and digest."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from functools import wraps
from itertools import combinations
from typing import Annotated, Any, ClassVar, Self, TypeVar, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo


def _describe_alternatives(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Add mutually exclusive keys to the JSON Schema."""
    if issubclass(model, SpecModel) and (groups := model.alternatives):
        schema["allOf"] = [{"not": {"required": list(pair)}} for keys in groups for pair in combinations(keys, 2)]
        if model.no_default:
            schema["allOf"] += [{"anyOf": [{"required": [key]} for key in keys]} for keys in groups]


def _finite(value: object) -> object:
    """Raise ValueError for NaN or infinity anywhere in a plain value; canonical JSON cannot represent them."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    for item in value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ():
        _finite(item)
    return value


PlainValue = Annotated[JsonValue, AfterValidator(_finite)]
"""Any JSON value with finite numbers, for keys whose type the schema leaves open."""


def optional(description: str, default: object = None, **bounds: Any) -> Any:
    """Describe a field that is None, or a default, and no part of the digest, where it is left out."""
    return Field(default, exclude_if=lambda value: value == default, description=description, **bounds)


Model = TypeVar("Model", bound=BaseModel)


def rule(check: Callable[[Model], None]) -> Any:
    """Run a method after a model is validated; it raises ValueError for keys that do not go together."""

    @wraps(check)
    def checked(self: Model) -> Model:
        check(self)
        return self

    return model_validator(mode="after")(checked)


def deviation(default: float | None, of: str, **bounds: Any) -> Any:
    """Describe a field with the standard deviation of something."""
    return Field(default, description=f"Standard deviation of {of}", **bounds)


LEFT_OUT = "left_out"
"""Key of the JSON Schema of a field: what its value follows from."""


def length(
    default_m: float,
    description: str,
    *,
    px: float | None = None,
    body: float | None = None,
    gt: float | None = None,
    ge: float | None = None,
) -> Any:
    """Describe a field with a length, m, that follows from the scenario where a file leaves it out.

    It is then ``px`` pixels at the median range of the images, or ``body`` of the longest side of the body's box; of
    both the smaller. Without a scenario, in a model that is made in Python, it is ``default_m``.
    """
    share = {unit: amount for unit, amount in (("px", px), ("body", body)) if amount is not None}
    extra: dict[str, Any] = {LEFT_OUT: share}
    words = {"px": "{:g} px at the median range", "body": "{:g} of the body's length"}
    amounts = [words[unit].format(amount) for unit, amount in share.items()]
    left_out = f"{description}; left out: {' or '.join(amounts)}{', the smaller' if len(amounts) > 1 else ''}"
    return Field(default_m, description=left_out, json_schema_extra=extra, gt=gt, ge=ge)


def number(default: int, description: str, *, each_px2: float, ge: int, le: int) -> Any:
    """Describe a field with a number of features in an image that follows from the scenario where a file leaves it out.

    It is then so many times the default as the body's area in the image has ``each_px2``, rounded; the default at
    least, and where there is no scenario.
    """
    left_out = f"{description}; left out: {default} for each {each_px2:g} px^2 of the body, {default} at least"
    extra: dict[str, Any] = {LEFT_OUT: {"each_px2": each_px2, "most": le}}
    return Field(default, description=left_out, json_schema_extra=extra, ge=ge, le=le)


def rule_of(field: FieldInfo) -> dict[str, float] | None:
    """Return the rule of a value that is left out, by ``px``, ``body`` or both, or by ``each_px2``; else None."""
    extra = field.json_schema_extra
    return cast("dict[str, float] | None", extra.get(LEFT_OUT)) if isinstance(extra, dict) else None


class SpecModel(BaseModel):
    """Base of all models: frozen; unknown keys and non-finite numbers are errors.

    ``alternatives`` are groups of keys of which exactly one must be given, or at most one if one of them has a default.
    If a file extends another, a key of such a group replaces the others (see ``scenarios.load.merge``); with
    ``no_default`` a file that extends none must give one itself. ``prose`` are keys that results do not depend on,
    ``own`` those that a file does not inherit.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        validate_default=True,
        json_schema_extra=_describe_alternatives,
    )

    alternatives: ClassVar[tuple[tuple[str, ...], ...]] = ()
    no_default: ClassVar[bool] = False
    prose: ClassVar[frozenset[str]] = frozenset()
    own: ClassVar[frozenset[str]] = frozenset()

    @model_validator(mode="after")
    def _exactly_one_of_each_group(self) -> Self:
        for keys in type(self).alternatives:
            given = self._given(keys)
            if not given and all(getattr(self, key) is None for key in keys):
                told = (f"{key}: {type(self).model_fields[key].description}" for key in keys)
                raise ValueError(f"give either {' or '.join(keys)} ({'; '.join(told)})")
            if len(given) > 1:
                raise ValueError(f"give either {' or '.join(given)}, not both")
        return self

    def stated(self, *keys: str) -> list[str]:
        """Return which of some keys, by default of all, are not as they are where a file leaves them out.

        Lengths and numbers in sections are not compared if they follow from the scenario where a file leaves them out.
        """
        fields = type(self).model_fields
        return [key for key in keys or fields if _differ(getattr(self, key), fields[key].default)]

    def _given(self, keys: tuple[str, ...]) -> list[str]:
        return [key for key in keys if key in self.model_fields_set and getattr(self, key) is not None]


def _differ(value: object, default: object) -> bool:
    if not isinstance(value, SpecModel) or type(value) is not type(default):
        return value != default
    fields = type(value).model_fields.items()
    return any(_differ(getattr(value, key), getattr(default, key)) for key, field in fields if rule_of(field) is None)


class WithDefaultAlternative(SpecModel):
    """Section with a group of alternatives of which one has a default; that one is not part of it beside another."""

    @model_serializer(mode="wrap")
    def _without_the_displaced(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        plain: dict[str, Any] = dump(self)
        for keys in type(self).alternatives:
            if given := self._given(keys):
                plain = {key: value for key, value in plain.items() if value is None or key not in {*keys} - {*given}}
        return plain


def canonical_json(spec: SpecModel) -> str:
    """Return the whole specification, defaults filled in, as JSON with sorted keys."""
    return _dump(spec.model_dump(mode="json", by_alias=True))


def digest(spec: SpecModel) -> str:
    """Return the SHA-256 of the canonical form without names and descriptions, which results do not depend on."""
    # Canonical: sorted keys and no white space, so that equal specifications have equal digests.
    text = _dump(_without_texts(spec))
    return hashlib.sha256(text.encode()).hexdigest()


def _dump(value: object) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _without_texts(spec: SpecModel) -> dict[str, object]:
    kept: dict[str, object] = spec.model_dump(mode="json", by_alias=True, exclude=set(spec.prose))
    for key in type(spec).model_fields:
        value = getattr(spec, key)
        if isinstance(value, SpecModel) and key in kept:
            kept[key] = _without_texts(value)
    return kept
