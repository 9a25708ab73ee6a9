"""Kind of trial: a camera followed along an orbit by tracks."""

from boresight.campaign.kinds.sequence.trial import SequenceTrials

KIND = SequenceTrials
