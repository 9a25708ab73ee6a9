"""Kind of trial: a camera followed along an orbit by tracks."""

from boresight.campaign.kinds.sequence.trial import SequenceTrials
from boresight.campaign.trial.kind import Kind

KIND = Kind(
    name="sequence",
    version=5,
    block_trials=5,
    method_version=SequenceTrials.method_version,
    check_scenario=SequenceTrials.check_scenario,
    methods=SequenceTrials.methods,
    open=SequenceTrials.open,
)
