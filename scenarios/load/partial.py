"""Sections that are given in part, laid on the sections that stand there by default."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenarios.load.merge import Models, submodels
from scenarios.spec.base import SpecModel

Plain = dict[str, Any]


def on_defaults(models: Models, given: Mapping[str, Any]) -> Plain:
    """Lay the sections of a plain mapping on those that its model's fields have by default, at every depth.

    ``craters: {roughness: {rms_m: 8}}`` keeps the other keys of the roughness that craters have by default, which need
    not be those that the model of roughness has by itself.

    Parameters
    ----------
    models
        The models that the mapping may be of; the one that its ``kind`` or its keys say is taken.
    given
        What a file, ``--set`` or a campaign says.
    """
    model = _meant(models, given)
    if model is None:
        return dict(given)
    result = dict(given)
    for key, field in model.model_fields.items():
        value = given.get(key)
        if not isinstance(value, Mapping):
            continue
        if isinstance(field.default, SpecModel):
            value = _laid_on(field.default, value)
        result[key] = on_defaults(submodels(field.annotation), value)
    return result


def _meant(models: Models, given: Mapping[str, Any]) -> type[SpecModel] | None:
    """Return the model that a mapping is of; None where none or several fit."""
    fitting = [model for model in models if not given or set(given) & set(model.model_fields)]
    if "kind" in given:
        fitting = [model for model in fitting if _admits(model, given["kind"])]
    return fitting[0] if len(fitting) == 1 else None


def _admits(model: type[SpecModel], kind: object) -> bool:
    field = model.model_fields.get("kind")
    return field is not None and repr(kind) in repr(field.annotation)


def _laid_on(default: SpecModel, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Complete a section by the keys that its default states; another kind or form replaces the default whole."""
    fields, kind = type(default).model_fields, getattr(default, "kind", None)
    if (given and not set(given) & set(fields)) or given.get("kind", kind) != kind:
        return given
    chosen = {key for key, value in given.items() if value is not None}
    displaced = {key for group in default.alternatives if set(group) & chosen for key in group}
    own = {key for key, field in fields.items() if key == "kind" or getattr(default, key) != field.get_default()}
    deeper = {
        key: _laid_on(getattr(default, key), value)
        for key, value in given.items()
        if isinstance(value, Mapping) and isinstance(getattr(default, key, None), SpecModel)
    }
    return {**default.model_dump(mode="json", include=own - displaced), **given, **deeper}
