"""The chain from detected craters to an orbit: image pairs, matches, database, orbit; repeated until it is accepted.

The result of each stage is a file, from which an interrupted chain continues.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from boresight.estimators.craters.contract import (
    CraterDetections,
    CraterDetector,
    CraterImage,
    CraterMatcher,
    CraterMatches,
    GroundModel,
)
from boresight.estimators.craters.database.files import LANDMARKS, CraterDatabase, read_matches, write_matches
from boresight.estimators.craters.database.landmarks import (
    Numbering,
    PairMatches,
    landmarks_for_orbit,
    locate_landmarks,
    number_craters,
    numbered_pictures,
    pictures_for_orbit,
)
from boresight.estimators.craters.matching.preliminary import PreliminaryOptions, preliminary_pairs
from boresight.estimators.craters.navigation.trajectory import (
    Exposure,
    NavigationTask,
    Trajectory,
    images_along_trajectory,
)
from boresight.estimators.options import Configured
from boresight.estimators.orbit.batch_filter import BatchFilter
from boresight.estimators.orbit.contract import OrbitEstimate
from boresight.estimators.orbit.parameters import OrbitOptions
from boresight.estimators.registry import crater_detector_class, crater_matcher_class
from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.atomic import write_text
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.observation import Frame
from boresight.scenarios.orbits.data import OrbitData
from boresight.scenarios.reading import read_json
from boresight.scenarios.spec.base import SpecModel

T = TypeVar("T")

_SECONDS = "seconds.json"


@dataclass(frozen=True, slots=True)
class StageFiles:
    """A folder with one file for each finished part of a stage, and the computing time of the stages."""

    folder: Path

    def subfolder(self, name: str) -> StageFiles:
        """Return the files of a folder within."""
        return StageFiles(self.folder / name)

    def cached(self, name: str, stage: str, make: Callable[[Path], None], read: Callable[[Path], T]) -> T:
        """Read a file; make it first if it does not exist, and add the time to that of the stage."""
        path = self.folder / name
        if not path.exists():
            with self.timed(stage):
                make(path)
        return read(path)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time of the block to that of a stage, unless it raises."""
        started = time.perf_counter()
        yield
        spent = self.seconds()
        spent[stage] = spent.get(stage, 0.0) + time.perf_counter() - started
        write_text(self.folder / _SECONDS, json.dumps(spent))

    def seconds(self) -> dict[str, float]:
        """Return the time that each stage took, over all starts.

        Raise BoresightError if the file of times is damaged.
        """
        path = self.folder / _SECONDS
        spent = read_json(path, "the times of stages") if path.exists() else {}
        if not isinstance(spent, dict) or not all(isinstance(seconds, (int, float)) for seconds in spent.values()):
            raise BoresightError(f"{path}: does not hold the times of stages: remove it, and the run goes on")
        return dict(spent)


_MATCHING = "matching"
_BLOCK = 50  # pairs of images in one file: so many are matched again after an interruption


class NavigationOptions(SpecModel):
    """Options of ``crater-navigation``."""

    detector: str = Field("crater-classic", description="Name of a detector of craters")
    most_detections: int = Field(20, ge=1, description="Most detections of an image")
    matcher: str = Field("hybrid", description="Name of a matcher of craters")
    agreeing: int = Field(
        3, ge=1, description="Least matches of a pair of images: one or two alone are no constellation"
    )
    preliminary: PreliminaryOptions = Field(
        PreliminaryOptions(), description="Which images are matched; heights are as uncertain as the a priori shape"
    )
    orbit: OrbitOptions = Field(OrbitOptions(), description="Options of the batch filter")
    rounds: int = Field(
        3, ge=1, le=10, description="How often matching and orbit determination are done at most, until one is accepted"
    )


@dataclass(frozen=True, slots=True, eq=False)
class NavigationRound:
    """One pass through the chain: matches of each pair of images, numbers of all detections, and the orbit.

    ``data`` is the input of orbit determination, from the database as read back from its files; the ``positions_m`` of
    ``estimate`` are those at ``data.wanted_s``.
    """

    found: tuple[PairMatches, ...]
    numbering: Numbering
    data: OrbitData
    estimate: OrbitEstimate


@dataclass(frozen=True, slots=True, eq=False)
class NavigationResult:
    """All rounds, and the computing time of each stage by its name."""

    rounds: tuple[NavigationRound, ...]
    seconds: Mapping[str, float]


