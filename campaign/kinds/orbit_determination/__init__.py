"""Kind of trial: an orbit from crater sightings and radiometric data."""

from boresight.campaign.kinds.orbit_determination.trial import OrbitTrials
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="orbit-determination",
    version=3,
    block_trials=2,
    method_version=OrbitTrials.method_version,
    check_scenario=OrbitTrials.check_scenario,
    methods=OrbitTrials.methods,
    open=OrbitTrials.open,
    databases=True,
)
