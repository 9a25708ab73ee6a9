"""Kind of trial: the planned images of an arc, what they have in common, and the craters that they show.

No image is rendered and nothing is matched: rims are projected by geometry and a simulated detector errs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.kinds.crater_navigation.images import Address, DrawnSights, NavigationTrial, open_sights
from boresight.campaign.kinds.orbit_determination import checked_orbit_section, open_orbit_world
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import Record, Records, WorkerContext, check_only_method
from boresight.campaign.trial.runner import TrialRunner, located
from boresight.campaign.trial.unused import LENS, OF_IMAGES, OF_OBSERVATIONS
from boresight.estimators.craters.contract import GroundModel
from boresight.estimators.craters.matching.preliminary import lit_points
from boresight.estimators.craters.navigation.rounds import StageFiles
from boresight.estimators.craters.planning import PLANNER, PLANNER_VERSION
from boresight.scenarios.arrays import IndexArray
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import View
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.orbits.true_orbit import DAY_S, imaging_of
from boresight.scenarios.orbits.world import OrbitWorld
from boresight.scenarios.spec.scenario import ScenarioSpec

FEW = 7
"""So many craters or fewer are few: half the images of Cheng et al. (2003) have no more."""

SIMILAR_DEG = 10.0
"""Directions of the Sun, in body axes, that differ by no more are similar, as Cheng et al. (2003) print."""

OVERLAP = 0.1
"""Share of a lit region that the other image shows where two cover the same area, as preliminary matching asks."""

_SIDE = 6


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Number of other images that overlap each of n images, (n,), and of those in similar light."""

    overlapping: NDArray[np.int64]
    similar: NDArray[np.int64]


def coverage(views: Sequence[View], ground: GroundModel) -> Coverage:
    """Count, for each of n views of one camera, the others that show the same lit ground.

    A point of an image's grid is shown by another where that faces it and has it in the frame; what stands between and
    shadows are left out of account.
    """
    n = len(views)
    rotations = np.array([view.T_cam_body.rotation for view in views]).reshape(n, 3, 3)
    shifts = np.array([view.T_cam_body.translation_m for view in views]).reshape(n, 3)
    positions = np.array([view.T_cam_body.camera_position_m for view in views]).reshape(n, 3)
    suns = np.array([view.sun_dir_body for view in views]).reshape(n, 3)
    shown = np.zeros((n, n))
    for i, view in enumerate(views):
        points, normals = lit_points(view.camera, view.T_cam_body, view.sun_dir_body, ground, _SIDE)
        if not len(points):
            continue
        seen = points @ np.swapaxes(rotations, 1, 2) + shifts[:, None]
        inside = view.camera.contains(view.camera.project(seen.reshape(-1, 3))).reshape(n, -1)
        facing = np.einsum("ki,nki->nk", normals, positions[:, None] - points) > 0.0
        shown[i] = (inside & facing & (suns @ normals.T > 0.0)).mean(axis=1)
    same = np.maximum(shown, shown.T) >= OVERLAP
    np.fill_diagonal(same, False)
    alike = suns @ suns.T >= np.cos(np.radians(SIMILAR_DEG))
    return Coverage(same.sum(axis=1), (same & alike).sum(axis=1))


@dataclass(frozen=True, eq=False)
class ImageSurvey(TrialRunner[None, NavigationTrial, NavigationTrial]):
    """Trials of the planner; a trial is an arc, which is counted as it was drawn: there is nothing to ask.

    Plans are left in ``folder``.
    """

    name = "image-survey"
    version = 1
    block_trials = 1
    undrawable = (BoresightError,)
    undrawable_reason = "there is no such arc"

    world: OrbitWorld
    sights: DrawnSights
    folder: Path

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the planner."""
        check_only_method(cls.name, PLANNER, name)
        return PLANNER_VERSION

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a scenario without planned images of drawn craters."""
        section = checked_orbit_section(scenario).imaging
        if section is None or section.detections != "drawn":
            raise BoresightError(
                f"{scenario.path}: orbit.imaging: the experiment image-survey needs it, with detections: drawn"
            )

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        return (*OF_IMAGES, *OF_OBSERVATIONS, *LENS, "orbit.sightings", "orbit.radiometry")

    @classmethod
    def build_methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, None]:
        """Refuse options."""
        for entry in campaign.spec.estimators:
            with located(campaign, entry.label):
                if entry.options:
                    raise BoresightError(
                        f"{entry.label}.{next(iter(entry.options))}: unknown key; there are no options"
                    )
        return dict.fromkeys(campaign.labels)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the world."""
        world = open_orbit_world(scenario, campaign.seed, number)
        sights = open_sights(scenario, imaging_of(world), campaign.variant)
        if not isinstance(sights, DrawnSights):
            raise TypeError("the sights of drawn detections are not drawn")
        folder = context.run / "plans" / scenario.spec.name
        return cls.made(campaign, scenario, number, world=world, sights=sights, folder=folder)

    def draw(self, trial: int) -> NavigationTrial:
        """Plan the images of an arc, and take them."""
        return NavigationTrial.take(self.world, self.sights, self.seed, trial, StageFiles(self.folder / f"{trial:07d}"))

    def ask(self, method: None, drawn: NavigationTrial) -> NavigationTrial:
        """Return the arc."""
        return drawn

    def score(self, answer: NavigationTrial, drawn: NavigationTrial) -> Records:
        """Count what the images of an arc have in common, and the craters that they show."""
        addresses = [Address(self.seed, drawn.address.trial, number) for number in range(len(drawn.views))]
        crater = [self.sights.drawn(*seen)[1] for seen in zip(drawn.views, addresses, strict=True)]
        numbers, hits = np.unique(np.concatenate(crater), return_counts=True)
        known = numbers != NO_CRATER
        covered = coverage(drawn.views, self.sights.ground)
        images: list[Record] = [
            {
                "image": planned.number,
                "time_days": planned.time_s / DAY_S,
                "kind": planned.kind,
                "n_detections": len(own),
                "n_overlapping": int(covered.overlapping[k]),
                "n_similar": int(covered.similar[k]),
            }
            for k, (planned, own) in enumerate(zip(drawn.plan, crater, strict=True))
        ]
        counts = np.array([len(one) for one in crater])
        return {
            "rows": [{"status": "ok", "reason": "", "n_landmarks": int(known.sum())}],
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


KIND = ImageSurvey
