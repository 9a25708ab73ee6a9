"""Kind of trial: craters identified in two images."""

from boresight.campaign.kinds.crater_matching.trial import CraterMatching

KIND = CraterMatching
