"""The base of every model of the schema."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from itertools import combinations
from typing import Annotated, Any, ClassVar, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, JsonValue, model_validator


def _describe_alternatives(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Tell the JSON Schema which keys exclude each other."""
    groups = model.alternatives if issubclass(model, SpecModel) else ()
    if groups:
        schema["allOf"] = [{"not": {"required": list(pair)}} for keys in groups for pair in combinations(keys, 2)]


def _finite(value: object) -> object:
    """Refuse NaN and infinities anywhere in a plain value: no canonical form has them."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    for item in value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ():
        _finite(item)
    return value


PlainValue = Annotated[JsonValue, AfterValidator(_finite)]
"""Whatever a file may hold where the schema leaves it open, but for numbers that are not finite."""


def is_none(value: object) -> bool:
    """Tell a key that is not given, for keys that digests leave out then: what lacks them is the same as ever."""
    return value is None


class SpecModel(BaseModel):
    """Frozen; unknown keys and non-finite numbers are refused.

    A model names in ``alternatives`` the groups of keys of which exactly one is given. Where one file builds
    on another, a key of such a group takes the place of the others (see ``scenarios.load.merge``).
    ``prose`` names the keys that no result depends on, ``own`` those that a file never takes from another.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        validate_default=True,
        json_schema_extra=_describe_alternatives,
    )

    alternatives: ClassVar[tuple[tuple[str, ...], ...]] = ()
    prose: ClassVar[frozenset[str]] = frozenset()
    own: ClassVar[frozenset[str]] = frozenset()

    @model_validator(mode="after")
    def _exactly_one_of_each_group(self) -> Self:
        for keys in type(self).alternatives:
            given = [key for key in keys if getattr(self, key) is not None]
            if not given:
                raise ValueError(f"give either {' or '.join(keys)}")
            if len(given) > 1:
                raise ValueError(f"give either {' or '.join(keys)}, not both")
        return self


def canonical_json(spec: SpecModel) -> str:
    """Return the whole specification, defaults filled in, as JSON with sorted keys."""
    return _dump(spec.model_dump(mode="json", by_alias=True))


def digest(spec: SpecModel) -> str:
    """Return the SHA-256 of what results depend on: the canonical form without names and descriptions."""
    text = _dump(_without_prose(spec))
    return hashlib.sha256(text.encode()).hexdigest()


def _dump(value: object) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _without_prose(spec: SpecModel) -> dict[str, object]:
    kept: dict[str, object] = spec.model_dump(mode="json", by_alias=True, exclude=set(spec.prose))
    for key in type(spec).model_fields:
        value = getattr(spec, key)
        if isinstance(value, SpecModel) and key in kept:
            kept[key] = _without_prose(value)
    return kept
