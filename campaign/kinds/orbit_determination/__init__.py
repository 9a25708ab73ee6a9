"""Kind of trial: an orbit from crater sightings and radiometric data."""

from boresight.campaign.kinds.orbit_determination.trial import OrbitTrials

KIND = OrbitTrials
