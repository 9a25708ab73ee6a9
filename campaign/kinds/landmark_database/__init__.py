"""Kind of trial: a data base of landmarks."""

from boresight.campaign.kinds.landmark_database.trial import DatabaseTrials
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="landmark-database",
    version=1,
    block_trials=1,
    method_version=DatabaseTrials.method_version,
    check_scenario=DatabaseTrials.check_scenario,
    methods=DatabaseTrials.methods,
    prepare=DatabaseTrials.prepare,
    open=DatabaseTrials.open,
)
