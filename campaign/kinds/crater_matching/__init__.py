"""Kind of trial: craters identified in two images by each matcher, from the same detections."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from boresight.campaign.handles import own_copy
from boresight.campaign.kinds.crater_matching.pairs import (
    BY_GEOMETRY,
    ImagePairDraw,
    MatcherGround,
    PairSource,
    check_detector,
    open_pairs,
)
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.trial.checks import check_array, check_indices, check_reason
from boresight.campaign.trial.kind import InspectedTrial, Record, Records, WorkerContext
from boresight.campaign.trial.runner import MethodRunner, Unbuilt, located
from boresight.campaign.trial.score import view_columns
from boresight.campaign.trial.unused import LENS, OF_IMAGES, SUN_OF_VIEWS
from boresight.estimators.craters.contract import CraterDetections, CraterImage, CraterMatcher, CraterMatches
from boresight.estimators.craters.matching.context import epipolar_offsets
from boresight.estimators.registry import crater_detector_class, crater_detector_names, crater_matcher_class
from boresight.scenarios.bodies import load_body
from boresight.scenarios.craters.simulated import NO_CRATER, CraterPair, CraterView
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.geometry import Camera
from boresight.scenarios.load import LoadedScenario
from boresight.scenarios.onboard import onboard_spec
from boresight.scenarios.sequences.ground import MeshGround
from boresight.scenarios.spec.campaign import EstimatorSpec
from boresight.scenarios.spec.craters import CraterPairsSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

MatchedPair = InspectedTrial[CraterPair, tuple[CraterImage, CraterImage], CraterMatches]
"""A trial of one matcher, for inspection."""


@dataclass(slots=True, eq=False)
class MatchingDraw:
    """Two images as one matcher gets them; ``pair`` is None until its detector has seen both."""

    images: ImagePairDraw
    detector: str = BY_GEOMETRY
    pair: CraterPair | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TimedMatches:
    """Result of a matcher, its input, and its time, s."""

    pair: CraterPair
    matches: CraterMatches
    seconds: float


@dataclass(frozen=True, eq=False)
class CraterMatching(MethodRunner[CraterMatcher, MatchingDraw, TimedMatches]):
    """Trials of crater matchers; all see the same two images.

    ``camera`` is an ideal pinhole: rims come after the correction of a lens. ``known`` is the a priori shape.
    ``detectors`` maps a label to the name of the detector whose craters the matcher sees, `pairs.BY_GEOMETRY` for none.
    """

    name = "crater-matching"
    version = 6
    block_trials = 5
    called = "matcher"

    source: PairSource
    camera: Camera
    known: MeshGround
    detectors: Mapping[str, str]

    @classmethod
    def method_class(cls, name: str) -> type[CraterMatcher]:
        return crater_matcher_class(name)

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of a matcher, or of a detector."""
        known = crater_detector_class if name in crater_detector_names() else crater_matcher_class
        return known(name).version

    @classmethod
    def method_names(cls, entry: EstimatorSpec) -> tuple[str, ...]:
        """Return the names of the matcher and of the detector whose craters it sees."""
        detector = (str(entry.options["detector"]),) if "detector" in entry.options else ()
        return (*super().method_names(entry), *detector)

    @classmethod
    def check_scenario(cls, scenario: LoadedScenario) -> None:
        """Refuse a missing section, and images of no craters."""
        if _section(scenario).images is not None and scenario.spec.craters is None:
            raise BoresightError(f"{scenario.path}: craters: missing, but crater_pairs.images renders them")

    @classmethod
    def unused(cls, spec: ScenarioSpec) -> tuple[str, ...]:
        if spec.crater_pairs is None or spec.crater_pairs.images is None:
            return (*OF_IMAGES, *LENS, "sensors")
        return (*SUN_OF_VIEWS, *LENS, "sensors", "crater_pairs.errors")

    @classmethod
    def build(cls, entry: EstimatorSpec) -> CraterMatcher:
        own = {key: option for key, option in entry.options.items() if key != "detector"}
        return crater_matcher_class(entry.name).from_options(own)

    @classmethod
    def build_methods(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario
    ) -> Mapping[str, CraterMatcher | Unbuilt]:
        """Build the matchers; refuse wrong options, and a detector that does not suit the looks of a scenario."""
        for label, detector in _detectors(campaign).items():
            with located(campaign, label):
                check_detector(scenario, _section(scenario), label, detector)
        return super().build_methods(campaign, scenario)

    @classmethod
    def open(
        cls, campaign: ResolvedCampaign, scenario: LoadedScenario, context: WorkerContext, number: int = 0
    ) -> Self:
        """Load the shapes, draw the craters and build the matchers."""
        detectors = _detectors(campaign)
        return cls.made(
            campaign,
            scenario,
            number,
            source=open_pairs(scenario, _section(scenario), campaign.variant, set(detectors.values())),
            camera=scenario.spec.camera.camera().pinhole,
            known=MeshGround(load_body(onboard_spec(scenario.spec).body, scenario.search_dirs).mesh),
            detectors=detectors,
        )

    def flush(self) -> None:
        self.source.flush()

    def draw(self, trial: int) -> MatchingDraw:
        """Draw two views, and take their images."""
        return MatchingDraw(self.source.looks(self.seed, trial))

    def given(self, drawn: MatchingDraw, label: str) -> MatchingDraw:
        """Return the images with the detector of a matcher."""
        return MatchingDraw(drawn.images, self.detectors[label])

    def row(self, drawn: MatchingDraw) -> Record:
        return dict(view_columns(drawn.images.first))

    def ask(self, method: CraterMatcher, drawn: MatchingDraw) -> TimedMatches:
        """Let the detector look at both images, and the matcher at what it finds."""
        drawn.pair = drawn.images.seen_by(drawn.detector)
        (first, second), known = own_copy(self.images(drawn.pair)), MatcherGround(self.known)
        started = time.perf_counter()
        matches = method.match(first, second, known)
        return TimedMatches(drawn.pair, matches, time.perf_counter() - started)

    def check(self, answer: TimedMatches, drawn: MatchingDraw) -> None:
        check_matches(answer.matches, *self.images(answer.pair))

    def score(self, answer: TimedMatches, drawn: MatchingDraw) -> Records:
        """Count right, wrong and missed matches."""
        matches = answer.matches
        row: Record = {
            "status": "failed" if matches.reason else "ok",
            "reason": matches.reason,
            "n_landmarks": len(matches.pairs),
        }
        offset_px = largest_epipolar_offset(*self.images(answer.pair), answer.pair)
        return {
            "rows": [row],
            "crater_matches": [{**score_matches(matches, answer.pair), "epipolar_offset_px": offset_px}],
            "timings": [{"stage": "matching", "seconds": answer.seconds}],
        }

    def shown(self, answer: TimedMatches | None, drawn: MatchingDraw) -> MatchedPair | None:
        """Return the pair with its matches; None where the detector saw none."""
        if drawn.pair is None:
            return None
        return InspectedTrial(drawn.pair, self.images(drawn.pair), None if answer is None else answer.matches)

    def images(self, pair: CraterPair) -> tuple[CraterImage, CraterImage]:
        """Return what a matcher may see of a pair."""
        return self._image(0, pair.first), self._image(1, pair.second)

    def _image(self, number: int, look: CraterView) -> CraterImage:
        rims = look.detections.ellipses
        return CraterImage(number, look.frame, self.camera, CraterDetections(rims, np.ones(len(rims))))


