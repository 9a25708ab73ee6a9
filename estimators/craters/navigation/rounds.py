"""The chain from detected craters to an orbit: pairs, matches, data base, orbit; again where it is not accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from estimators.craters.contract import CraterDetections, CraterDetector, CraterImage
from estimators.craters.database.files import LANDMARKS, CraterDatabase
from estimators.craters.database.landmarks import locate_landmarks
from estimators.craters.database.numbering import Numbering, PairMatches, number_craters
from estimators.craters.database.orbit_input import places_of_landmarks, sequence_of_pictures
from estimators.craters.database.pictures import placed_pictures
from estimators.craters.matching.preliminary import PreliminaryOptions, preliminary_pairs
from estimators.craters.navigation.matched import believed, match_pairs, matching_key, placed_images
from estimators.craters.navigation.stages import Stages
from estimators.craters.navigation.task import Exposure, NavigationTask
from estimators.craters.navigation.trajectory import Trajectory
from estimators.craters.registry import crater_detector_class, crater_matcher_class
from estimators.options import parse_options
from estimators.orbit.batch_filter import BatchFilter
from estimators.orbit.contract import OrbitEstimate
from estimators.orbit.options import OrbitOptions
from scenarios.errors import BoresightError
from scenarios.observation import Frame
from scenarios.orbits.data import OrbitData
from scenarios.spec.base import SpecModel

FloatArray = NDArray[np.float64]


class NavigationOptions(SpecModel):
    """Options of ``crater-navigation``."""

    detector: str = Field("crater-classic", description="Name of a detector of craters")
    most_detections: int = Field(20, ge=1, description="Of an image, the most confident ones")
    matcher: str = Field("hybrid", description="Name of a matcher of craters")
    agreeing: int = Field(
        3, ge=1, description="Matches that a pair of images has at the least: one or two alone are no constellation"
    )
    preliminary: PreliminaryOptions = Field(
        PreliminaryOptions(), description="Which images are matched; heights are as uncertain as the a priori shape"
    )
    orbit: OrbitOptions = Field(OrbitOptions(), description="Of the batch filter")
    rounds: int = Field(
        3, ge=1, le=10, description="How often matching and orbit determination are done at most, until one is accepted"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One time around.

    Parameters
    ----------
    found
        What the matcher said of each pair of images, by their places in the sequence.
    numbering
        Numbers of all detections.
    data
        What orbit determination saw: the data base as it was read back.
    estimate
        The orbit; ``positions_m`` are those at ``data.wanted_s``.
    """

    found: tuple[PairMatches, ...]
    numbering: Numbering
    data: OrbitData
    estimate: OrbitEstimate


@dataclass(frozen=True, slots=True, eq=False)
class Navigation:
    """All rounds, and the time that each stage took, by its name."""

    rounds: tuple[Round, ...]
    seconds: Mapping[str, float]


class CraterNavigation:
    """Determines an orbit from images by craters, as Cheng et al. (2003) do."""

    name: ClassVar[str] = "crater-navigation"
    version: ClassVar[int] = 1

    def __init__(self, options: NavigationOptions) -> None:
        self.options = options
        self.detector: CraterDetector = crater_detector_class(options.detector).from_options({})
        self._filter = BatchFilter(options.orbit)

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options."""
        chosen = parse_options(NavigationOptions, options, cls.name)
        crater_matcher_class(chosen.matcher)
        return cls(chosen)

    def detect(self, frame: Frame, task: NavigationTask) -> tuple[CraterDetections, str]:
        """Find the most confident craters of an image; none where nothing can be seen in it, and why."""
        try:
            found = self.detector.detect(frame, task.knowledge.camera)
        except BoresightError as error:
            return CraterDetections.none(), str(error)
        return self.chosen(found), ""

    def chosen(self, found: CraterDetections) -> CraterDetections:
        """Keep the most confident detections."""
        kept = slice(0, self.options.most_detections)
        return CraterDetections(found.ellipses[kept], found.confidence[kept])

    def navigate(self, exposures: Sequence[Exposure], task: NavigationTask, stages: Stages) -> Navigation:
        """Go around until an orbit is accepted, no better trajectory comes of it, or the rounds are used up.

        Raises
        ------
        OrbitLostError
            If the a priori orbit leads into the body.
        """
        times = np.array([exposure.time_s for exposure in exposures])
        trajectory, rounds = Trajectory.known_before(task.knowledge, times), []
        wanted = np.unique(np.concatenate([task.wanted_s, times]))
        spent: dict[str, float] = {}
        for _ in range(self.options.rounds):
            images = placed_images(exposures, trajectory, task)
            own = stages.below(f"{self.options.matcher}-{self._key(images, task)}")
            rounds.append(self._round(images, task, wanted, own))
            for stage, seconds in own.seconds().items():
                spent[stage] = spent.get(stage, 0.0) + seconds
            estimate = rounds[-1].estimate
            if estimate.status == "ok" or estimate.orbit is None:
                break
            inflation = max(1.0, estimate.diagnostics["chi_square_per_freedom"])
            trajectory = Trajectory.determined(estimate.orbit, times, wanted, inflation)
        return Navigation(tuple(rounds), spent)

    def _key(self, images: Sequence[CraterImage], task: NavigationTask) -> str:
        options = self.options
        return matching_key(images, options.matcher, options.preliminary, task.shape.height_sigma_m)

    def _round(
        self, images: Sequence[CraterImage], task: NavigationTask, wanted_s: FloatArray, stages: Stages
    ) -> Round:
        """Match, number, write the data base, read it back and determine the orbit."""
        options, ground = self.options, task.shape.ground
        preliminary = options.preliminary.model_copy(update={"height_sigma_m": task.shape.height_sigma_m})
        with stages.timed("preliminary"):
            pairs = preliminary_pairs(images, ground, preliminary).pairs
        matcher = crater_matcher_class(options.matcher).from_options(self._matcher_options(task))
        found = believed(match_pairs(images, pairs, matcher, ground, stages), options.agreeing)
        numbering = number_craters([len(image.detections.ellipses) for image in images], found)

        def build(path: Path) -> None:
            landmarks = locate_landmarks(images, numbering, ground, task.shape.height_sigma_m)
            CraterDatabase(placed_pictures(images, numbering, landmarks.number), landmarks).save(path.parent)

        place = f"database-{options.agreeing}/{LANDMARKS}"
        database = stages.kept(place, "database", build, lambda path: CraterDatabase.load(path.parent))
        known = task.knowledge
        data = OrbitData(
            known,
            sequence_of_pictures(database, known.camera, known.field.rotation),
            places_of_landmarks(database, task.shape.centre_of_mass_m),
            task.radiometry,
            wanted_s,
        )
        with stages.timed("orbit"):
            estimate = self._filter.determine(data)
        return Round(found, numbering, data, estimate)

    def _matcher_options(self, task: NavigationTask) -> dict[str, object]:
        """Tell a matcher that asks for it how uncertain the shape's height is."""
        return {"height_sigma_m": task.shape.height_sigma_m} if self.options.matcher == "vote" else {}
