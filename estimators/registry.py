"""Estimators by name: our own table, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from estimators.contract import Estimator
from estimators.third_party import load_by_name, names_with

ENTRY_POINT_GROUP = "boresight.estimators"
_PARTS = ("name", "version", "from_options", "estimate")

_OWN: Mapping[str, str] = MappingProxyType(
    {
        "centroid": "estimators.landmark.centroiding:CentroidAligner",
        "landmark-harris": "estimators.landmark.recognizer:LandmarkRecognizer",
        "landmark-altimeter": "estimators.altimeter:AltimeterEstimator",
        "landmark-orb": "estimators.descriptors.recognizer:OrbNavigator",
        "landmark-sift": "estimators.descriptors.recognizer:SiftNavigator",
        "landmark-ransac": "estimators.landmark.robust.estimator:ConsensusRecognizer",
        "whole-image": "estimators.dense.whole_image:WholeImageRecognizer",
        "photometric": "estimators.dense.photometric:PhotometricEstimator",
        "lmaps": "estimators.maplets.recognizer:MapletNavigator",
        "crater-pose": "estimators.craters.pose.estimator:CraterPose",
        "prior": "estimators.prior:PriorEstimator",
    }
)


def estimator_names() -> tuple[str, ...]:
    """All names, sorted; third-party ones included."""
    return names_with(_OWN, ENTRY_POINT_GROUP)


def needed_sensors(name: str) -> frozenset[str]:
    """Return the sensors that an estimator cannot do without, from its class attribute ``sensors``; mostly none."""
    return frozenset(getattr(estimator_class(name), "sensors", ())) if name in estimator_names() else frozenset()


def base_of(name: str, options: Mapping[str, object]) -> str | None:
    """Return the estimator that another builds on, by its option ``base`` or its class's default; mostly none."""
    base = getattr(estimator_class(name), "base", None) if name in estimator_names() else None
    return None if base is None else str(options.get("base", base))


def estimator_class(name: str) -> type[Estimator]:
    """Look up an estimator; our own names cannot be taken over by a third party.

    Raises
    ------
    BoresightError
        If there is none of that name, or a third party's cannot be imported or does not follow the contract.
    """
    return cast("type[Estimator]", load_by_name(name, _OWN, ENTRY_POINT_GROUP, _PARTS))
