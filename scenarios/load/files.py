"""Load scenario and campaign files as validated specifications."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from pydantic import ValidationError

from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.load.entry import ConfigEntry, describe, entry_of
from boresight.scenarios.load.explain import explain
from boresight.scenarios.load.find import exists, find, name_of, names_in, read
from boresight.scenarios.load.lengths import lengths_left_out, scale_as_written, surface_m, with_lengths
from boresight.scenarios.load.merge import Plain, apply, on_defaults, parse_override, settings
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import CampaignSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

_MAX_GENERATIONS = 20
CATALOG = Path(__file__).parents[1] / "catalog"
Spec = TypeVar("Spec", bound=SpecModel)


@dataclass(frozen=True, slots=True)
class LoadedScenario:
    """A scenario, its file, and the folders that are searched for its data."""

    spec: ScenarioSpec
    path: Path
    search_dirs: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class LoadedCampaign:
    """A campaign, its file, and its keys with their locations."""

    spec: CampaignSpec
    path: Path
    root: ConfigEntry

    @property
    def overrides(self) -> ConfigEntry:
        """Overrides of every scenario; empty if there are none."""
        return (self.root.section or {}).get("set", ConfigEntry({}, self.root.place))

    def level(self, axis: str, name: str, overrides: Mapping[str, object]) -> ConfigEntry:
        """Return the overrides of a level of the grid with their locations."""
        section: Mapping[str, ConfigEntry] = self.root.section or {}
        for key in ("grid", "axes", axis):
            entry = section[key]
            section = entry.section or {}
        levels = section["levels"].section if "levels" in section else None
        return entry_of(overrides, entry.place) if levels is None else levels[name]

    def place_of(self, key: str, item: int | None = None) -> str:
        """Return the location of a key or of an item of its list, ``file:line``; the file alone if it is left out."""
        entry = (self.root.section or {}).get(key, self.root)
        return entry.value[item].place if item is not None and isinstance(entry.value, tuple) else entry.place


@dataclass(frozen=True, slots=True)
class _File:
    """A file merged over those that it extends; ``folders`` are its own folder, then those of its parents."""

    root: ConfigEntry
    folders: tuple[Path, ...]


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with boresight."""
    return names_in(CATALOG)


def load_scenario(
    name_or_path: str,
    overrides: Sequence[str | ConfigEntry] = (),
    *,
    base: ConfigEntry | Mapping[str, object] | None = None,
    levels: Sequence[ConfigEntry | Mapping[str, object]] = (),
    near: Path | None = None,
    embedded: bool = False,
) -> LoadedScenario:
    """Read a scenario: defaults < what it extends < the file < ``base`` < ``levels`` < ``overrides``.

    It is a name of the catalogue or the path of a YAML file, relative to ``near``. ``base`` are overrides by a
    campaign, ``levels`` those of its grid; their keys may be dotted. ``overrides`` are texts ``key.key=value``, as on
    the command line, or parsed entries. With ``embedded`` built-in bodies, in truth and on board, take the place of the
    shape files that they stand for, but for real images. Lengths that are left out and follow from the camera or the
    body are filled in. Raise BoresightError with one line for each fault: file, line, key, value and what is allowed.
    """
    path = find(name_or_path, CATALOG, near)
    file = _read_chain(path, CATALOG, ScenarioSpec)
    layers = [settings(base, (ScenarioSpec,))] if base is not None else []
    layers += [
        settings(one if isinstance(one, ConfigEntry) else entry_of(one, "grid"), (ScenarioSpec,)) for one in levels
    ]
    layers += [one if isinstance(one, ConfigEntry) else parse_override(one) for one in overrides]
    root = _without_nulls(apply(file.root, layers, (ScenarioSpec,)))
    embedded = embedded and "images" not in (root.section or {})
    plain = cast("dict[str, Any]", root.plain())
    lengths = lengths_left_out((ScenarioSpec,), plain, scale_as_written(plain, file.folders, embedded))
    spec = validated(ScenarioSpec, root, file.folders, lengths=lengths, embedded=embedded)
    if embedded:
        believed = spec.onboard.body
        onboard = spec.onboard if believed is None else spec.onboard.model_copy(update={"body": believed.embedded()})
        spec = spec.model_copy(update={"body": spec.body.embedded(), "onboard": onboard})
    return LoadedScenario(spec, path, file.folders)


