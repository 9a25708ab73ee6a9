"""Kind of trial: craters identified in two images."""

from campaign.kinds.crater_matching.trial import CraterMatching
from campaign.trial.kind import Kind

KIND = Kind(
    name="crater-matching",
    version=5,
    block_trials=5,
    method_version=CraterMatching.method_version,
    check_scenario=CraterMatching.check_scenario,
    methods=CraterMatching.methods,
    open=CraterMatching.open,
)
