"""Kind of trial: craters found in one image."""

from boresight.campaign.kinds.crater_detection.trial import CraterDetection
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="crater-detection",
    version=3,
    block_trials=10,
    method_version=CraterDetection.method_version,
    check_scenario=CraterDetection.check_scenario,
    methods=CraterDetection.methods,
    prepare=CraterDetection.prepare,
    open=CraterDetection.open,
    databases=True,
)
