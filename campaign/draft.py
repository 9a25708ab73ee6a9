"""What a draft of a campaign leaves out: one rule for everything that a campaign repeats to be certain.

A draft makes every figure and table that the campaign makes, of less: of all that is repeated it keeps a share, and no
less than what a method needs to work at all. What is compared stays: estimators, levels of a grid, sizes of bodies and
images.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from reports.run.clusters import all_but_body
from scenarios.load import LoadedScenario, canonical_json
from scenarios.spec.base import SpecModel

if TYPE_CHECKING:
    from campaign.resolved import ResolvedCampaign

Options = TypeVar("Options", bound=SpecModel)

LEAST_SETS = 2
"""Of sets of images, each of a body of its own, over which a campaign is pooled."""
LEAST_DATABASE_IMAGES = 120
LEAST_OBSERVATIONS = 4
"""Of a landmark: of fewer, the covariance of its three coordinates is not known."""
LEAST_ARC_IMAGES = 24
"""Of an arc that is imaged: with fewer, craters are not seen from enough places to solve for an orbit."""


def kept(whole: int, share: float, least: int = 1) -> int:
    """Return how much of a number a draft keeps: its share, but no less than ``least`` where there are so many."""
    return max(min(whole, least), math.ceil(round(share * whole, 9)))


def as_draft(campaign: ResolvedCampaign, share: float) -> ResolvedCampaign:
    """Return a campaign with a share of the sets of images that it is pooled over, and of the images of an arc."""
    if share >= 1.0:
        return campaign
    scenarios = tuple(_shortened(one, share) for one in _fewer_sets(campaign.scenarios, share))
    names = {one.spec.name for one in scenarios}
    variations = {name: where for name, where in campaign.variations.items() if name in names}
    return replace(campaign, scenarios=scenarios, variations=variations, draft=share)


def drafted(options: Options, share: float) -> Options:
    """Ask for a share of the images that a data base is made of, and of those that must show a landmark."""
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
    """Keep the first scenarios of each that differ in the body alone and show sequences its images."""
    pools = [_pool(one) for one in scenarios]
    for number, (scenario, pool) in enumerate(zip(scenarios, pools, strict=True)):
        if not pool or pools[:number].count(pool) < kept(pools.count(pool), share, LEAST_SETS):
            yield scenario


def _pool(scenario: LoadedScenario) -> str:
    """Name what a scenario is pooled with; '' where sequences see no images."""
    sequence = scenario.spec.sequence
    if sequence is None or sequence.images is None:
        return ""
    return all_but_body(json.loads(canonical_json(scenario.spec)))


def _shortened(scenario: LoadedScenario, share: float) -> LoadedScenario:
    """Cut an arc whose images are rendered, at the same time from image to image."""
    orbit = scenario.spec.orbit
    if orbit is None or orbit.imaging is None or orbit.imaging.detections != "rendered":
        return scenario
    epochs = kept(orbit.imaging.epochs, share, LEAST_ARC_IMAGES)
    arc = orbit.arc.model_copy(update={"days": orbit.arc.days * epochs / orbit.imaging.epochs})
    imaging = orbit.imaging.model_copy(update={"epochs": epochs})
    shorter = orbit.model_copy(update={"arc": arc, "imaging": imaging})
    return replace(scenario, spec=scenario.spec.model_copy(update={"orbit": shorter}))
