"""The crater-matching experiment: two looks at craters, each matcher on the same detections, scored by the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from campaign.crater_pairs import BY_GEOMETRY, PairSource, check_detectors, open_pairs
from campaign.experiments.fault import faulted
from campaign.experiments.registry import Bench, Record, Records, Witness
from campaign.products import BuiltProduct, Shelf
from campaign.resolve import ResolvedCampaign
from campaign.score import no_consistency, no_pose_error
from estimators.craters.contract import CraterDetections, CraterImage, CraterMatcher, CraterMatches
from estimators.craters.registry import crater_detector_class, crater_detector_names, crater_matcher_class
from scenarios.beliefs import believed_spec
from scenarios.bodies import load_body
from scenarios.craters.pairs import CraterLook, CraterPair
from scenarios.craters.simulated import NO_CRATER
from scenarios.errors import BoresightError
from scenarios.geometry import Camera
from scenarios.load import LoadedScenario
from scenarios.sequences.ground import MeshGround
from scenarios.spec.crater_pairs import CraterPairsSpec


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPair:
    """A trial of one matcher as a witness is shown it; ``matches`` is None where the matcher raised."""

    pair: CraterPair
    matches: CraterMatches | None


@dataclass(frozen=True, eq=False)
class CraterMatching:
    """Trials of one scenario with a set of labelled matchers; all see the same two images.

    Parameters
    ----------
    name
        Of the scenario.
    source
        Where pairs of looks come from.
    camera
        An ideal pinhole: rims come after the correction of a lens.
    known
        The a priori shape.
    matchers
        Label to matcher.
    detectors
        Label to the name of the detector whose craters the matcher sees, `campaign.crater_pairs.BY_GEOMETRY` for none.
    seed
        Seed of the campaign.
    witness
        Shown the `MatchedPair` of every trial and matcher; or None.
    """

    name: str
    source: PairSource
    camera: Camera
    known: MeshGround
    matchers: Mapping[str, CraterMatcher]
    detectors: Mapping[str, str]
    seed: int
    witness: Witness | None = None

    kind: ClassVar[str] = "crater-matching"
    version: ClassVar[int] = 2
    block_trials: ClassVar[int] = 5
    kernels: ClassVar[bool] = False

    @classmethod
    def method_version(cls, name: str) -> int:
        """Return the version of a matcher, or of a detector."""
        known = crater_detector_class if name in crater_detector_names() else crater_matcher_class
        return known(name).version

    @classmethod
    def prepare(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, shelf: Shelf) -> list[BuiltProduct]:
        """Refuse wrong options and a missing section; there is nothing to build."""
        del shelf
        check_detectors(scenario, _section(scenario), _detectors(campaign))
        _matchers(campaign)
        return []

    @classmethod
    def open(cls, campaign: ResolvedCampaign, scenario: LoadedScenario, bench: Bench) -> CraterMatching:
        """Load the shapes, draw the craters and build the matchers."""
        del bench
        spec = scenario.spec
        known = MeshGround(load_body(believed_spec(spec).body, scenario.search_dirs).mesh)
        detectors = _detectors(campaign)
        source = open_pairs(scenario, _section(scenario), campaign.variant, set(detectors.values()))
        camera = spec.camera.camera().pinhole
        return cls(spec.name, source, camera, known, _matchers(campaign), detectors, campaign.seed)

    def watched(self, label: str, witness: Witness) -> Self:
        """Return the same trials of one matcher, shown to a witness."""
        return replace(self, matchers={label: self.matchers[label]}, witness=witness)

    def run(self, trials: range) -> Records:
        """Run trials, in the order of trials and matchers."""
        records: Records = {}
        for trial in trials:
            pairs = self.source.pairs(self.seed, trial, sorted(set(self.detectors.values())))
            for label, matcher in self.matchers.items():
                key: Record = {"trial": trial, "scenario": self.name, "estimator": label}
                for table, added in self._judged(matcher, pairs[self.detectors[label]]).items():
                    records.setdefault(table, []).extend({**key, **record} for record in added)
        self.source.flush()
        return records

    def pair(self, trial: int, label: str) -> CraterPair:
        """Return the pair of a trial as a matcher sees it."""
        detector = self.detectors[label]
        return self.source.pairs(self.seed, trial, [detector])[detector]

    def _judged(self, matcher: CraterMatcher, pair: CraterPair) -> Records:
        """Let a matcher work and score what it returns: records without their key, whatever goes wrong."""
        first, second = self.images(pair)
        started, matches = time.perf_counter(), None
        try:
            matches = matcher.match(first, second, self.known)
            seconds = time.perf_counter() - started
            check_matches(matches, first, second)
        except Exception:  # noqa: BLE001  a matcher's fault is a result, recorded with its trace
            return faulted("matcher", _circumstances(pair))
        finally:
            if self.witness is not None:
                self.witness(MatchedPair(pair, matches))
        row: Record = {
            **_circumstances(pair),
            "status": "failed" if matches.reason else "ok",
            "reason": matches.reason,
            "n_landmarks": len(matches.pairs),
        }
        return {
            "rows": [row],
            "crater_matches": [score_matches(matches, pair)],
            "timings": [{"stage": "matching", "seconds": seconds}],
        }

    def images(self, pair: CraterPair) -> tuple[CraterImage, CraterImage]:
        """Return what a matcher may see of a pair."""
        return self._image(0, pair.first), self._image(1, pair.second)

    def _image(self, number: int, look: CraterLook) -> CraterImage:
        rims = look.detections.ellipses
        return CraterImage(number, look.frame, self.camera, CraterDetections(rims, np.ones(len(rims))))


def score_matches(matches: CraterMatches, pair: CraterPair) -> Record:
    """Count correct, wrong and missed matches of a pair by which crater each detection is."""
    one, other = pair.first.detections.crater, pair.second.detections.crater
    common = np.intersect1d(one[one != NO_CRATER], other[other != NO_CRATER])
    correct = int(right_matches(matches, pair).sum())
    return {
        "view_deg": pair.view_deg,
        "sun_deg": pair.sun_deg,
        "n_first": len(one),
        "n_second": len(other),
        "n_common": len(common),
        "n_correct": correct,
        "n_wrong": len(matches.pairs) - correct,
        "n_missed": len(common) - correct,
    }


def right_matches(matches: CraterMatches, pair: CraterPair) -> NDArray[np.bool_]:
    """(k,) whether both detections of a match are the same crater."""
    here = pair.first.detections.crater[matches.pairs[:, 0]]
    there = pair.second.detections.crater[matches.pairs[:, 1]]
    return np.asarray((here == there) & (here != NO_CRATER))


def check_matches(matches: CraterMatches, first: CraterImage, second: CraterImage) -> None:
    """Refuse matches that break the contract.

    Raises
    ------
    BoresightError
        If they name a detection that there is not, or one twice, or there are none and no reason.
    """
    sizes = [len(image.detections.ellipses) for image in (first, second)]
    pairs = matches.pairs
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(matches.score) != len(pairs):
        raise BoresightError(f"matches need (k, 2) pairs and (k,) scores, not {pairs.shape} and {matches.score.shape}")
    if len(pairs) and (pairs.min() < 0 or (pairs >= sizes).any()):
        raise BoresightError(f"matches name a detection that there is not: the images have {sizes}")
    if any(len(np.unique(column)) < len(column) for column in pairs.T):
        raise BoresightError("matches name a detection twice")
    if len(pairs) == 0 and not matches.reason:
        raise BoresightError("there are no matches, and no reason why")


def _circumstances(pair: CraterPair) -> Record:
    """Fill the columns of a row that no matcher can change, or that a pair of images has no number for."""
    errors = no_pose_error()
    return {
        **errors,
        **{f"prior_{name}": None for name in errors},
        **no_consistency(),
        "image": "",
        "range_m": float(np.linalg.norm(pair.first.view.T_cam_body.translation_m)),
        "phase_deg": float(np.degrees(pair.first.view.phase_angle_rad)),
    }


def _section(scenario: LoadedScenario) -> CraterPairsSpec:
    if scenario.spec.crater_pairs is None:
        raise BoresightError(f"{scenario.path}: crater_pairs: missing, but the experiment crater-matching needs it")
    return scenario.spec.crater_pairs


def _matchers(campaign: ResolvedCampaign) -> dict[str, CraterMatcher]:
    found = {}
    for entry in campaign.spec.estimators:
        own = {key: option for key, option in entry.options.items() if key != "detector"}
        found[entry.label] = crater_matcher_class(entry.name).from_options(own)
    return found


def _detectors(campaign: ResolvedCampaign) -> dict[str, str]:
    return {entry.label: str(entry.options.get("detector", BY_GEOMETRY)) for entry in campaign.spec.estimators}
