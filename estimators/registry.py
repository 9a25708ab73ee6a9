"""Estimators by name: our own table, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import cast

from estimators.contract import Estimator
from scenarios.errors import BoresightError

ENTRY_POINT_GROUP = "boresight.estimators"

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
        "prior": "estimators.prior:PriorEstimator",
    }
)


def estimator_names() -> tuple[str, ...]:
    """All names, sorted; third-party ones included."""
    return tuple(sorted({*_OWN, *(point.name for point in entry_points(group=ENTRY_POINT_GROUP))}))


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
    if name in _OWN:
        module, attribute = _OWN[name].split(":")
        return cast("type[Estimator]", getattr(import_module(module), attribute))
    points = [point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name == name]
    if not points:
        raise BoresightError(f"estimator {name!r} is unknown; there are: {', '.join(estimator_names())}")
    try:
        found = points[0].load()
    except (ImportError, AttributeError) as error:
        raise BoresightError(f"estimator {name!r} cannot be imported from {points[0].value}: {error}") from error
    missing = [part for part in ("name", "version", "from_options", "estimate") if not hasattr(found, part)]
    if missing:
        raise BoresightError(f"estimator {name!r} ({points[0].value}) lacks {', '.join(missing)} of the contract")
    return cast("type[Estimator]", found)
