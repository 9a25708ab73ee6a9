"""Kind of trial: craters found in one image."""

from boresight.campaign.kinds.crater_detection.trial import CraterDetection

KIND = CraterDetection
