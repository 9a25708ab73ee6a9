"""Several data bases of one campaign: what is drawn once in a run, and not in each trial, is drawn for each of them.

Data base 0 is that of a campaign with a single one, bit for bit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from campaign.imaging.world import typical_range_m
from renderers.mitsuba3 import renderer_version
from scenarios.craters import shape_digest
from scenarios.load import LoadedScenario, canonical_json
from scenarios.spec.base import SpecModel
from scenarios.spec.onboard import OnboardSpec

Options = TypeVar("Options", bound=SpecModel)

SEED_STEP = 10_000
"""Between the seeds of two data bases, so that none meets a seed near by that something else was made with."""


def content_key(scenario: LoadedScenario, kind: str, options: SpecModel, versions: Sequence[int], variant: str) -> str:
    """Return the hash of everything that decides a thing of a kind: whatever would change it changes the key.

    Parameters
    ----------
    scenario
        As the spacecraft believes it to be.
    kind, options
        What is built, and how.
    versions
        Of all code that it depends on, beside the renderer's.
    variant
        The Mitsuba variant.
    """
    spec = scenario.spec
    parts = {
        "kind": kind,
        "options": json.loads(options.model_dump_json(exclude_none=True)),
        "body": shape_digest(spec, scenario.search_dirs),
        "scenario": [canonical_json(part) for part in (spec.camera, spec.brdf, spec.rendering)],
        "shading": spec.body.shading,
        "range_m": typical_range_m(scenario),
        "versions": [*versions, renderer_version(spec)[1]],
        "variant": variant,
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]


def drawn_per_database(scenario: LoadedScenario) -> frozenset[str]:
    """Name what of a scenario is drawn for a data base: ``world`` (its craters), ``knowledge`` (the shape on board)."""
    found = {"world"} if scenario.spec.craters is not None else set()
    return frozenset(found | ({"knowledge"} if _drawn_onboard(scenario.spec.onboard) else set()))


def with_database_craters(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the craters of a data base: its trials see them, and it is made of them."""
    craters = scenario.spec.craters
    if database == 0 or craters is None:
        return scenario
    return replace(scenario, spec=scenario.spec.model_copy(update={"craters": with_database_seed(craters, database)}))


def with_database_knowledge(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the errors of the shape on board that a data base has."""
    drawn = _drawn_onboard(scenario.spec.onboard)
    if database == 0 or not drawn:
        return scenario
    onboard = scenario.spec.onboard.model_copy(update={k: with_database_seed(v, database) for k, v in drawn.items()})
    return replace(scenario, spec=scenario.spec.model_copy(update={"onboard": onboard}))


def with_database_seed(options: Options, database: int) -> Options:
    """Return options with the seed of a data base; a seed that is left out counts as 0."""
    if database == 0:
        return options
    seed: int = getattr(options, "seed") or 0  # noqa: B009  not every model has one, but all that are given here
    return options.model_copy(update={"seed": seed + SEED_STEP * database})


def _drawn_onboard(onboard: OnboardSpec) -> dict[str, SpecModel]:
    """Return the sections of the knowledge on board that chance decides, but not in each trial: they have a seed."""
    sections = {name: getattr(onboard, name) for name in OnboardSpec.model_fields}
    return {name: section for name, section in sections.items() if hasattr(section, "seed")}
