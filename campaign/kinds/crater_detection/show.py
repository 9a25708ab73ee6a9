"""What trials of crater detection show of themselves."""

from __future__ import annotations

from campaign.inspection.show import Kept, Show
from campaign.kinds.crater_detection.draw import draw_detection
from campaign.kinds.crater_detection.examples import crater_examples
from campaign.kinds.crater_detection.look import look_at_detections
from campaign.kinds.crater_detection.trial import DetectedImage


def kept(shown: object) -> Kept:
    """Return the image that a detector saw."""
    return Kept({"image": shown.frame.image}) if isinstance(shown, DetectedImage) else Kept()


SHOW = Show(draw=draw_detection, kept=kept, look=look_at_detections, examples=crater_examples)
