"""Find scenario and campaign files by name or path, and load them as validated specifications."""

from __future__ import annotations

import difflib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from pydantic import ValidationError

from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.load.explain import explain
from boresight.scenarios.load.lengths import lengths_left_out, scale_as_written, surface_m, with_lengths
from boresight.scenarios.load.merge import Plain, apply, on_defaults, parse_override, settings
from boresight.scenarios.load.yaml_text import ConfigEntry, describe, entry_of, parse_yaml, shortened
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import CampaignSpec
from boresight.scenarios.spec.scenario import NAME_PATTERN, ScenarioSpec
from boresight.scenarios.spec.second import SecondBodySpec

SUFFIXES = (".yaml", ".yml")
_MAX_BYTES = 1_000_000


def names_in(catalog: Path) -> list[str]:
    """Return the names of the files of a catalogue folder, sorted: stems, with ``-`` for ``_``."""
    return sorted(_by_name(catalog))


def find(name_or_path: str, catalog: Path, near: Path | None = None, what: str = "scenario") -> Path:
    """Find a file by its name in the catalogue, otherwise by its path: ``quickstart``, or ``my/scene.yaml``.

    Relative paths, and names without a suffix, are looked up in ``near`` too, by default the working directory. Raise
    BoresightError if there is none; the message names the kind of file, ``what``, and suggests similar names.
    """
    for folder in [catalog] if near is None else [catalog, near]:
        usual = folder / f"{name_or_path.replace('-', '_')}{SUFFIXES[0]}"
        # Most are found without listing the folder.
        if usual.parent == folder and exists(usual):
            return usual
        if file := _by_name(folder).get(name_or_path.replace("_", "-")):
            return folder / file
    path = (near or Path()) / name_or_path
    if not exists(path):
        known, beside = names_in(catalog), [one.name for one in sorted(path.parent.glob("*")) if one.suffix in SUFFIXES]
        close = difflib.get_close_matches(path.stem, known, n=1) or difflib.get_close_matches(path.name, beside, n=1)
        hint = f"did you mean {close[0]}?" if close else "give a path, or a name of: boresight list --all"
        raise BoresightError(f"{shortened(name_or_path)}: no such {what}; {hint}")
    return path


def exists(path: Path) -> bool:
    """Return whether a file or folder exists; False for names that are invalid as paths."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read(path: Path) -> ConfigEntry:
    """Read and parse a file whose top level must be a section of keys.

    Raise BoresightError if it cannot be read, is not UTF-8 text, is empty or is not a mapping.
    """
    shown = display(path)
    try:
        if path.is_dir():
            raise BoresightError(f"{shown}: is a folder, not a YAML file")
        if path.exists() and not path.is_file():
            raise BoresightError(f"{shown}: is a device or a pipe, not a YAML file")
        size = path.stat().st_size
        if size > _MAX_BYTES:
            raise BoresightError(f"{shown}: {size} bytes is too long for a scenario or campaign file")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise BoresightError(f"{shown}: no such file") from error
    except UnicodeDecodeError as error:
        raise BoresightError(f"{shown}: not UTF-8 text (byte {error.start}): save it as UTF-8") from error
    except (OSError, ValueError) as error:
        raise BoresightError(f"{shown}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    root = parse_yaml(text, shown)
    if root.section is None:
        state = "is empty" if root.value is None else "is not a section of keys"
        raise BoresightError(f"{shown}: the file {state}: write 'key: value' lines")
    return root


def _named(file: str) -> tuple[str, str]:
    """Split a file name into the name of what it holds, and the suffix."""
    stem, suffix = os.path.splitext(file)  # noqa: PTH122  no paths are made: this is asked for every file that is read
    return stem.replace("_", "-"), suffix


def _by_name(folder: Path) -> dict[str, str]:
    """Return the file names of a folder by the names of what they hold."""
    try:
        names = sorted(os.listdir(folder))  # noqa: PTH208
    except OSError:
        names = []
    return {name: file for file in names for name, suffix in [_named(file)] if suffix in SUFFIXES}


_MAX_GENERATIONS = 20
CATALOG = Path(__file__).parents[1] / "catalog"
Spec = TypeVar("Spec", bound=SpecModel)


@dataclass(frozen=True, slots=True)
class LoadedScenario:
    """A scenario, its file, and the folders that are searched for its data.

    ``keys`` are those that are given, with their locations, and ``file_keys`` those that its file and the files that it
    extends give, before the overrides; both are None for a scenario that was read from a manifest.
    """

    spec: ScenarioSpec
    path: Path
    search_dirs: tuple[Path, ...]
    keys: ConfigEntry | None = field(default=None, compare=False, repr=False)
    file_keys: ConfigEntry | None = field(default=None, compare=False, repr=False)

    def place_of(self, key: str) -> str:
        """Return the location of a dotted key, ``file:line``; of the section that leaves it out, or the file alone."""
        entry = self.keys
        for part in key.split("."):
            section = None if entry is None else entry.section
            if section is None or part not in section:
                break
            entry = section[part]
        return str(self.path) if entry is None else entry.place


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
    shape files that they stand for, but for real images and tracks. Lengths that are left out and follow from the
    camera or the body are filled in. Raise BoresightError with one line for each fault: file, line, key, value and what
    is allowed.
    """
    path = find(name_or_path, CATALOG, near)
    file, folders = _read_chain(path, CATALOG, ScenarioSpec)
    layers = [settings(base, (ScenarioSpec,))] if base is not None else []
    layers += [
        settings(one if isinstance(one, ConfigEntry) else entry_of(one, "grid"), (ScenarioSpec,)) for one in levels
    ]
    layers += [one if isinstance(one, ConfigEntry) else parse_override(one) for one in overrides]
    section = apply(file, layers, (ScenarioSpec,)).section or {}
    # ``section: null`` restores the default of an inherited section.
    root = ConfigEntry({key: entry for key, entry in section.items() if entry.value is not None}, file.place)
    plain = cast("dict[str, Any]", root.plain())
    sequence = plain.get("sequence")
    followed = isinstance(sequence, dict) and sequence.get("tracks") is not None
    embedded = embedded and "images" not in plain and not followed
    lengths = lengths_left_out((ScenarioSpec,), plain, scale_as_written(plain, folders, embedded))
    if isinstance(second := plain.get("second_body"), dict):  # measured by its own body
        lengths["second_body"] = lengths_left_out(
            (SecondBodySpec,), second, scale_as_written(second, folders, embedded)
        )
    spec = validated(ScenarioSpec, root, folders, lengths=lengths, embedded=embedded)
    if embedded:
        believed = spec.onboard.body
        onboard = spec.onboard if believed is None else spec.onboard.model_copy(update={"body": believed.embedded()})
        second = spec.second_body and spec.second_body.model_copy(update={"body": spec.second_body.body.embedded()})
        spec = spec.model_copy(update={"body": spec.body.embedded(), "onboard": onboard, "second_body": second})
    return LoadedScenario(spec, path, folders, root, file)


