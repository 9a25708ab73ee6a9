"""Draft of a campaign: a reduced number of repetitions.

A draft makes all figures and tables of the campaign from fewer repetitions: it keeps a fraction of trials, data bases,
image sets and images, at least as many as a method needs. Estimators, grid levels, and sizes of bodies and images are
unchanged.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from boresight.reports.run.clusters import all_but_body
from boresight.scenarios.load import LoadedScenario, canonical_json
from boresight.scenarios.spec.base import SpecModel

if TYPE_CHECKING:
    from boresight.campaign.resolved import ResolvedCampaign

Options = TypeVar("Options", bound=SpecModel)

LEAST_SETS = 2
"""Least number of image sets, each of another body, whose results are pooled, and of data bases."""
LEAST_DATABASE_IMAGES = 120
LEAST_OBSERVATIONS = 4
"""Least number of observations of a landmark; fewer do not determine the covariance of its coordinates."""
LEAST_ARC_IMAGES = 24
"""Least number of images of an arc; with fewer, craters are not seen from enough positions to solve for an orbit."""


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