def _without_nulls(root: ConfigEntry) -> ConfigEntry:
    """Remove keys with null, so that ``section: null`` restores the default of an inherited section."""
    section = root.section or {}
    kept = {key: entry for key, entry in section.items() if entry.value is not None}
    return ConfigEntry(kept, root.place)


def load_campaign(name_or_path: str, catalog: Path, overrides: Sequence[str] = ()) -> LoadedCampaign:
    """Read a campaign; ``overrides`` change its own keys, for example ``trials=20``.

    Raise BoresightError as ``load_scenario`` does.
    """
    path = find(name_or_path, catalog, what="campaign")
    file = _read_chain(path, catalog, CampaignSpec)
    root = apply(file.root, [parse_override(text) for text in overrides], (CampaignSpec,))
    return LoadedCampaign(validated(CampaignSpec, root), path, root)


def validated(
    model: type[Spec],
    root: ConfigEntry,
    folders: Sequence[Path] = (),
    *,
    lengths: Plain | None = None,
    embedded: bool = False,
) -> Spec:
    """Validate an entry against a model, with strict types: no text for a number, no 1 for true.

    ``lengths`` are those that it leaves out. Tables that it names are read from ``folders`` or the data folder; so is
    the shape that a descent leads to, or the ``embedded`` one in its place. Raise BoresightError with one line for each
    fault.
    """
    try:
        # As JSON, because strict validation of Python values would refuse lists for tuples.
        plain: Any = root.plain()
        completed = on_defaults((model,), with_lengths(plain, lengths or {})) if isinstance(plain, dict) else plain
        context = {"folders": folders, "surface_m": partial(surface_m, completed, folders, embedded)}
        return model.model_validate_json(json.dumps(completed), strict=True, context=context)
    except ValidationError as error:
        raise BoresightError(explain(error, root, model)) from error


def file_kind(path: Path, known: Sequence[str] = ()) -> Literal["scenario", "campaign"]:
    """Return whether a file is a scenario or a campaign, by its keys.

    Raise BoresightError if the file cannot be read; if it does not exist, the message suggests a similar name, of the
    scenarios of the catalogue and those ``known`` besides.
    """
    if not exists(path):
        near = difflib.get_close_matches(path.name, [*known, *scenario_names()], n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise BoresightError(f"{display(path)}: no such file, nor a name that boresight knows{hint}")
    keys = set(read(path).section or {})
    of_campaign, of_scenario = set(CampaignSpec.model_fields), set(ScenarioSpec.model_fields)
    return "campaign" if len(keys & of_campaign - of_scenario) > len(keys & of_scenario - of_campaign) else "scenario"


def _read_chain(path: Path, catalog: Path, model: type[SpecModel], children: tuple[Path, ...] = ()) -> _File:
    """Read a file and merge it over those that it extends; later parents override earlier ones."""
    resolved = path.resolve()
    own = read(path)
    shown = own.place.rpartition(":")[0]
    section = dict(own.section or {})
    extends = section.pop("extends", None)
    # A name is not inherited; that of the file itself is its default.
    if not children:
        section.setdefault("name", ConfigEntry(name_of(path), shown))
    if len(children) > _MAX_GENERATIONS:
        raise BoresightError(f"{shown}: extends: a chain of more than {_MAX_GENERATIONS} files")
    layers, folders = list[ConfigEntry](), [resolved.parent]
    for parent in _parents(extends):
        parent_path = find(parent, catalog, path.parent)
        if parent_path.resolve() in (*children, resolved):
            raise BoresightError(f"{extends.place if extends else path}: extends: {parent} leads back to this file")
        file = _read_chain(parent_path, catalog, model, (*children, resolved))
        # Name and description belong to a file alone.
        inherited = {key: entry for key, entry in (file.root.section or {}).items() if key not in model.own}
        layers.append(ConfigEntry(inherited, own.place))
        folders += file.folders
    root = apply(ConfigEntry({}, shown), [*layers, ConfigEntry(section, own.place)], (model,))
    return _File(root, tuple(dict.fromkeys(folders)))


def _parents(extends: ConfigEntry | None) -> list[str]:
    if extends is None:
        return []
    items = extends.value if isinstance(extends.value, tuple) else (extends,)
    parents = [item.value for item in items]
    if not all(isinstance(parent, str) and parent for parent in parents):
        raise BoresightError(f"{extends.place}: extends: {describe(extends)} is not a name, a path or a list of them")
    return [str(parent) for parent in parents]
