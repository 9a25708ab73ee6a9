"""Estimators of sequences by name."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import cast

from estimators.slam.contract import SequenceEstimator
from scenarios.errors import BoresightError

_OWN: Mapping[str, str] = MappingProxyType(
    {
        "dead-reckoning": "estimators.slam.dead_reckoning:DeadReckoning",
        "ba-slam": "estimators.slam.bundle:BundleSlam",
        "batch": "estimators.slam.smoother:BatchAdjustment",
        "dynamic-smoother": "estimators.slam.dynamics.smoother:DynamicSmoother",
        "ekf-slam": "estimators.slam.ekf:EkfSlam",
        "fixed-lag": "estimators.slam.smoother:FixedLagSmoother",
    }
)


def sequence_estimator_names() -> tuple[str, ...]:
    """All names, sorted."""
    return tuple(sorted(_OWN))


def sequence_estimator_class(name: str) -> type[SequenceEstimator]:
    """Look up an estimator of sequences.

    Raises
    ------
    BoresightError
        If there is none of that name.
    """
    if name not in _OWN:
        known = ", ".join(sequence_estimator_names())
        raise BoresightError(f"estimator {name!r} is unknown among those of sequences; there are: {known}")
    module, attribute = _OWN[name].split(":")
    return cast("type[SequenceEstimator]", getattr(import_module(module), attribute))
