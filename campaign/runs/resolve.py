"""From a campaign's name to everything that decides its rows."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from boresight.campaign.resolved import ResolvedCampaign, Versions
from boresight.campaign.runs.read import read_campaign
from boresight.campaign.trial.kind import Trials, kind_named
from boresight.estimators.options import surveyed
from boresight.estimators.registry import FILE_OPTIONS, file_of, needed_sensors, with_bases
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedCampaign, LoadedScenario
from boresight.scenarios.spec.campaign import CampaignSpec, EstimatorSpec
from boresight.scenarios.spec.scenario import ScenarioSpec


def resolve(
    name_or_path: str,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    variant: str = "",
    *,
    embedded: bool = False,
) -> ResolvedCampaign:
    """Read a campaign and its scenarios, with ``--set`` overrides put on every scenario.

    ``variant`` is the Mitsuba variant of a run: images of two variants agree closely, but not bit for bit. ``embedded``
    takes built-in bodies in place of shape files. Raise BoresightError if a file, a key or a value is wrong, an
    estimator is unknown or two scenarios share a name.
    """
    read = read_campaign(name_or_path, overrides, embedded=embedded)
    loaded, scenarios = read.loaded, read.scenarios
    spec = _with_whole_paths(loaded.spec, loaded.path.parent)
    files = read_campaign(name_or_path, overrides).scenarios if embedded else scenarios
    try:
        kind = kind_named(spec.experiment)
    except BoresightError as error:
        raise BoresightError(f"{loaded.place_of('experiment')}: {error}") from error
    if spec.databases > 1:
        _check_databases(loaded, kind, scenarios)
    versions = _versions(spec, loaded)
    for entry in spec.estimators:
        _check_sensors(entry, scenarios)
    decides = (spec, scenarios, spec.seed if seed is None else seed, versions, variant)
    embedded_bodies = _replaced(files, scenarios)
    return ResolvedCampaign(*decides, read.variations, tuple(overrides), root=loaded.root, embedded=embedded_bodies)


def _replaced(files: Sequence[LoadedScenario], embedded: Sequence[LoadedScenario]) -> tuple[str, ...]:
    """Say which built-in body is in place of which shape file."""
    specs = [(a.spec, b.spec) for a, b in zip(files, embedded, strict=True)]
    bodies = [pair for a, b in specs for pair in zip(a.bodies, b.bodies, strict=True)]
    bodies += [(a.onboard.body, b.onboard.body) for a, b in specs if a.onboard.body and b.onboard.body]
    said = [f"{b.shape} in place of {a.shape}" for a, b in bodies if a.shape != b.shape]
    return tuple(dict.fromkeys(said))


def _with_whole_paths(spec: CampaignSpec, near: Path) -> CampaignSpec:
    """Make files of estimators absolute, which a campaign names by their path from its own."""
    entries = []
    for entry in spec.estimators:
        file = file_of(entry.name)
        whole = entry.name if file is None else f"{(near / file).absolute()}:{entry.name.rpartition(':')[2]}"
        key = FILE_OPTIONS.get(entry.name, "")
        named = {key: str((near / one).absolute())} if isinstance(one := entry.options.get(key), str) else {}
        entries.append(entry.model_copy(update={"name": whole, "options": {**entry.options, **named}}))
    return spec.model_copy(update={"estimators": tuple(entries)})


def of_scenario(
    scenario: LoadedScenario, estimators: Mapping[str, Mapping[str, object]], experiment: str, seed: int, variant: str
) -> ResolvedCampaign:
    """Make a campaign of one scenario without a file; ``estimators`` are options by name."""
    kind_named(experiment)
    written = {"name": "trial", "experiment": experiment, "scenarios": [scenario.spec.name], "trials": 1, "seed": seed}
    asked = CampaignSpec.model_validate({**written, "estimators": [{name: dict(o)} for name, o in estimators.items()]})
    spec = _with_whole_paths(asked, Path())
    for entry in spec.estimators:
        _check_sensors(entry, (scenario,))
    return ResolvedCampaign(spec, (scenario,), seed, _versions(spec), variant)


def _check_databases(loaded: LoadedCampaign, kind: type[Trials], scenarios: Sequence[LoadedScenario]) -> None:
    """Refuse several data bases where images are real, or where the kind of trial has one alone."""
    key = f"{loaded.place_of('databases')}: databases"
    for scenario in scenarios:
        if scenario.spec.images is not None:
            raise BoresightError(
                f"{key}: {scenario.spec.name} has a set of images, of which each trial shares one with others already:"
                " leave the key out"
            )
    if not kind.databases:
        raise BoresightError(f"{key}: 1 is all that a campaign of {kind.name} has: leave the key out")


def _versions(spec: CampaignSpec, loaded: LoadedCampaign | None = None) -> Versions:
    """Collect the versions of methods, and of those that they build on; refuse an unknown one."""
    kind, found = kind_named(spec.experiment), {}
    for i, entry in enumerate(spec.estimators):
        try:
            found[entry.label] = tuple(kind.method_version(name) for name in kind.method_names(entry))
        except BoresightError as error:
            raise error if loaded is None else BoresightError(f"{loaded.place_of('estimators', i)}: {error}") from error
    return Versions(kind.version, found)


def _check_sensors(entry: EstimatorSpec, scenarios: Sequence[LoadedScenario]) -> None:
    """Refuse an estimator that needs what a scenario has not aboard."""
    for scenario in scenarios:
        needed = frozenset[str]().union(*map(needed_sensors, with_bases(entry.name, entry.options)))
        for sensor in sorted(needed - scenario.spec.sensors.aboard):
            raise BoresightError(
                f"{scenario.path}: sensors.{sensor}: missing, but the estimator {entry.name} needs it:"
                f" add the section, or leave the estimator out"
            )
        if "stars" in with_bases(entry.name, entry.options) and scenario.spec.stars is None:
            raise BoresightError(
                f"{scenario.path}: stars: missing, but the estimator {entry.name} needs them: add the section, or"
                " leave the estimator out"
            )
        images = scenario.spec.images
        if surveyed(entry.options) and (images is None or not images.survey):
            raise BoresightError(
                f"{scenario.path}: images.survey: names no images, but {entry.label} has source: survey"
            )


def reload(manifest: Mapping[str, Any]) -> ResolvedCampaign | None:
    """Resolve a stored run's campaign again from its manifest; None where code or data have changed since.

    Raise BoresightError if the data that it needs are gone.
    """
    campaign = _read_again(manifest)
    return campaign if campaign is not None and campaign.digest == manifest["digest"] else None


def unlike(manifest: Mapping[str, Any]) -> list[str]:
    """Name what decides the rows of a stored run and is not as it was; empty where its manifest cannot be read."""
    campaign = _read_again(manifest)
    if campaign is None:
        return []
    now = json.loads(json.dumps(campaign.identity))
    return list(_unlike(manifest["identity"], now, ""))


def _unlike(then: Any, now: Any, where: str) -> Iterator[str]:
    """Walk down two plain values to what differs; entries of a list go by their name, where they have one."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key in sorted(then.keys() | now.keys()):
            yield from _unlike(then.get(key), now.get(key), f"{where}.{key}" if where else key)
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for index, (old, new) in enumerate(zip(then, now, strict=True)):
            name = old.get("label", old.get("name", index)) if isinstance(old, dict) else index
            yield from _unlike(old, new, f"{where}[{name}]")
    elif then != now:
        yield where


def _read_again(manifest: Mapping[str, Any]) -> ResolvedCampaign | None:
    """Read the campaign of a manifest; None where it is not one that this version writes."""
    try:
        spec = CampaignSpec.model_validate_json(json.dumps(manifest["campaign"]))
        # In the order of the campaign: a manifest is sorted by name.
        names = [entry["name"] for entry in manifest["identity"]["scenarios"]]
        scenarios = tuple(
            LoadedScenario(
                ScenarioSpec.model_validate_json(json.dumps(manifest["scenarios"][name])),
                Path(manifest["files"][name][0]),
                tuple(map(Path, manifest["files"][name][1:])),
            )
            for name in names
        )
        machine, seed = manifest["machine"], int(manifest["seed"])
        variant = str(machine["variant"])
    except (KeyError, IndexError, TypeError, AttributeError, ValueError):
        return None
    draft, embedded = float(manifest.get("draft", 1.0)), tuple(manifest.get("embedded", ()))
    return ResolvedCampaign(spec, scenarios, seed, _versions(spec), variant, draft=draft, embedded=embedded)
