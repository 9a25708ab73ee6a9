"""Estimators by name: our own table, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping

from estimators.contract import Estimator
from estimators.third_party import Registry

_ESTIMATORS: Registry[Estimator] = Registry(
    own={
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
    },
    group="boresight.estimators",
    parts=("name", "version", "from_options", "estimate"),
)
estimator_names, estimator_class = _ESTIMATORS.names, _ESTIMATORS.find


def needed_sensors(name: str) -> frozenset[str]:
    """Return the sensors that an estimator cannot do without, from its class attribute ``sensors``; mostly none."""
    return frozenset(getattr(estimator_class(name), "sensors", ())) if name in estimator_names() else frozenset()


def base_of(name: str, options: Mapping[str, object]) -> str | None:
    """Return the estimator that another builds on, by its option ``base`` or its class's default; mostly none."""
    base = getattr(estimator_class(name), "base", None) if name in estimator_names() else None
    return None if base is None else str(options.get("base", base))
