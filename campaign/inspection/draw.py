"""What draws the cases of each kind of experiment."""

from __future__ import annotations

from campaign.experiments.crater_detection import DetectedImage
from campaign.experiments.crater_matching import MatchedPair
from campaign.experiments.orbit_determination import DeterminedOrbit
from campaign.experiments.sequence import FollowedSequence, SequenceTrials
from campaign.experiments.single_image import EstimatedImage, SingleImage
from campaign.inspection.craters import draw_detection, draw_pair_case
from campaign.inspection.drawn import Drawn
from campaign.inspection.orbit import draw_orbit_case
from campaign.inspection.recompute import Recomputed
from campaign.inspection.sequence import draw_sequence_case
from campaign.inspection.single import draw_single


def draw_case(again: Recomputed) -> Drawn:
    """Draw the stages of a case, as far as they came; a kind with nothing to draw says so in a note."""
    what, shown, experiment, records = str(again.case), again.shown, again.experiment, again.records
    if isinstance(shown, EstimatedImage) and isinstance(experiment, SingleImage):
        return draw_single(experiment.of(again.case.trial), shown, records, what)
    if isinstance(shown, FollowedSequence) and isinstance(experiment, SequenceTrials):
        return draw_sequence_case(experiment, shown, records, what)
    if isinstance(shown, DetectedImage):
        return draw_detection(shown, records.get("detections", []), what)
    if isinstance(shown, MatchedPair):
        return draw_pair_case(shown, what)
    if isinstance(shown, DeterminedOrbit):
        return draw_orbit_case(shown, records, what)
    if shown is None and experiment.kind in _SHOWING:
        return Drawn([], notes=["There is nothing to draw: the trial ended before an estimator saw anything."])
    return Drawn([], notes=[f"There is nothing to draw: trials of {experiment.kind} hold numbers alone."])


_SHOWING = (
    "single-image",
    "sequence",
    "crater-detection",
    "crater-matching",
    "orbit-determination",
    "crater-navigation",
)
