"""Detectors of craters by name: our own table, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from estimators.craters.contract import CraterDetector
from estimators.third_party import load_by_name, names_with

ENTRY_POINT_GROUP = "boresight.crater_detectors"
_PARTS = ("name", "version", "from_options", "detect")

_OWN: Mapping[str, str] = MappingProxyType(
    {
        "crater-classic": "estimators.craters.detection.classic:CraterClassic",
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