def load_campaign(name_or_path: str, catalog: Path, overrides: Sequence[str] = ()) -> LoadedCampaign:
    """Read a campaign; ``overrides`` change its own keys, for example ``trials=20``.

    Raise BoresightError as ``load_scenario`` does.
    """
    path = find(name_or_path, catalog, what="campaign")
    file, _ = _read_chain(path, catalog, CampaignSpec)
    root = apply(file, [parse_override(text) for text in overrides], (CampaignSpec,))
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


def _read_chain(
    path: Path, catalog: Path, model: type[SpecModel], children: tuple[Path, ...] = ()
) -> tuple[ConfigEntry, tuple[Path, ...]]:
    """Read a file and merge it over those that it extends, later ones over earlier ones; also return their folders."""
    resolved = path.resolve()
    own = read(path)
    shown = own.place.rpartition(":")[0]
    section = dict(own.section or {})
    extends = section.pop("extends", None)
    # A name is not inherited; that of the file itself is its default, where it may be one.
    if not children and re.fullmatch(NAME_PATTERN, name := _named(path.name)[0]):
        section.setdefault("name", ConfigEntry(name, shown))
    if len(children) > _MAX_GENERATIONS:
        raise BoresightError(f"{shown}: extends: a chain of more than {_MAX_GENERATIONS} files")
    layers, folders = list[ConfigEntry](), [resolved.parent]
    for parent in _parents(extends):
        parent_path = find(parent, catalog, path.parent)
        if parent_path.resolve() in (*children, resolved):
            raise BoresightError(f"{extends.place if extends else path}: extends: {parent} leads back to this file")
        root, further = _read_chain(parent_path, catalog, model, (*children, resolved))
        # Name and description belong to a file alone.
        inherited = {key: entry for key, entry in (root.section or {}).items() if key not in model.own}
        layers.append(ConfigEntry(inherited, own.place))
        folders += further
    root = apply(ConfigEntry({}, shown), [*layers, ConfigEntry(section, own.place)], (model,))
    return root, tuple(dict.fromkeys(folders))


def _parents(extends: ConfigEntry | None) -> list[str]:
    if extends is None:
        return []
    items = extends.value if isinstance(extends.value, tuple) else (extends,)
    parents = [item.value for item in items]
    if not all(isinstance(parent, str) and parent for parent in parents):
        raise BoresightError(f"{extends.place}: extends: {describe(extends)} is not a name, a path or a list of them")
    return [str(parent) for parent in parents]
