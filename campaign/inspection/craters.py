"""What is drawn of crater navigation: an image with true and detected rims, or a pair with what was matched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from campaign.experiments.crater_detection import DetectedImage
from campaign.experiments.crater_matching import MatchedPair
from campaign.experiments.registry import Record
from campaign.inspection.drawn import Drawn
from reports.crater_figures import draw_example, ellipses_of
from reports.figures.crater_pairs import MatchedRims, draw_matched_pair
from reports.named_figure import NamedFigure
from scenarios.craters.simulated import NO_CRATER


def draw_detection(shown: DetectedImage, detections: list[Record], what: str) -> Drawn:
    """Draw an image with the craters that are there and those that were found."""
    truth = shown.truth
    detections = [record for record in detections if record["kept"]]
    matched = np.array([int(str(record["crater"])) != NO_CRATER for record in detections], dtype=np.bool_)
    figure = draw_example(
        shown.frame.image, (truth.ellipses, truth.detectable), (ellipses_of(detections), matched), "craters", what
    )
    missed = int(truth.detectable.sum()) - sum(bool(record["detectable"]) for record in detections)
    note = f"{int(truth.detectable.sum())} detectable craters, {missed} of them missed; {int((~matched).sum())} of"
    return Drawn([figure], notes=[f"{note} {len(detections)} detections are of no crater, or of one found before."])


def draw_pair_case(shown: MatchedPair, what: str) -> Drawn:
    """Draw both looks with the matches that are right, those that are wrong, and common craters that were missed."""
    looks = (shown.pair.first, shown.pair.second)
    pairs = np.zeros((0, 2), dtype=np.int64) if shown.matches is None else shown.matches.pairs
    one, other = (look.detections.crater for look in looks)
    here, there = one[pairs[:, 0]], other[pairs[:, 1]]
    right = (here == there) & (here != NO_CRATER)
    rims = MatchedRims(
        (looks[0].detections.ellipses, looks[1].detections.ellipses), pairs, right, _missed(one, other, pairs[right])
    )
    images = (looks[0].frame.image, looks[1].frame.image)
    caption = (
        f"{what}. The same craters have the same colour and number in both looks, {shown.pair.view_deg:.0f} deg of view"
        f" and {shown.pair.sun_deg:.0f} deg of Sun apart. Red and dashed: wrong matches. White and dashed: craters that"
        " both show and that were not matched. Grey: other detections."
    )
    figure = NamedFigure(
        "pair", draw_matched_pair(images, rims, what), caption, "Two looks at craters with their rims."
    )
    drawn = "" if images[0].size else " Rims are drawn by geometry in this scenario: there are no images."
    return Drawn([figure], notes=[f"{len(pairs)} matches, {int(right.sum())} of them right.{drawn}"])


def _missed(one: NDArray[np.int64], other: NDArray[np.int64], right: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k, 2) rows of common craters of which no match is right."""
    common = np.setdiff1d(np.intersect1d(one[one != NO_CRATER], other), one[right[:, 0]])
    rows = [(int(np.flatnonzero(one == c)[0]), int(np.flatnonzero(other == c)[0])) for c in common]
    return np.array(rows, dtype=np.int64).reshape(-1, 2)
