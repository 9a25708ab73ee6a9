"""Orbit estimators by name: the built-in table, and entry points of third-party packages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from boresight.estimators.registry import Registry

if TYPE_CHECKING:
    from boresight.estimators.orbit.contract import (
        OrbitEstimator,  # its data load compiled kernels, which names need not
    )

ESTIMATORS: Registry[OrbitEstimator] = Registry(
    own={"batch-filter": "boresight.estimators.orbit.batch_filter:BatchFilter"},
    group="boresight.orbit_estimators",
    parts=("name", "version", "from_options", "determine"),
)
orbit_estimator_names, orbit_estimator_class = ESTIMATORS.names, ESTIMATORS.find
