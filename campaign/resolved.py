"""Resolved campaign: everything that determines its rows; and its draft.

A draft makes all figures and tables of the campaign from fewer repetitions: it keeps a fraction of trials, data bases,
image sets and images, at least as many as a method needs. Estimators, grid levels, and sizes of bodies and images are
unchanged.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from boresight.campaign.imaging.real_images import images_digest
from boresight.estimators.registry import FILE_OPTIONS, bases_of, file_of, source_digest
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.reports.run.clusters import all_but_body
from boresight.scenarios.bodies import body_digest
from boresight.scenarios.craters import shape_digest
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import ConfigEntry, LoadedScenario, canonical_json, digest
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.campaign import CampaignSpec, GridVariation

DRAFT_VERSION = 4
"""Version of drafts: raise it when the same fraction keeps something else."""

Options = TypeVar("Options", bound=SpecModel)

LEAST_SETS = 2
"""Least number of image sets, each of another body, whose results are pooled, and of data bases."""
LEAST_DATABASE_IMAGES = 120
LEAST_OBSERVATIONS = 4
"""Least number of observations of a landmark; fewer do not determine the covariance of its coordinates."""
LEAST_ARC_IMAGES = 24
"""Least number of images of an arc; with fewer, craters are not seen from enough positions to solve for an orbit."""


@dataclass(frozen=True, slots=True)
class Versions:
    """Versions of a campaign's kind of trial, and of each method by label, including the methods that it builds on."""

    kind: int
    methods: Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class ResolvedCampaign:
    """A campaign with its scenarios read: exactly what its rows depend on.

    ``versions`` are those of the code that computes the rows. ``variations`` gives the place of each scenario, by name,
    in the campaign's grid. ``overrides`` are those of the command line, already applied to the scenarios. ``draft`` is
    the fraction of repetitions, see `as_draft`; 1 for a full run. ``root`` holds the keys of the campaign's file
    with their places; None for a campaign that was read from a manifest. ``embedded`` says which built-in bodies are in
    place of shape files.

    Equality and hash are those of the digest, so that a worker can cache what it built for a campaign.
    """

    spec: CampaignSpec
    scenarios: tuple[LoadedScenario, ...]
    seed: int
    versions: Versions
    variant: str = ""
    variations: Mapping[str, GridVariation] = field(default_factory=dict)
    overrides: tuple[str, ...] = ()
    draft: float = 1.0
    root: ConfigEntry | None = None
    embedded: tuple[str, ...] = ()

    @cached_property
    def identity(self) -> dict[str, object]:
        """Everything that determines a row, in plain values."""
        methods = self.versions.methods
        return {
            "experiment": [self.spec.experiment, self.versions.kind],
            "seed": self.seed,
            "scenarios": [
                {
                    "name": s.spec.name,
                    "digest": digest(s.spec),
                    "body": shape_digest(s.spec, s.search_dirs),
                    "onboard": body_digest(onboard_spec(s.spec).body, s.search_dirs),
                    "images": images_digest(s),
                }
                for s in self.scenarios
            ],
            "estimators": [
                {
                    "label": e.label,
                    **_sources(e.name, e.options),
                    "options": _options(e.name, e.options),
                    "version": list(methods[e.label]),
                }
                for e in self.spec.estimators
            ],
            "renderer": [MitsubaRenderer.name, MitsubaRenderer.version, self.variant],
            "detector": Detector.version,
            **({"databases": self.spec.databases} if self.spec.databases > 1 else {}),
            **({"draft": [self.draft, DRAFT_VERSION]} if self.draft < 1.0 else {}),
        }

    @cached_property
    def digest(self) -> str:
        """Hash of the identity, the key of the run."""
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True).encode()).hexdigest()

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the estimators, in the order of the campaign."""
        return tuple(entry.label for entry in self.spec.estimators)

    def entry(self, key: str, label: str = "") -> ConfigEntry | None:
        """Return a key of the campaign's file, or of the list ``key`` the item of a label, with its place."""
        found = None if self.root is None or self.root.section is None else self.root.section.get(key)
        if found is not None and label and isinstance(found.value, tuple):
            return found.value[self.labels.index(label)]
        return found

    def as_written(self) -> dict[str, object]:
        """Return the campaign as the content of a campaign file."""
        written: dict[str, object] = json.loads(canonical_json(self.spec))
        return {**written, "estimators": [{e.name: {"label": e.label, **e.options}} for e in self.spec.estimators]}

    def scenario(self, name: str) -> LoadedScenario:
        """Return one scenario by its name."""
        return next(s for s in self.scenarios if s.spec.name == name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ResolvedCampaign) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


