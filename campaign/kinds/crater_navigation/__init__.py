"""Kind of trial: an orbit from images of craters, which are planned, taken, searched and matched.

Truth takes the images and scores what comes out; the chain between sees images, telemetry and what is known before, of
which centre of mass and the RMS error of the believed shape are the true ones, and the spin where nothing else is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from boresight.campaign.handles import own_copy
from boresight.campaign.kinds.crater_navigation.images import (
    CraterSights,
    NavigationTrial,
    SearchedImage,
    open_sights,
    searched_in,
)
from boresight.campaign.kinds.orbit_determination import (
    DeterminedOrbit,
    check_orbit,
    checked_orbit_section,
    open_orbit_world,
    scored_orbit,
)
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.campaign.trial.runner import GaveUpError, MethodRunner
from boresight.campaign.trial.score import check_listed
from boresight.campaign.trial.unused import LENS, OF_IMAGES, OF_OBSERVATIONS, SUN_OF_VIEWS
from boresight.estimators.craters.navigation.rounds import (
    CraterNavigation,
    NavigationResult,
    NavigationRound,
    StageFiles,
)
from boresight.estimators.orbit.batch_filter import BatchFilter
from boresight.estimators.orbit.contract import OrbitData, OrbitEstimate
from boresight.estimators.registry import crater_matcher_class, crater_matcher_names, named_detector_versions
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.craters.simulated import NO_CRATER
from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.orbits.draw import OrbitTruth
from boresight.scenarios.orbits.true_orbit import DAY_S, epochs_s, imaging_of
from boresight.scenarios.orbits.world import OrbitWorld
from boresight.scenarios.spec.scenario import ScenarioSpec


@dataclass(frozen=True, slots=True, eq=False)
class NavigationAnswer:
    """Result of a chain: its images and their folder, all rounds, and the last round's orbit at the scored times."""

    searched: Sequence[SearchedImage]
    searched_in: StageFiles
    navigation: NavigationResult
    estimate: OrbitEstimate
    data: OrbitData