def score_matches(matches: CraterMatches, pair: CraterPair) -> Record:
    """Count correct, wrong and missed matches of a pair by which crater each detection is."""
    one, other = pair.first.detections.crater, pair.second.detections.crater
    common = np.intersect1d(one[one != NO_CRATER], other[other != NO_CRATER])
    correct = int(right_matches(matches, pair).sum())
    unlisted = int(unlisted_matches(matches, pair).sum())
    return {
        "view_deg": pair.view_deg,
        "sun_deg": pair.sun_deg,
        "n_first": len(one),
        "n_second": len(other),
        "n_common": len(common),
        "n_correct": correct,
        "n_wrong": len(matches.pairs) - correct - unlisted,
        "n_missed": len(common) - correct,
        "n_unlisted": unlisted,
    }


def largest_epipolar_offset(first: CraterImage, second: CraterImage, pair: CraterPair) -> float | None:
    """Return the largest distance, px, of a crater that is in both from its epipolar line; None of no such crater.

    The line is that of the poses and rims which a matcher is given (Cheng et al. 2003, figure 4).
    """
    one, other = pair.first.detections.crater[:, None], pair.second.detections.crater[None]
    offsets_px = epipolar_offsets(first, second)[(one == other) & (one != NO_CRATER)]
    return float(offsets_px.max()) if len(offsets_px) else None


