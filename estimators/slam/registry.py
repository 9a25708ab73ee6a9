"""Sequence estimators by name: our own, and those of other packages by their entry points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from boresight.estimators.registry import Registry

if TYPE_CHECKING:
    from boresight.estimators.slam.contract import SequenceEstimator

ESTIMATORS: Registry[SequenceEstimator] = Registry(
    own={
        "dead-reckoning": "boresight.estimators.slam.following:DeadReckoning",
        "ba-slam": "boresight.estimators.slam.keyframes.bundle:BundleSlam",
        "batch": "boresight.estimators.slam.smoothing.smoother:BatchAdjustment",
        "dynamic-smoother": "boresight.estimators.slam.smoothing.dynamic_smoother:DynamicSmoother",
        "consistent-ekf-slam": "boresight.estimators.slam.filters.ekf:ConsistentEkfSlam",
        "ekf-slam": "boresight.estimators.slam.filters.ekf:EkfSlam",
        "loop-smoother": "boresight.estimators.slam.smoothing.loop_smoother:LoopSmoother",
        "gtsam-fixed-lag": "boresight.estimators.slam.smoothing.gtsam_smoothers:GtsamFixedLag",
        "gtsam-isam2": "boresight.estimators.slam.smoothing.gtsam_smoothers:GtsamIsam2",
        "fixed-lag": "boresight.estimators.slam.smoothing.smoother:FixedLagSmoother",
        "iterated-ekf-slam": "boresight.estimators.slam.filters.ekf:IteratedEkfSlam",
    },
    group="boresight.sequence_estimators",
    parts=("name", "version", "from_options", "follow"),
)
EXTRAS = {"gtsam-fixed-lag": "gtsam", "gtsam-isam2": "gtsam"}
"""Estimators that need an extra of the installation, and the package of the same name that it installs."""

sequence_estimator_names, sequence_estimator_class = ESTIMATORS.names, ESTIMATORS.find
