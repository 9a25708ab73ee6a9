"""The canonical form of a specification, and its hash."""

from __future__ import annotations

import hashlib
import json

from scenarios.spec.base import SpecModel


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
