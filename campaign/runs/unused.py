"""Refusal of the keys of a scenario that its trials do not depend on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from boresight.campaign.trial.kind import Trials, kind_named
from boresight.scenarios.errors import BoresightError, display
from boresight.scenarios.load import ConfigEntry, LoadedScenario
from boresight.scenarios.load.files import CATALOG
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.scenario import ScenarioSpec

_MOST_NAMED = 4


def check_used(scenario: LoadedScenario, kind: type[Trials]) -> None:
    """Refuse keys that a campaign, the command line or the files of a scenario give and no trial depends on.

    A file may serve several kinds of trial: of its keys those are refused that no kind would use. Files of the
    catalogue keep such keys, as the identity of a run depends on them. Raise `BoresightError` with the location of the
    first such key and the names of all.
    """
    idle = kind.unused(scenario.spec)
    nowhere = {*idle} & {*kind_named(widest_kind(scenario.spec)).unused(scenario.spec)}
    refused = dict[str, str]()
    for key in idle:
        given, in_file = _entry(scenario.keys, key), _entry(scenario.file_keys, key)
        if given is None or not _stated(scenario.spec, key):
            continue
        overridden = in_file is None or in_file.place != given.place
        if overridden or (key in nowhere and not _in_catalogue(given)):
            refused[key] = given.place
    if refused:
        raise BoresightError(_in_words(scenario, kind.name, refused))


def _in_words(scenario: LoadedScenario, kind: str, refused: Mapping[str, str]) -> str:
    """Say what has no effect, where the first of it is given, and what to do."""
    (first, place), *others = refused.items()
    named = ", ".join(list(refused)[:_MOST_NAMED])
    more = f" and {len(refused) - _MOST_NAMED} more keys" if len(refused) > _MOST_NAMED else ""
    has, it = ("have", "them") if others else ("has", "it")
    file = place.rpartition(":")[0]
    inherited = bool(file) and Path(file).suffix == scenario.path.suffix and file != display(scenario.path)
    null = f", or say {first.split('.')[0]}: null in {display(scenario.path)}" if inherited else ""
    return f"{place}: {named}{more}: {has} no effect in {kind}: leave {it} out{null}"


def widest_kind(spec: ScenarioSpec) -> str:
    """Name the kind of trial that uses most of a scenario, by its sections."""
    if spec.orbit is not None:
        if spec.orbit.imaging is None:
            return "orbit-determination"
        return "crater-navigation" if spec.orbit.arc.approach is None else "approach-orbit"
    if spec.crater_pairs is not None:
        return "crater-matching"
    return "single-image" if spec.sequence is None else "sequence"


def _entry(root: ConfigEntry | None, key: str) -> ConfigEntry | None:
    """Return a dotted key among those that are given; None where it is not, or is null."""
    entry = root
    for part in key.split("."):
        entry = None if entry is None or entry.section is None else entry.section.get(part)
    return None if entry is None or entry.value is None else entry


def _stated(spec: ScenarioSpec, key: str) -> bool:
    """Return whether the value of a dotted key is another than where a file leaves it out."""
    *sections, name = key.split(".")
    within: object = spec
    for section in sections:
        within = getattr(within, section)
    return isinstance(within, SpecModel) and bool(within.stated(name))


def _in_catalogue(entry: ConfigEntry) -> bool:
    """Return whether a key is one of a scenario that comes with boresight."""
    return Path(entry.place.rpartition(":")[0]).resolve().parent == CATALOG.resolve()
