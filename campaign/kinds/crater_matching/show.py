"""What trials of crater matching show of themselves."""

from __future__ import annotations

from campaign.inspection.show import Kept, Show
from campaign.kinds.crater_matching.draw import draw_pair_case
from campaign.kinds.crater_matching.examples import matching_examples
from campaign.kinds.crater_matching.look import look_at_matches
from campaign.kinds.crater_matching.trial import MatchedPair


def kept(shown: object) -> Kept:
    """Return both images, where there are some, and the matches; none of a matcher that raised."""
    if not isinstance(shown, MatchedPair):
        return Kept()
    looks = {"first": shown.pair.first.frame.image, "second": shown.pair.second.frame.image}
    images = {name: image for name, image in looks.items() if image.size}
    if shown.matches is None:
        return Kept(images)
    matches = shown.matches
    return Kept(images, {"reason": matches.reason, "pairs": matches.pairs.tolist(), "score": matches.score.tolist()})


SHOW = Show(draw=draw_pair_case, kept=kept, look=look_at_matches, examples=matching_examples)
