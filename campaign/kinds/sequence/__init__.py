"""Kind of trial: a camera followed along an orbit by tracks."""

from campaign.kinds.sequence.trial import SequenceTrials
from campaign.trial.kind import Kind

KIND = Kind(
    name="sequence",
    version=5,
    block_trials=5,
    method_version=SequenceTrials.method_version,
    prepare=SequenceTrials.prepare,
    open=SequenceTrials.open,
)
