"""Resolved campaign: everything that determines its rows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from boresight.campaign.imaging.real_images import images_digest
from boresight.estimators.registry import bases_of, file_of, source_digest
from boresight.renderers.detector import Detector
from boresight.renderers.mitsuba3 import MitsubaRenderer
from boresight.scenarios.bodies import body_digest
from boresight.scenarios.craters import shape_digest
from boresight.scenarios.load import ConfigEntry, LoadedScenario, canonical_json, digest
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.spec.campaign import CampaignSpec, GridVariation

DRAFT_VERSION = 4
"""Version of `campaign.draft`: raise it when the same fraction keeps something else."""


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
    the fraction of repetitions, see `campaign.draft`; 1 for a full run. ``root`` holds the keys of the campaign's file
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
                    "options": e.options,
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


def _source(estimator: str) -> dict[str, object]:
    """Identify the code of an estimator: its name; of ``file.py:Class`` that without folder, and a digest."""
    file = file_of(estimator)
    if file is None:
        return {"name": estimator}
    return {"name": f"{file.name}:{estimator.rpartition(':')[2]}", "source": source_digest(estimator)}
