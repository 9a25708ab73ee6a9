"""Kind of trial: pose solvers on drawn landmarks."""

from boresight.campaign.kinds.pose_convergence.trial import PoseConvergence
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="pose-convergence",
    version=1,
    block_trials=1000,
    method_version=PoseConvergence.method_version,
    check_scenario=PoseConvergence.check_scenario,
    methods=PoseConvergence.methods,
    prepare=PoseConvergence.prepare,
    open=PoseConvergence.open,
    # Nothing is rendered: a process grows by less than 1 MB in 1000 trials, and takes half as long as a block to start.
    process_trials=100_000,
)
