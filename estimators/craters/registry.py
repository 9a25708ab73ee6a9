"""Crater detectors and matchers by name: the built-in tables, and entry points of third-party packages."""

from __future__ import annotations

from boresight.estimators.craters.contract import CraterDetector, CraterMatcher
from boresight.estimators.registry import Registry

DETECTORS: Registry[CraterDetector] = Registry(
    own={
        "crater-classic": "boresight.estimators.craters.detection.classic:CraterClassic",
        "crater-heat-map": "boresight.estimators.craters.learned.heat_map_detector:CraterHeatMap",
        "crater-learned": "boresight.estimators.craters.learned.detector:CraterLearned",
    },
    group="boresight.crater_detectors",
    parts=("name", "version", "from_options", "detect"),
)
crater_detector_names, crater_detector_class = DETECTORS.names, DETECTORS.find

MATCHERS: Registry[CraterMatcher] = Registry(
    own={
        "context": "boresight.estimators.craters.matching.context:ContextMatcher",
        "correlation": "boresight.estimators.craters.matching.correlation:CorrelationMatcher",
        "hybrid": "boresight.estimators.craters.matching.hybrid:HybridMatcher",
        "invariants": "boresight.estimators.craters.matching.invariants:InvariantMatcher",
        "vote": "boresight.estimators.craters.matching.vote:VoteMatcher",
    },
    group="boresight.crater_matchers",
    parts=("name", "version", "from_options", "match"),
)
crater_matcher_names, crater_matcher_class = MATCHERS.names, MATCHERS.find
