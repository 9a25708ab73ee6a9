"""What is drawn of crater matching: a pair of looks with what was matched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Drawn
from campaign.kinds.crater_matching.trial import MatchedPair, right_matches
from reports.figures.crater_pairs import MatchedRims, draw_matched_pair
from reports.schema.named_figure import NamedFigure
from scenarios.craters.simulated import NO_CRATER


def draw_pair_case(again: Recomputed) -> Drawn | None:
    """Draw both looks with the matches that are right, those that are wrong, and common craters that were missed."""
    shown, what = again.shown, str(again.case)
    if not isinstance(shown, MatchedPair):
        return None
    looks = (shown.pair.first, shown.pair.second)
    pairs = np.zeros((0, 2), dtype=np.int64) if shown.matches is None else shown.matches.pairs
    one, other = (look.detections.crater for look in looks)
    right = np.zeros(0, dtype=np.bool_) if shown.matches is None else right_matches(shown.matches, shown.pair)
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
