"""The crater-navigation experiment: images are planned, taken, searched and matched, and an orbit comes of them.

Truth takes the images and scores what comes out; the chain between sees images, telemetry and what is known before, of
which centre of mass and the RMS error of the believed shape are the true ones, and the spin where nothing else is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from boresight.campaign.kinds.crater_navigation.score import (
    at_times,
    image_records,
    landmark_records,
    navigation_summary,
    truth_of_sightings,
)
from boresight.campaign.kinds.orbit_determination.score import check_orbit
from boresight.campaign.kinds.orbit_determination.trial import (
    DeterminedOrbit,
    checked_orbit_section,
    empty_row,
    open_orbit_world,
    scored_orbit,
)
from boresight.campaign.pool.guard import Call
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.crater_score import check_listed
from boresight.campaign.trial.kind import Record, Records, Witness, WorkerContext, each_trial
from boresight.campaign.trial.methods import Unbuilt, methods, require_built
from boresight.campaign.trial.work import GaveUpError, Work
from boresight.estimators.craters.navigation.rounds import CraterNavigation, NavigationResult
from boresight.estimators.craters.navigation.stages import StageFiles
from boresight.estimators.craters.registry import (
    crater_detector_class,
    crater_detector_names,
    crater_matcher_class,
    crater_matcher_names,
)
from boresight.estimators.orbit.batch_filter import BatchFilter
from boresight.estimators.orbit.contract import OrbitData, OrbitEstimate
from boresight.scenarios.dynamics.propagation import OrbitLostError
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.orbits.imaging import epochs_s, imaging_of
from boresight.scenarios.orbits.world import OrbitWorld

_FOLDER = "chain"


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """Result of a chain: its images, all rounds, and the last round's orbit at the scored times."""

    searched: Sequence[SearchedImage]
    navigation: NavigationResult
    estimate: OrbitEstimate
    data: OrbitData


@dataclass(frozen=True, eq=False)
class CraterNavigationTrials:
    """Trials of one scenario with a set of labelled chains; all see the same images.

    Parameters
    ----------
    name
        Of the scenario.
    world, sights
        The truth, and what a camera sees of it.
    navigators
        Label to chain; of one that cannot be built, why.
    seed
        Seed of the campaign.
    folder
        Where the stages leave their files, a folder for each trial.
    witness
        Shown the `DeterminedOrbit` that every chain comes to; or None.
    """

    name: str
    world: OrbitWorld
    sights: CraterSights
    navigators: Mapping[str, CraterNavigation | Unbuilt]
    seed: int
    folder: Path
    witness: Witness | None = None

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of the chain: the sum of those of its parts, which only rise."""
        if name != CraterNavigation.name:
            raise BoresightError(
                f"estimators: {name} is no chain of crater-navigation; there is: {CraterNavigation.name}"
            )
        detectors = [crater_detector_class(one).version for one in crater_detector_names()]
        matchers = [crater_matcher_class(one).version for one in crater_matcher_names()]
        return CraterNavigation.version + BatchFilter.version + sum(detectors) + sum(matchers)

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
    def methods(cls, campaign: ResolvedCampaign, scenario: LoadedScenario) -> dict[str, CraterNavigation | Unbuilt]:
        """Build the chains; refuse wrong options."""
        return methods(campaign, scenario, lambda entry: CraterNavigation.from_options(entry.options))

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext
    ) -> CraterNavigationTrials:
        """Open the world and build the chains."""
        world = open_orbit_world(scenario, campaign.seed)
        sights = open_sights(scenario, imaging_of(world), campaign.variant)
        folder = context.run / _FOLDER / scenario.spec.name
        return cls(scenario.spec.name, world, sights, cls.methods(campaign, scenario), campaign.seed, folder)

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one chain, shown to a witness; stages that are stored are read back."""
        return replace(self, navigators={label: self.navigators[label]}, witness=witness)

    def run(self, trials: range) -> Records:
        """Run trials, in the order of trials and chains."""
        return each_trial(trials, self.name, self._trial)

    def _trial(self, trial: int) -> dict[str, Records]:
        """Take the images of a trial and let each chain work; where there is no arc, none has images."""
        stages = StageFiles(self.folder / f"{trial:07d}")
        try:
            taken = NavigationTrial.take(self.world, self.sights, self.seed, trial, stages)
        except BoresightError as error:
            row = {**empty_row(), "status": "failed", "reason": f"there is no such trial: {error}"}
            return {label: {"rows": [row]} for label in self.navigators}
        return {
            label: self._judged(Call(self.name, trial, label), one, taken, stages)
            for label, one in self.navigators.items()
        }

    def _judged(
        self, call: Call, one: CraterNavigation | Unbuilt, taken: NavigationTrial, stages: StageFiles
    ) -> Records:
        """Run a chain and score its result; return unkeyed records, error rows for failures."""
        row = {**empty_row(), "range_m": float(np.linalg.norm(taken.flown.wanted_states[0, :3]))}

        def work() -> _Answer:
            navigator = require_built(one)
            task = own_copy(taken.task)
            searched = taken.search(navigator, task, stages)
            try:
                navigation = navigator.navigate([image.exposure for image in searched], task, stages)
            except OrbitLostError as error:
                raise GaveUpError(f"the a priori orbit: {error}") from error
            last = navigation.rounds[-1]
            return _Answer(searched, navigation, *at_times(last.estimate, last.data, taken.task.wanted_s))

        def score(answer: _Answer) -> Records:
            timings: Records = {"timings": _timings(answer.navigation, stages, searched_in(require_built(one), stages))}
            return self._scored(answer, taken, row) | timings

        return Work(call, "chain", row).run(work, lambda answer: check_orbit(answer.estimate, answer.data), score)

    def _scored(self, answer: _Answer, taken: NavigationTrial, row: Record) -> Records:
        """Score images, matches, landmarks and the orbit."""
        searched, estimate, data = answer.searched, answer.estimate, answer.data
        last, crater = answer.navigation.rounds[-1], [image.crater for image in searched]
        records: Records = {
            "navigation": [navigation_summary(answer.navigation, searched, len(epochs_s(self.world)))],
            "navigated_images": image_records(taken, searched, last),
        }
        truth = truth_of_sightings(self.world, taken, last, crater)
        if self.witness is not None:
            self.witness(DeterminedOrbit(self.world, truth, data, estimate))
        scored = scored_orbit(estimate, truth, data, row, with_residuals=taken.address.trial == 0)
        used = estimate.orbit.used if estimate.status == "ok" and estimate.orbit is not None else None
        records["navigated_landmarks"] = landmark_records(data, truth.crater, used)
        return records | scored


def _timings(navigation: NavigationResult, stages: StageFiles, searched: StageFiles) -> list[Record]:
    """List the time of each stage over all starts of the trial."""
    spent = {**stages.seconds(), **searched.seconds(), **navigation.seconds}
    return [{"stage": stage, "seconds": seconds} for stage, seconds in spent.items()]
