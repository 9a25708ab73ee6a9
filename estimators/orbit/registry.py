"""Estimators of orbits by name: our own table, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from estimators.orbit.contract import OrbitEstimator
from estimators.third_party import load_by_name, names_with

ENTRY_POINT_GROUP = "boresight.orbit_estimators"
_PARTS = ("name", "version", "from_options", "determine")

_OWN: Mapping[str, str] = MappingProxyType({"batch-filter": "estimators.orbit.batch_filter:BatchFilter"})


def orbit_estimator_names() -> tuple[str, ...]:
    """All names, sorted; third-party ones included."""
    return names_with(_OWN, ENTRY_POINT_GROUP)


def orbit_estimator_class(name: str) -> type[OrbitEstimator]:
    """Look up an estimator of orbits; our own names cannot be taken over by a third party.

    Raises
    ------
    BoresightError
        If there is none of that name, or a third party's cannot be imported or does not follow the contract.
    """
    return cast("type[OrbitEstimator]", load_by_name(name, _OWN, ENTRY_POINT_GROUP, _PARTS))
