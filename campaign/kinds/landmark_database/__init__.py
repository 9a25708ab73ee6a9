"""Kind of trial: a data base of landmarks."""

from boresight.campaign.kinds.landmark_database.trial import DatabaseTrials

KIND = DatabaseTrials