@dataclass(frozen=True, eq=False)
class CraterNavigationTrials(MethodRunner[CraterNavigation, NavigationTrial, NavigationAnswer]):
    """Trials of chains of crater navigation; all see the same images.

    ``folder`` has a folder for each trial, where the stages leave their files; those that are there are read back.
    """

    name = "crater-navigation"
    version = 2
    block_trials = 1
    called = "chain"
    undrawable = (BoresightError,)

    world: OrbitWorld
    sights: CraterSights
    folder: Path

    @classmethod
    def method_class(cls, name: str) -> type[CraterNavigation]:
        if name != CraterNavigation.name:
            raise BoresightError(
                f"estimators: {name} is no chain of crater-navigation; there is: {CraterNavigation.name}"
            )
        return CraterNavigation

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the chain: the sum of those of its parts, which only rise."""
        matchers = [crater_matcher_class(one).version for one in crater_matcher_names()]
        return cls.method_class(name).version + BatchFilter.version + sum(named_detector_versions()) + sum(matchers)

    @classmethod
    def options_model(cls, name: str) -> None:
        """Return None: the length among the options is replaced by the error of the a priori shape."""

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse missing sections, and craters of which most that a detector finds are not listed."""
        imaging = checked_orbit_section(scenario).imaging
        if imaging is None:
            raise BoresightError(
                f"{scenario.path}: orbit.imaging: missing, but the experiment crater-navigation needs it"
            )
        if imaging.detections == "rendered":
            check_listed(scenario)

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        imaging = None if spec.orbit is None else spec.orbit.imaging
        if imaging is not None and imaging.detections == "drawn":
            return (*OF_IMAGES, *OF_OBSERVATIONS, *LENS, "orbit.sightings")
        drawn = ("orbit.sightings", "orbit.imaging.craters", "orbit.imaging.errors")
        return (*SUN_OF_VIEWS, *OF_OBSERVATIONS, *LENS, *drawn)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Open the world and build the chains."""
        world = open_orbit_world(scenario, campaign.seed, number)
        sights = open_sights(scenario, imaging_of(world), campaign.variant)
        folder = context.run / "chain" / scenario.spec.name
        return cls.made(campaign, scenario, number, world=world, sights=sights, folder=folder)

    def draw(self, trial: int) -> NavigationTrial:
        """Plan the images of a trial and take them; there may be no arc."""
        return NavigationTrial.take(self.world, self.sights, self.seed, trial, StageFiles(self.folder / f"{trial:07d}"))

    def row(self, drawn: NavigationTrial) -> Record:
        return {"n_landmarks": 0, "range_m": float(np.linalg.norm(drawn.flown.wanted_states[0, :3]))}

    def ask(self, method: CraterNavigation, drawn: NavigationTrial) -> NavigationAnswer:
        """Let a chain search its images and solve for the orbit."""
        task, stages = own_copy(drawn.task), drawn.stages
        searched = drawn.search(method, task)
        try:
            navigation = method.navigate([image.exposure for image in searched], task, stages)
        except OrbitLostError as error:
            raise GaveUpError(f"the a priori orbit: {error}") from error
        last = navigation.rounds[-1]
        scored = at_times(last.estimate, last.data, drawn.task.wanted_s)
        return NavigationAnswer(searched, searched_in(method, stages), navigation, *scored)

    def check(self, answer: NavigationAnswer, drawn: NavigationTrial) -> None:
        check_orbit(answer.estimate, answer.data)

    def score(self, answer: NavigationAnswer, drawn: NavigationTrial) -> Records:
        """Score images, matches, landmarks and the orbit, with the times of all starts of the trial."""
        searched, estimate, data = answer.searched, answer.estimate, answer.data
        truth = self._truth(answer, drawn)
        used = estimate.orbit.used if estimate.status == "ok" and estimate.orbit is not None else None
        spent = {**drawn.stages.seconds(), **answer.searched_in.seconds(), **answer.navigation.seconds}
        return {
            "navigation": [navigation_summary(answer.navigation, searched, len(epochs_s(self.world)))],
            "navigated_images": image_records(drawn, searched, answer.navigation.rounds[-1]),
            "navigated_landmarks": landmark_records(data, truth.crater, used),
            "timings": [{"stage": stage, "seconds": seconds} for stage, seconds in spent.items()],
            **scored_orbit(estimate, truth, data, with_residuals=drawn.address.trial == 0),
        }

    def shown(self, answer: NavigationAnswer | None, drawn: NavigationTrial) -> DeterminedOrbit | None:
        """Return the orbit that a chain has determined; None where there is none."""
        if answer is None:
            return None
        return InspectedTrial(self._truth(answer, drawn), answer.data, answer.estimate)

    def _truth(self, answer: NavigationAnswer, drawn: NavigationTrial) -> OrbitTruth:
        true = sighted_craters(answer.navigation.rounds[-1], [image.crater for image in answer.searched])
        return OrbitTruth(
            states=drawn.flown.wanted_states,
            image_states=drawn.flown.image_states,
            crater=true,
            wrong=true < 0,
            points_body_m=np.zeros((0, 3)),
            gm_m3_s2=self.world.spec.asteroid.gm_m3_s2,
            light_m_s2=self.world.light_m_s2,
        )


def told_apart(crater: Sequence[IndexArray]) -> list[IndexArray]:
    """Give each detection that is no crater a negative number of its own: two of them are never the same."""
    told, lowest = [], NO_CRATER
    for one in crater:
        own, none = one.copy(), np.flatnonzero(one == NO_CRATER)
        own[none] = lowest - np.arange(len(none))
        lowest -= len(none)
        told.append(own)
    return told


def match_counts(done: NavigationRound, crater: Sequence[IndexArray]) -> tuple[int, int, int]:
    """Count correct and wrong matches, and craters that two matched images have in common."""
    told, correct, wrong, common = told_apart(crater), 0, 0, 0
    for pair in done.found:
        here, there = told[pair.first], told[pair.second]
        same = here[pair.matches.pairs[:, 0]] == there[pair.matches.pairs[:, 1]]
        correct, wrong = correct + int(same.sum()), wrong + int((~same).sum())
        common += len(np.intersect1d(here, there))
    return correct, wrong, common


def sighted_craters(done: NavigationRound, crater: Sequence[IndexArray]) -> IndexArray:
    """(K,) true crater of each sighting of the data base, by its image and its number."""
    told = told_apart(crater)
    of = {
        (image, int(number)): int(true)
        for image, (numbers, own) in enumerate(zip(done.numbering.numbers, told, strict=True))
        for number, true in zip(numbers, own, strict=True)
        if number >= 0
    }
    seen = zip(done.data.pictures.image.tolist(), done.data.pictures.landmark.tolist(), strict=True)
    return np.array([of[one] for one in seen], dtype=np.int64)


def at_times(estimate: OrbitEstimate, data: OrbitData, wanted_s: FloatArray) -> tuple[OrbitEstimate, OrbitData]:
    """Leave out of an orbit the times that are not among (E,) wanted ones; all of these were asked for."""
    rows = np.searchsorted(data.wanted_s, wanted_s)
    orbit = estimate.orbit
    if orbit is not None:
        orbit = replace(
            orbit,
            positions_m=orbit.positions_m[rows],
            velocities_m_s=orbit.velocities_m_s[rows],
            position_covariances_m2=orbit.position_covariances_m2[rows],
        )
    return replace(estimate, orbit=orbit), replace(data, wanted_s=wanted_s)


def navigation_summary(navigation: NavigationResult, searched: Sequence[SearchedImage], epochs: int) -> Record:
    """Sum the chain up: the columns of the table ``navigation`` without its key."""
    crater, last = [image.crater for image in searched], navigation.rounds[-1]
    correct, wrong, common = match_counts(last, crater)
    numbers = last.numbering.numbers
    return {
        "rounds": len(navigation.rounds),
        "epochs": epochs,
        "n_images": len(searched),
        "n_blind": sum(bool(image.reason) for image in searched),
        "n_detections": sum(len(one) for one in crater),
        "n_false": sum(int((one == NO_CRATER).sum()) for one in crater),
        "n_pairs": len(last.found),
        "n_correct": correct,
        "n_wrong": wrong,
        "n_common": common,
        "n_conflicts": last.numbering.conflicts,
        "n_numbered": sum(int((one >= 0).sum()) for one in numbers),
        "n_landmarks": last.numbering.count,
    }


def image_records(trial: NavigationTrial, searched: Sequence[SearchedImage], last: NavigationRound) -> list[Record]:
    """List the images: the columns of the table ``navigated_images`` without its key."""
    records: list[Record] = []
    for planned, view, image, numbers in zip(trial.plan, trial.views, searched, last.numbering.numbers, strict=True):
        records.append(
            {
                "image": planned.number,
                "time_days": planned.time_s / DAY_S,
                "kind": planned.kind,
                "phase_deg": float(np.degrees(view.phase_angle_rad)),
                "n_detections": len(image.crater),
                "n_false": int((image.crater == NO_CRATER).sum()),
                "n_numbered": int((numbers >= 0).sum()),
                "reason": image.reason,
            }
        )
    return records


def landmark_records(data: OrbitData, crater: IndexArray, used: BoolArray | None) -> list[Record]:
    """List the landmarks of the data base: the columns of the table ``navigated_landmarks`` without its key.

    ``crater`` is (K,) the true one of each sighting; ``used`` (K,) tells which of them the orbit rests on, None without
    an orbit.
    """
    records: list[Record] = []
    times = data.pictures.times_s[data.pictures.image] / DAY_S
    for number in data.landmarks.numbers:
        rows = np.flatnonzero(data.pictures.landmark == number)
        craters, counts = np.unique(crater[rows], return_counts=True)
        records.append(
            {
                "landmark": int(number),
                "hits": len(rows),
                "crater": max(int(craters[np.argmax(counts)]), NO_CRATER),
                "n_other": len(rows) - int(counts.max()),
                "n_used": None if used is None else int(used[rows].sum()),
                "first_days": float(times[rows].min()),
                "last_days": float(times[rows].max()),
            }
        )
    return records


KIND = CraterNavigationTrials
