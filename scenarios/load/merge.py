"""Merge configuration entries: files over files, overrides over files, sections over defaults."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from typing import Any, Literal, cast, get_args, get_origin

from boresight.scenarios.errors import BoresightError, printable
from boresight.scenarios.load.yaml_text import ConfigEntry, entry_of, nested, parse_yaml
from boresight.scenarios.spec.base import SpecModel

Models = tuple[type[SpecModel], ...]

Plain = dict[str, Any]


def on_defaults(models: Models, given: Mapping[str, Any]) -> Plain:
    """Merge the sections of a plain mapping over the defaults of its model's fields, at every depth.

    ``craters: {roughness: {rms_m: 8}}`` keeps the other keys of the default roughness of craters, which may differ from
    the defaults of the roughness model itself. The ``kind`` or the keys of the mapping select one of the models.
    """
    model = meant_model(models, given)
    if model is None:
        return dict(given)
    result = dict(given)
    for key, value in given.items():
        if isinstance(value, Mapping) and key in model.model_fields:
            allowed, default = field_models((model,), key), model.model_fields[key].default
            # A default with none of the given keys is of another form.
            if isinstance(default, SpecModel) and (not value or value.keys() & type(default).model_fields.keys()):
                value = cast("Plain", merge(entry_of(_own(default), ""), entry_of(value, ""), allowed).plain())
            result[key] = on_defaults(allowed, value)
    return result


def meant_model(models: Models, given: Mapping[str, Any]) -> type[SpecModel] | None:
    """Return the model of a mapping; None if none or several fit."""
    fitting = [model for model in models if not given or set(given) & set(model.model_fields)]
    if "kind" in given:
        kinds = [(model, model.model_fields.get("kind")) for model in fitting]
        fitting = [model for model, kind in kinds if kind and repr(given["kind"]) in repr(kind.annotation)]
    return fitting[0] if len(fitting) == 1 else None


def _own(default: SpecModel) -> Plain:
    """Return what a default section adds to the defaults of its model."""
    fields = type(default).model_fields
    given = default.model_fields_set | ({"kind"} & fields.keys())
    own = {key for key in given if key == "kind" or getattr(default, key) != fields[key].get_default()}
    return default.model_dump(mode="json", include=own)


def parse_override(text: str, place: str = "") -> ConfigEntry:
    """Parse ``key.key=value`` with a YAML value; ``place`` is the location for errors, by default the text.

    Raise BoresightError if it does not have that form.
    """
    place = place or f"--set {printable(text)}"
    dotted, equals, value = text.partition("=")
    if not equals or not all(key.strip() for key in dotted.split(".")):
        raise BoresightError(f"{place}: write it as key=value, for example --set camera.fov_deg=20")
    return nested([key.strip() for key in dotted.split(".")], parse_yaml(value, place, place=place))


def settings(value: ConfigEntry | Mapping[str, object], models: Models) -> ConfigEntry:
    """Read a section of overrides whose keys may be dotted: ``{camera.fov_deg: 20, camera: {width_px: 256}}``."""
    entry = value if isinstance(value, ConfigEntry) else entry_of(value, "set")
    layers = [nested(dotted.split("."), item) for dotted, item in (entry.section or {}).items()]
    return apply(ConfigEntry({}, entry.place), layers, models)


def apply(base: ConfigEntry, layers: list[ConfigEntry], models: Models) -> ConfigEntry:
    """Merge layers in order over ``base``, keeping its location.

    Raise BoresightError if a layer replaces a key of two groups of alternatives by one of the first group, and no layer
    gives one of the second group, which would fall back to its default.
    """
    stages = [base]
    for layer in layers:
        stages.append(ConfigEntry(merge(stages[-1], layer, models).value, base.place))
    for before, after in pairwise(stages):
        _refuse_loss(before, after, stages[-1], models)
    return stages[-1]


def _refuse_loss(
    before: ConfigEntry, after: ConfigEntry, final: ConfigEntry, models: Models, path: tuple[str, ...] = ()
) -> None:
    """Raise BoresightError if a key of one group of alternatives empties another between two stages, for good."""
    if before.section is None or after.section is None or final.section is None:
        return
    groups = [group for model in models for group in model.alternatives]
    for lost in sorted(before.section.keys() - after.section.keys()):
        own = [group for group in groups if lost in group and before.section[lost].value is not None]
        by = next((key for group in own for key in group if key in after.section), None)
        for group in own:
            if by is not None and by not in group and not {*group} & {*final.section}:
                others = ", ".join(key for key in group if key != lost)
                raise BoresightError(
                    f"{after.section[by].place}: {'.'.join((*path, by))} replaces {lost}:"
                    f" give {' or '.join(others.rsplit(', ', 1))} too, or change {lost} instead"
                )
    for key in before.section.keys() & after.section.keys() & final.section.keys():
        entries = (before.section[key], after.section[key], final.section[key])
        _refuse_loss(*entries, field_models(models, key), (*path, key))


def submodels(annotation: object) -> Models:
    """Return the models that a field's annotation allows, through unions and Annotated but not through lists."""
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        return (annotation,)
    origin = get_origin(annotation)
    if origin in (tuple, list, dict, Literal):
        return ()
    return tuple(model for part in get_args(annotation) for model in submodels(part))


@cache
def field_models(models: Models, key: str) -> Models:
    """Return the models that ``key`` allows in any of ``models``."""
    fields = [model.model_fields[key] for model in models if key in model.model_fields]
    return tuple(model for field in fields for model in submodels(field.annotation))


def merge(base: ConfigEntry, over: ConfigEntry, models: Models) -> ConfigEntry:
    """Merge ``over`` into ``base``, two entries for the same key; ``models`` are those that the schema allows there.

    Mappings are merged key by key; lists and scalars are replaced. Two rules remove keys that no longer apply:

    - a section with another ``kind``, or another form of a distribution, replaces the whole section;
    - a key of a group of alternatives (``focal_px`` for ``fov_deg``) removes the others of its group.
    """
    if base.section is None or over.section is None or _is_other_form(base, over, models):
        return over
    chosen = {key for key, entry in over.section.items() if entry.value is not None}
    groups = [set(group) for model in models for group in model.alternatives]
    displaced = {key for group in groups if group & chosen for key in group - chosen}
    merged = {key: entry for key, entry in base.section.items() if key not in displaced}
    for key, entry in over.section.items():
        merged[key] = merge(merged[key], entry, field_models(models, key)) if key in merged else entry
    return ConfigEntry(merged, over.place)


def _is_other_form(base: ConfigEntry, over: ConfigEntry, models: Models) -> bool:
    old, new = base.section or {}, over.section or {}
    kinds = [model.model_fields["kind"].default for model in models if "kind" in model.model_fields]
    if kinds:
        default = next((kind for kind in kinds if isinstance(kind, str)), None)
        old_kind = old["kind"].value if "kind" in old else default
        return "kind" in new and new["kind"].value != old_kind
    # Two forms of a distribution have no key in common.
    return len(models) > 1 and bool(new) and not set(old) & set(new)
