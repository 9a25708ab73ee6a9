"""Detectors and matchers of craters by name: our own tables, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from estimators.craters.contract import CraterDetector, CraterMatcher
from estimators.third_party import load_by_name, names_with

ENTRY_POINT_GROUP = "boresight.crater_detectors"
MATCHER_GROUP = "boresight.crater_matchers"
_PARTS = ("name", "version", "from_options", "detect")
_MATCHER_PARTS = ("name", "version", "from_options", "match")

_OWN: Mapping[str, str] = MappingProxyType(
    {
        "crater-classic": "estimators.craters.detection.classic:CraterClassic",
        "crater-learned": "estimators.craters.learned.detector:CraterLearned",
    }
)

_OWN_MATCHERS: Mapping[str, str] = MappingProxyType(
    {
        "context": "estimators.craters.matching.context:ContextMatcher",
        "correlation": "estimators.craters.matching.correlation:CorrelationMatcher",
        "hybrid": "estimators.craters.matching.hybrid:HybridMatcher",
        "invariants": "estimators.craters.matching.invariants:InvariantMatcher",
        "vote": "estimators.craters.matching.vote:VoteMatcher",
    }
)


def crater_detector_names() -> tuple[str, ...]:
    """All names, sorted; third-party ones included."""
    return names_with(_OWN, ENTRY_POINT_GROUP)


def crater_detector_class(name: str) -> type[CraterDetector]:
    """Look up a detector of craters; our own names cannot be taken over by a third party.

    Raises
    ------
    BoresightError
        If there is none of that name, or a third party's cannot be imported or does not follow the contract.
    """
    return cast("type[CraterDetector]", load_by_name(name, _OWN, ENTRY_POINT_GROUP, _PARTS))


def crater_matcher_names() -> tuple[str, ...]:
    """All names, sorted; third-party ones included."""
    return names_with(_OWN_MATCHERS, MATCHER_GROUP)


def crater_matcher_class(name: str) -> type[CraterMatcher]:
    """Look up a matcher of craters; our own names cannot be taken over by a third party.

    Raises
    ------
    BoresightError
        If there is none of that name, or a third party's cannot be imported or does not follow the contract.
    """
    return cast("type[CraterMatcher]", load_by_name(name, _OWN_MATCHERS, MATCHER_GROUP, _MATCHER_PARTS))
