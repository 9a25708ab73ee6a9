"""Estimators of sequences by name: our own table, and entry points of third-party packages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from estimators.slam.contract import SequenceEstimator
from estimators.third_party import load_by_name, names_with

ENTRY_POINT_GROUP = "boresight.sequence_estimators"
_PARTS = ("name", "version", "from_options", "follow")

_OWN: Mapping[str, str] = MappingProxyType(
    {
        "dead-reckoning": "estimators.slam.dead_reckoning:DeadReckoning",
        "ba-slam": "estimators.slam.bundle:BundleSlam",
        "batch": "estimators.slam.smoother:BatchAdjustment",
        "dynamic-smoother": "estimators.slam.dynamics.smoother:DynamicSmoother",
        "consistent-ekf-slam": "estimators.slam.ekf:ConsistentEkfSlam",
        "ekf-slam": "estimators.slam.ekf:EkfSlam",
        "loop-smoother": "estimators.slam.loops.smoother:LoopSmoother",
        "gtsam-fixed-lag": "estimators.slam.peers.smoothers:GtsamFixedLag",
        "gtsam-isam2": "estimators.slam.peers.smoothers:GtsamIsam2",
        "fixed-lag": "estimators.slam.smoother:FixedLagSmoother",
        "iterated-ekf-slam": "estimators.slam.ekf:IteratedEkfSlam",
    }
)


def sequence_estimator_names() -> tuple[str, ...]:
    """All names, sorted; third-party ones included."""
    return names_with(_OWN, ENTRY_POINT_GROUP)


def sequence_estimator_class(name: str) -> type[SequenceEstimator]:
    """Look up an estimator of sequences; our own names cannot be taken over by a third party.

    Raises
    ------
    BoresightError
        If there is none of that name, or a third party's cannot be imported or does not follow the contract.
    """
    return cast("type[SequenceEstimator]", load_by_name(name, _OWN, ENTRY_POINT_GROUP, _PARTS))