def _sources(name: str, options: Mapping[str, object]) -> dict[str, object]:
    """Identify the code of an estimator of a campaign, and of the files that it builds on."""
    found = {base.key: _sources(base.name, base.options) for base in bases_of(name, options)}
    return {**_source(name), **{key: of_base for key, of_base in found.items() if len(of_base) > 1}}


def _options(name: str, options: Mapping[str, object]) -> Mapping[str, object]:
    """Return options with the digest of a file's content in place of its path."""
    key = FILE_OPTIONS.get(name, "")
    if key not in options:
        return options
    try:
        return {**options, key: hashlib.sha256(Path(str(options[key])).read_bytes()).hexdigest()}
    except OSError as error:
        raise BoresightError(f"estimator {name}: {key}: {options[key]}: cannot be read: {error.strerror}") from error


def _source(estimator: str) -> dict[str, object]:
    """Identify the code of an estimator: its name; of ``file.py:Class`` that without folder, and a digest."""
    file = file_of(estimator)
    if file is None:
        return {"name": estimator}
    return {"name": f"{file.name}:{estimator.rpartition(':')[2]}", "source": source_digest(estimator)}


def kept(whole: int, share: float, least: int = 1) -> int:
    """Return the part of a number that a draft keeps: its fraction, but at least ``min(least, whole)``."""
    return max(min(whole, least), math.ceil(round(share * whole, 9)))


def as_draft(campaign: ResolvedCampaign, share: float) -> ResolvedCampaign:
    """Return a campaign with a fraction of its pooled image sets, of its data bases, and of the images of an arc."""
    if share >= 1.0:
        return campaign
    scenarios = tuple(_shortened(one, share) for one in _fewer_sets(campaign.scenarios, share))
    names = {one.spec.name for one in scenarios}
    variations = {name: where for name, where in campaign.variations.items() if name in names}
    spec = campaign.spec.model_copy(update={"databases": kept(campaign.spec.databases, share, LEAST_SETS)})
    return replace(campaign, spec=spec, scenarios=scenarios, variations=variations, draft=share)


def drafted(options: Options, share: float) -> Options:
    """Reduce the number of images of a data base, and of observations required of a landmark."""
    images = getattr(options, "images", None)
    if share >= 1.0 or not isinstance(images, int):
        return options
    fewer = kept(images, share, LEAST_DATABASE_IMAGES)
    changes = {"images": fewer}
    observations = getattr(options, "min_observations", None)
    if isinstance(observations, int):
        changes["min_observations"] = kept(observations, fewer / images, LEAST_OBSERVATIONS)
    return options.model_copy(update=changes)


def _fewer_sets(scenarios: tuple[LoadedScenario, ...], share: float) -> Iterator[LoadedScenario]:
    """Yield the scenarios, with only the first of each group of image sequences that differ only in the body."""
    pools = [_pool(one) for one in scenarios]
    for number, (scenario, pool) in enumerate(zip(scenarios, pools, strict=True)):
        if not pool or pools[:number].count(pool) < kept(pools.count(pool), share, LEAST_SETS):
            yield scenario


def _pool(scenario: LoadedScenario) -> str:
    """Return the key of the group that a scenario is pooled with; '' if it has no image sequence."""
    sequence = scenario.spec.sequence
    if sequence is None or sequence.images is None:
        return ""
    return all_but_body(json.loads(canonical_json(scenario.spec)))


def _shortened(scenario: LoadedScenario, share: float) -> LoadedScenario:
    """Shorten an arc of rendered images, keeping the interval between images."""
    orbit = scenario.spec.orbit
    if orbit is None or orbit.imaging is None or orbit.imaging.detections != "rendered":
        return scenario
    epochs = kept(orbit.imaging.epochs, share, LEAST_ARC_IMAGES)
    arc = orbit.arc.model_copy(update={"days": orbit.arc.days * epochs / orbit.imaging.epochs})
    imaging = orbit.imaging.model_copy(update={"epochs": epochs})
    shorter = orbit.model_copy(update={"arc": arc, "imaging": imaging})
    return replace(scenario, spec=scenario.spec.model_copy(update={"orbit": shorter}))
