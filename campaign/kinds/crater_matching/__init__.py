"""Kind of trial: craters identified in two images."""

from boresight.campaign.kinds.crater_matching.trial import CraterMatching
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="crater-matching",
    version=6,
    block_trials=5,
    method_version=CraterMatching.method_version,
    check_scenario=CraterMatching.check_scenario,
    methods=CraterMatching.methods,
    open=CraterMatching.open,
)
