"""Identity of data bases: their content hash, and the seeds of several data bases in one campaign.

What is drawn once per run rather than in each trial (craters, errors of the believed shape) is drawn once for each data
base. Data base 0 is, bit for bit, that of a campaign with a single one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from boresight.campaign.imaging.preview import typical_range_m
from boresight.renderers.mitsuba3 import renderer_version
from boresight.scenarios.craters import shape_digest
from boresight.scenarios.load import LoadedScenario, canonical_json
from boresight.scenarios.spec.base import SpecModel, digest
from boresight.scenarios.spec.scenario import OnboardSpec

Options = TypeVar("Options", bound=SpecModel)
Product = TypeVar("Product")

SEED_STEP = 10_000
"""Difference of the seeds of two data bases, large enough to avoid nearby seeds in other uses."""


def content_key(
    scenario: LoadedScenario,
    kind: str,
    options: SpecModel,
    versions: Sequence[int],
    variant: str,
    of_views: bool = False,
) -> str:
    """Return the hash of everything that determines a product of a scenario as the spacecraft believes it to be.

    ``versions`` are those of all code that it depends on, except the renderer. A product ``of_views`` depends on all
    that decides about images and priors, others on body, camera, reflectance and range.
    """
    spec = scenario.spec
    if of_views:
        kind = f"{kind} {digest(spec)}"
    above = spec.viewpoint is not None and spec.viewpoint.altitude_m is not None
    parts = {
        "kind": kind,
        "options": json.loads(options.model_dump_json(exclude_none=True)),
        "body": shape_digest(spec, scenario.search_dirs),
        "scenario": [canonical_json(part) for part in (spec.camera, spec.brdf, spec.rendering)],
        "shading": spec.body.shading,
        "altitude_m" if above else "range_m": typical_range_m(scenario),
        "versions": [*versions, renderer_version(spec)[1]],
        "variant": variant,
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]


@dataclass(frozen=True, slots=True)
class ProductKind(Generic[Options, Product]):
    """A kind of product: built once from the believed scenario, stored in a folder, and used by estimators.

    ``versions`` returns those of all code that it depends on, except the renderer. ``announce`` describes the effort of
    a build. ``build`` builds it into an empty folder with a number of workers and a Mitsuba variant, and returns facts
    to report, if any. ``about`` describes it for the manifest, in plain values. ``of_views`` is as in `content_key`.
    """

    options: type[Options]
    versions: Callable[[], list[int]]
    announce: Callable[[Options], str]
    build: Callable[[LoadedScenario, Options, Path, int, str], Mapping[str, object] | None]
    load: Callable[[Path], Product]
    about: Callable[[Product], dict[str, object]]
    of_views: bool = False


def drawn_per_database(scenario: LoadedScenario) -> frozenset[str]:
    """Return what is drawn per data base: ``world`` (the craters), ``knowledge`` (errors of the believed shape)."""
    found = {"world"} if scenario.spec.craters is not None else set()
    return frozenset(found | ({"knowledge"} if _drawn_onboard(scenario.spec.onboard) else set()))


def with_database_craters(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the craters of a data base, which its images and its trials show."""
    craters = scenario.spec.craters
    if database == 0 or craters is None:
        return scenario
    return replace(scenario, spec=scenario.spec.model_copy(update={"craters": with_database_seed(craters, database)}))


def with_database_knowledge(scenario: LoadedScenario, database: int) -> LoadedScenario:
    """Return a scenario with the errors of the believed shape of a data base."""
    drawn = _drawn_onboard(scenario.spec.onboard)
    if database == 0 or not drawn:
        return scenario
    onboard = scenario.spec.onboard.model_copy(update={k: with_database_seed(v, database) for k, v in drawn.items()})
    return replace(scenario, spec=scenario.spec.model_copy(update={"onboard": onboard}))


def with_database_seed(options: Options, database: int) -> Options:
    """Return options with the seed of a data base; a missing seed counts as 0."""
    if database == 0:
        return options
    seed: int = getattr(options, "seed") or 0  # noqa: B009  the type has no seed, but all models used here do
    return options.model_copy(update={"seed": seed + SEED_STEP * database})


def _drawn_onboard(onboard: OnboardSpec) -> dict[str, SpecModel]:
    """Return the sections of ``onboard`` that are drawn once per data base: those with a seed."""
    sections = {name: getattr(onboard, name) for name in OnboardSpec.model_fields}
    return {name: section for name, section in sections.items() if hasattr(section, "seed")}
