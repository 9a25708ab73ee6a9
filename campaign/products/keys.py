"""The content hash of what is built from a scenario's shape and camera."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence

from campaign.imaging.world import typical_range_m
from renderers.mitsuba3 import renderer_version
from scenarios.craters import shape_digest
from scenarios.load import LoadedScenario, canonical_json
from scenarios.spec.base import SpecModel


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