def right_matches(matches: CraterMatches, pair: CraterPair) -> NDArray[np.bool_]:
    """(k,) whether both detections of a match are the same crater."""
    here = pair.first.detections.crater[matches.pairs[:, 0]]
    there = pair.second.detections.crater[matches.pairs[:, 1]]
    return np.asarray((here == there) & (here != NO_CRATER))


def unlisted_matches(matches: CraterMatches, pair: CraterPair) -> NDArray[np.bool_]:
    """(k,) whether a match is neither right nor wrong, as far as is known.

    Neither detection is a listed crater, and one at least is smaller than those: they may be one crater that the truth
    does not list. One of the two is enough, as the sizes that a detector finds scatter about the smallest listed one.
    """
    looks, rows = (pair.first, pair.second), matches.pairs.T
    listed = [look.detections.crater[row] != NO_CRATER for look, row in zip(looks, rows, strict=True)]
    small = [
        np.zeros(len(row), dtype=np.bool_) if look.detections.unlisted is None else look.detections.unlisted[row]
        for look, row in zip(looks, rows, strict=True)
    ]
    return np.asarray(~listed[0] & ~listed[1] & (small[0] | small[1]))


def check_matches(matches: CraterMatches | None, first: CraterImage, second: CraterImage) -> None:
    """Refuse matches that break the contract.

    Raise `ValueError` if they are none, name a detection that there is not, or one twice, or there are none and no
    reason, or some and a reason.
    """
    if type(matches) is not CraterMatches:
        raise ValueError(f"a {type(matches).__name__} is no CraterMatches")
    check_reason(matches.reason)
    sizes = [len(image.detections.ellipses) for image in (first, second)]
    k = len(matches.pairs)
    check_indices("pairs", matches.pairs, (k, 2))
    check_array("score", matches.score, (k,))
    pairs = np.asarray(matches.pairs)
    if k and (pairs.min() < 0 or (pairs >= sizes).any()):
        raise ValueError(f"matches name a detection that there is not: the images have {sizes}")
    if any(len(np.unique(column)) < k for column in pairs.T):
        raise ValueError("matches name a detection twice")
    if (k == 0) != bool(matches.reason):
        raise ValueError(f"there are {k or 'no'} matches, and {'a' if k else 'no'} reason why there are none")


def _section(scenario: LoadedScenario) -> CraterPairsSpec:
    if scenario.spec.crater_pairs is None:
        raise BoresightError(f"{scenario.path}: crater_pairs: missing, but the experiment crater-matching needs it")
    return scenario.spec.crater_pairs


def _detectors(campaign: ResolvedCampaign) -> dict[str, str]:
    return {entry.label: str(entry.options.get("detector", BY_GEOMETRY)) for entry in campaign.spec.estimators}


KIND = CraterMatching
