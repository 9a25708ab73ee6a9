"""Kind of trial: pose solvers on drawn landmarks."""

from boresight.campaign.kinds.pose_convergence.trial import PoseConvergence

KIND = PoseConvergence
