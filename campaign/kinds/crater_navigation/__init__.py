"""Kind of trial: an orbit from images of craters."""

from boresight.campaign.kinds.crater_navigation.trial import CraterNavigationTrials
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="crater-navigation",
    version=2,
    block_trials=1,
    method_version=CraterNavigationTrials.method_version,
    check_scenario=CraterNavigationTrials.check_scenario,
    methods=CraterNavigationTrials.methods,
    open=CraterNavigationTrials.open,
)
