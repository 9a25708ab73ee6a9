"""Kind of trial: an orbit from images of craters."""

from boresight.campaign.kinds.crater_navigation.trial import CraterNavigationTrials

KIND = CraterNavigationTrials