class CraterNavigation(Configured[NavigationOptions]):
    """Determines an orbit from images by craters, as Cheng et al. (2003) do."""

    name: ClassVar[str] = "crater-navigation"
    version: ClassVar[int] = 1
    options_model = NavigationOptions

    def __init__(self, options: NavigationOptions) -> None:
        super().__init__(options)
        crater_matcher_class(options.matcher)  # refuse an unknown name before the first trial
        self.detector: CraterDetector = crater_detector_class(options.detector).from_options({})
        self._filter = BatchFilter(options.orbit)

    def detect(self, frame: Frame, task: NavigationTask) -> tuple[CraterDetections, str]:
        """Find the most confident craters of an image; none if the image is unusable, with the reason."""
        try:
            found = self.detector.detect(frame, task.knowledge.camera)
        except BoresightError as error:
            return CraterDetections.none(), str(error)
        return self.most_confident(found), ""

    def most_confident(self, found: CraterDetections) -> CraterDetections:
        """Keep the most confident detections."""
        kept = slice(0, self.options.most_detections)
        return CraterDetections(found.ellipses[kept], found.confidence[kept])

    def navigate(self, exposures: Sequence[Exposure], task: NavigationTask, stages: StageFiles) -> NavigationResult:
        """Repeat rounds until an orbit is accepted, none is found, or the limit on rounds is reached.

        Raise OrbitLostError if the a priori orbit hits the body.
        """
        times = np.array([exposure.time_s for exposure in exposures])
        trajectory, rounds = Trajectory.a_priori(task.knowledge, times), []
        wanted = np.unique(np.concatenate([task.wanted_s, times]))
        spent: dict[str, float] = {}
        for _ in range(self.options.rounds):
            images = images_along_trajectory(exposures, trajectory, task)
            options = self.options
            key = matching_key(images, options.matcher, options.preliminary, task.shape.height_sigma_m)
            own = stages.subfolder(f"{options.matcher}-{key}")
            rounds.append(self._round(images, task, wanted, own))
            for stage, seconds in own.seconds().items():
                spent[stage] = spent.get(stage, 0.0) + seconds
            estimate = rounds[-1].estimate
            if estimate.status == "ok" or estimate.orbit is None:
                break
            # A rejected orbit has residuals larger than expected: its covariance is scaled by their chi-square.
            inflation = max(1.0, estimate.diagnostics["chi_square_per_freedom"])
            trajectory = Trajectory.from_orbit(estimate.orbit, times, wanted, inflation)
        return NavigationResult(tuple(rounds), spent)

    def _round(
        self, images: Sequence[CraterImage], task: NavigationTask, wanted_s: FloatArray, stages: StageFiles
    ) -> NavigationRound:
        """Match, number, write the database, read it back and determine the orbit."""
        options, ground = self.options, task.shape.ground
        preliminary = options.preliminary.model_copy(update={"height_sigma_m": task.shape.height_sigma_m})
        with stages.timed("preliminary"):
            pairs = preliminary_pairs(images, ground, preliminary).pairs
        # The matcher that has an option for the uncertainty of the shape's height.
        asked = {"height_sigma_m": task.shape.height_sigma_m} if options.matcher == "vote" else {}
        matcher = crater_matcher_class(options.matcher).from_options(asked)
        found = reject_small_matches(match_pairs(images, pairs, matcher, ground, stages), options.agreeing)
        numbering = number_craters([len(image.detections.ellipses) for image in images], found)

        def build(path: Path) -> None:
            landmarks = locate_landmarks(images, numbering, ground, task.shape.height_sigma_m)
            CraterDatabase(numbered_pictures(images, numbering, landmarks.number), landmarks).save(path.parent)

        place = f"database-{options.agreeing}/{LANDMARKS}"
        # Read back from its files, so that a continued chain has the same input as an uninterrupted one.
        database = stages.cached(place, "database", build, lambda path: CraterDatabase.load(path.parent))
        known = task.knowledge
        data = OrbitData(
            known,
            pictures_for_orbit(database.pictures, known.camera, known.field.rotation),
            landmarks_for_orbit(database.landmarks, task.shape.centre_of_mass_m),
            task.radiometry,
            wanted_s,
        )
        with stages.timed("orbit"):
            estimate = self._filter.determine(data)
        return NavigationRound(found, numbering, data, estimate)


def match_pairs(
    images: Sequence[CraterImage],
    pairs: NDArray[np.int64],
    matcher: CraterMatcher,
    ground: GroundModel,
    stages: StageFiles,
) -> tuple[PairMatches, ...]:
    """Match the pairs (k, 2) of images, by their places in the sequence; finished blocks are read from files."""
    found: list[PairMatches] = []
    for start in range(0, len(pairs), _BLOCK):
        block = pairs[start : start + _BLOCK]

        def match(path: Path, block: NDArray[np.int64] = block) -> None:
            ones = [PairMatches(i, j, matcher.match(images[i], images[j], ground)) for i, j in block.tolist()]
            write_matches(path, ones)

        found += stages.cached(f"pairs-{start // _BLOCK:05d}.txt", _MATCHING, match, read_matches)
    return tuple(found)


def reject_small_matches(found: Sequence[PairMatches], agreeing: int) -> tuple[PairMatches, ...]:
    """Reject the pairs of images with fewer matches than ``agreeing``."""
    return tuple(
        replace(pair, matches=CraterMatches.none(f"{count} matches are fewer than the {agreeing} that have to agree"))
        if 0 < (count := len(pair.matches.pairs)) < agreeing
        else pair
        for pair in found
    )


def matching_key(images: Sequence[CraterImage], *what: object) -> str:
    """Hash poses, uncertainties and craters of images, and the repr of everything else their matches depend on."""
    digest = hashlib.sha256(repr(what).encode())
    for image in images:
        pose, rims = image.frame.prior_T_cam_body, image.detections.ellipses
        placed = (pose.rotation, pose.translation_m, image.frame.prior_covariance, image.common)
        for part in (*placed, rims.centre_px, rims.semi_axes_px, rims.angle_rad):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()[:16]
