"""One file on top of another: mappings merge, anything else replaces."""

from __future__ import annotations

from typing import Literal, get_args, get_origin

from scenarios.load.entry import Entry
from scenarios.spec.base import SpecModel

Models = tuple[type[SpecModel], ...]


def submodels(annotation: object) -> Models:
    """Return the models that a field's annotation admits, through unions and Annotated but not through lists."""
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        return (annotation,)
    origin = get_origin(annotation)
    if origin in (tuple, list, dict, Literal):
        return ()
    return tuple(model for part in get_args(annotation) for model in submodels(part))


def field_models(models: Models, key: str) -> Models:
    """Return the models that ``key`` admits in any of ``models``."""
    fields = [model.model_fields[key] for model in models if key in model.model_fields]
    return tuple(model for field in fields for model in submodels(field.annotation))


def merge(base: Entry, over: Entry, models: Models) -> Entry:
    """Lay ``over`` on ``base``.

    Mappings merge key by key, lists and scalars replace. Where ``over`` says something else altogether,
    nothing stale stays behind:

    - a section whose ``kind`` changes, or that picks another form of a distribution, replaces the whole;
    - a key of a group of alternatives (``focal_px`` for ``fov_deg``) displaces the others of its group.

    Parameters
    ----------
    base, over
        Two entries for the same key.
    models
        The models that this key admits; empty where the schema says nothing.
    """
    if base.section is None or over.section is None or _is_other_form(base, over, models):
        return over
    displaced = _displaced(over, models)
    merged = {key: entry for key, entry in base.section.items() if key not in displaced}
    for key, entry in over.section.items():
        merged[key] = merge(merged[key], entry, field_models(models, key)) if key in merged else entry
    return Entry(merged, over.place)


def _is_other_form(base: Entry, over: Entry, models: Models) -> bool:
    old, new = base.section or {}, over.section or {}
    kinds = [model.model_fields["kind"].default for model in models if "kind" in model.model_fields]
    if kinds:
        default = next((kind for kind in kinds if isinstance(kind, str)), None)
        old_kind = old["kind"].value if "kind" in old else default
        return "kind" in new and new["kind"].value != old_kind
    return len(models) > 1 and bool(new) and not set(old) & set(new)


def _displaced(over: Entry, models: Models) -> set[str]:
    chosen = {key for key, entry in (over.section or {}).items() if entry.value is not None}
    groups = [set(group) for model in models for group in model.alternatives]
    return {key for group in groups if group & chosen for key in group - chosen}
