"""The image-survey experiment: an arc of planned images, what they have in common, and the craters that they show.

No image is rendered and nothing is matched: rims are projected by geometry and a simulated detector errs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from campaign.kinds.crater_navigation.sights import Address, DrawnSights, open_sights
from campaign.kinds.crater_navigation.taken import NavigationTrial
from campaign.kinds.image_survey.coverage import Coverage, coverage
from campaign.kinds.orbit_determination.trial import checked_orbit_section, empty_row, open_orbit_world
from campaign.products import BuiltProduct, Shelf
from campaign.resolved import ResolvedCampaign
from campaign.trial.kind import Bench, Record, Records, Witness, add_records
from estimators.craters.navigation.stages import Stages
from estimators.craters.planning.plan import PLANNER, PLANNER_VERSION
from scenarios.craters.simulated import NO_CRATER
from scenarios.errors import BoresightError
from scenarios.load import LoadedScenario
from scenarios.orbits.flown import DAY_S
from scenarios.orbits.imaging import imaging_of
from scenarios.orbits.world import OrbitWorld
from scenarios.spec.orbit import ImagingSpec

IndexArray = NDArray[np.int64]

FEW = 7
"""So many craters or fewer are few: half the images of Cheng et al. (2003) have no more."""


@dataclass(frozen=True, eq=False)
class ImageSurvey:
    """Trials of one scenario; a trial is an arc.

    Parameters
    ----------
    name
        Of the scenario.
    world, sights
        The truth, and the craters that are seen of it.
    labels
        Of the planner; all are the same, as it has no options.
    seed
        Seed of the campaign.
    folder
        Where plans are left.
    """

    name: str
    world: OrbitWorld
    sights: DrawnSights
    labels: tuple[str, ...]
    seed: int
    folder: Path

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the planner."""
        if name != PLANNER:
            raise BoresightError(f"estimators: {name!r} has no part in image-survey: the only method is {PLANNER}")
        return PLANNER_VERSION

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, shelf: Shelf) -> list[BuiltProduct]:
        """Refuse options, and scenarios without planned images of drawn craters; there is nothing to build."""
        del shelf
        for entry in campaign.spec.estimators:
            if entry.options:
                raise BoresightError(f"estimators: {entry.label}: {next(iter(entry.options))}: there are no options")
        _imaging(scenario)
        return []

    @classmethod
    def open(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, bench: Bench) -> ImageSurvey:
        """Open the world."""
        world = open_orbit_world(scenario, campaign.seed)
        sights = open_sights(scenario, imaging_of(world), campaign.variant)
        if not isinstance(sights, DrawnSights):
            raise TypeError("the sights of drawn detections are not drawn")
        folder = bench.run / "plans" / scenario.spec.name
        return cls(scenario.spec.name, world, sights, campaign.labels, campaign.seed, folder)

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials under one label; there is nothing to show of them."""
        del witness
        return replace(self, labels=(label,))

    def run(self, trials: range) -> Records:
        """Run trials, in the order of trials and labels."""
        records: Records = {}
        for trial in trials:
            found = self._surveyed(trial)
            for label in self.labels:
                add_records(records, found, {"trial": trial, "scenario": self.name, "estimator": label})
        return records

    def _surveyed(self, trial: int) -> Records:
        """Plan the images of an arc, take them and count: records without their key."""
        try:
            taken = NavigationTrial.take(
                self.world, self.sights, self.seed, trial, Stages(self.folder / f"{trial:07d}")
            )
        except BoresightError as error:
            return {"rows": [{**empty_row(), "status": "failed", "reason": f"there is no such arc: {error}"}]}
        crater = []
        for number, view in enumerate(taken.views):
            drawn = self.sights.drawn(view, Address(self.seed, trial, number))
            crater.append(drawn[1] if drawn is not None else np.zeros(0, dtype=np.int64))
        numbers, hits = np.unique(np.concatenate(crater), return_counts=True)
        known = numbers != NO_CRATER
        covered = coverage(taken.views, self.sights.ground)
        images: list[Record] = [
            {
                "image": planned.number,
                "time_days": planned.time_s / DAY_S,
                "kind": planned.kind,
                "n_detections": len(own),
                "n_overlapping": int(covered.overlapping[k]),
                "n_similar": int(covered.similar[k]),
            }
            for k, (planned, own) in enumerate(zip(taken.plan, crater, strict=True))
        ]
        counts = np.array([len(one) for one in crater])
        return {
            "rows": [{**empty_row(), "status": "ok", "n_landmarks": int(known.sum())}],
            "surveyed_images": images,
            "surveyed_craters": [
                {"crater": int(number), "hits": int(count)}
                for number, count in zip(numbers[known], hits[known], strict=True)
            ],
            "diagnostics": [
                {"name": name, "value": float(value)} for name, value in _summary(counts, hits[known], covered).items()
            ],
        }


def _summary(counts: IndexArray, hits: IndexArray, covered: Coverage) -> dict[str, float]:
    """Sum an arc up: detections (n,) of its images, hits (m,) of its craters, and its coverage."""
    return {
        "images": len(counts),
        "detections": counts.sum(),
        "detections_an_image": counts.mean(),
        "few_craters_share": 100.0 * (counts <= FEW).mean(),
        "similar_image_share": 100.0 * (covered.similar > 0).mean(),
        "similar_images": np.median(covered.similar),
        "overlapping_images": np.median(covered.overlapping),
        "craters": len(hits),
        "hits_a_crater": hits.mean() if len(hits) else 0.0,
        "seen_once_share": 100.0 * (hits == 1).mean() if len(hits) else 0.0,
    }


def _imaging(scenario: LoadedScenario) -> ImagingSpec:
    section = checked_orbit_section(scenario).imaging
    if section is None or section.detections != "drawn":
        raise BoresightError(
            f"{scenario.path}: orbit.imaging: the experiment image-survey needs it, with detections: drawn"
        )
    return section
