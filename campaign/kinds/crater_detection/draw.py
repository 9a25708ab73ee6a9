"""What is drawn of crater detection: an image with true and detected rims."""

from __future__ import annotations

import numpy as np

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Drawn
from campaign.kinds.crater_detection.trial import DetectedImage
from reports.kinds.crater_detection.figures import draw_example, ellipses_of
from scenarios.craters.simulated import NO_CRATER


def draw_detection(again: Recomputed) -> Drawn | None:
    """Draw an image with the craters that are there and those that were found."""
    shown, what = again.shown, str(again.case)
    if not isinstance(shown, DetectedImage):
        return None
    truth = shown.truth
    detections = [record for record in again.records.get("detections", []) if record["kept"]]
    matched = np.array([int(str(record["crater"])) != NO_CRATER for record in detections], dtype=np.bool_)
    figure = draw_example(
        shown.frame.image, (truth.ellipses, truth.detectable), (ellipses_of(detections), matched), "craters", what
    )
    missed = int(truth.detectable.sum()) - sum(bool(record["detectable"]) for record in detections)
    note = f"{int(truth.detectable.sum())} detectable craters, {missed} of them missed; {int((~matched).sum())} of"
    return Drawn([figure], notes=[f"{note} {len(detections)} detections are of no crater, or of one found before."])
