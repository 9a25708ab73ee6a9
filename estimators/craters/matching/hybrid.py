"""The hybrid matcher of Cheng et al. (2003): invariants, context and correlation, each where its conditions hold.

Figure 7 is illegible in the scan but for three boxes: context matching, then correlation matching, then the database.
Our reading, from the text on each mode:

1. Context needs the relative pose and enough craters: it comes first if both images have more craters than have to
   agree. "The transform T can be obtained from both the spacecraft pose and the surface normal": the constellations
   are those of the rims predicted from poses and shape, so that relief does not distort them and T only has to account
   for the errors of the poses. Where context finds none, the conic invariants, which need no pose, take its place;
   their pairs count only if the relative pose does not contradict them.
2. Correlation needs similar illumination: where the Sun directions differ by no more than 10 degrees it confirms
   craters near their predicted places, even if they are few.
3. All pairs together give T once more, and steps 4 and 5 of the context mode find the remaining craters with it and
   drop those that do not agree; a crater that correlates is kept in any case.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from boresight.estimators.craters.contract import CraterImage, CraterMatches, GroundModel, too_few_craters
from boresight.estimators.craters.matching.context import (
    ContextOptions,
    fitted_transform,
    match_constellations,
    nearest_couples,
)
from boresight.estimators.craters.matching.correlation import CorrelationMatcher, CorrelationOptions, near_expected
from boresight.estimators.craters.matching.invariants import InvariantMatcher, InvariantOptions
from boresight.estimators.craters.matching.transfer import CraterTransfer, locate_craters, transfer_craters
from boresight.estimators.options import Configured
from boresight.scenarios.arrays import BoolArray, FloatArray, IndexArray
from boresight.scenarios.spec.base import SpecModel

_ROUNDS = 6
_ROUGH = 3.0  # in units of the limit on places: relief spreads the offsets before the transform is fitted


class HybridOptions(SpecModel):
    """Options of the three modes, and of their agreement."""

    correlation: CorrelationOptions = CorrelationOptions()
    context: ContextOptions = ContextOptions()
    invariants: InvariantOptions = InvariantOptions()
    agreeing: int = Field(3, ge=2, description="Matches that have to agree before others are added")


class HybridMatcher(Configured[HybridOptions]):
    """Combines context, invariants and correlation, each where its conditions hold, and adds craters that agree.

    Context is tried on the rims that poses and shape predict; where it finds none, invariants take its place.
    Correlation confirms craters where the Suns are similar. All pairs together give a transform, which finds the
    remaining craters.

    Use it when
    -----------
    The method of the paper is wanted; ``vote`` needs the same knowledge and no pixels.

    It fails when
    -------------
    No crater of the first image is in sight of the second by the prior poses, no mode finds a match, or the matches do
    not agree with each other.

    Cost
    ----
    0.023 s a pair of ``eros-crater-pairs``, about 20 detections an image, without pixels to correlate.

    Source
    ------
    Cheng et al. (2003), figure 7 and the text on each mode; our reading of it is in the module's docstring.
    """

    name: ClassVar[str] = "hybrid"
    version: ClassVar[int] = 2
    options_model = HybridOptions

    def __init__(self, options: HybridOptions) -> None:
        super().__init__(options)
        self._invariants = InvariantMatcher(options.invariants)
        self._correlation = CorrelationMatcher(options.correlation)

    def match(self, first: CraterImage, second: CraterImage, ground: GroundModel) -> CraterMatches:
        """Match by each mode that the two images permit."""
        if reason := too_few_craters(first, second):
            return CraterMatches.none(reason)
        expected = transfer_craters(first, second, locate_craters(first, ground), ground)
        if len(expected.rows) == 0:
            return CraterMatches.none("no crater of the first image is in sight of the second by the prior poses")
        near = near_expected(expected, first, second, self.options.correlation)
        correlated = self._correlation.match(first, second, ground)
        certain = _pairs_of_expected(correlated.pairs, expected, near)
        seed, seen = (first.number, second.number), second.detections.ellipses
        # Predicted rims instead of detected ones: relief is taken out, and what is left is nearly a common shift.
        others, _ = match_constellations(expected.ellipses, seen, near, self.options.context, seed)
        if len(others) == 0:
            others = _pairs_of_expected(self._invariants.match(first, second, ground).pairs, expected, near)
        found = _merge_pairs(certain, others)
        if len(found) == 0:
            return CraterMatches.none(f"neither context nor invariants match a crater, and {correlated.reason}")
        # Pairs confirmed by their pixels stay, whether they agree with the transform or not.
        pairs = _merge_pairs(certain, self._follow_common_shift(expected, second, near, found))
        if len(pairs) == 0:
            return CraterMatches.none(f"{len(found)} matches of constellations do not agree with each other")
        # 2 for pairs confirmed by correlation: numbering prefers them to others with as many confirmations.
        score = np.isin(pairs[:, 0], certain[:, 0]).astype(np.float64) + 1.0
        return CraterMatches(np.column_stack([expected.rows[pairs[:, 0]], pairs[:, 1]]), score)

    def _follow_common_shift(
        self, expected: CraterTransfer, second: CraterImage, near: BoolArray, found: IndexArray
    ) -> IndexArray:
        """Find the pairs (k, 2) that agree with the transform fitted to the pairs found so far."""
        options, seen = self.options, second.detections.ellipses
        here = expected.ellipses
        # Wrong pairs are dropped first: one of them can spoil a fit of least squares.
        # Errors of poses move neighbouring craters nearly alike: the right ones are near the mode of the offsets (not
        # their mean: false pairs are scattered).
        offsets = seen.centre_px[found[:, 1]] - here.centre_px[found[:, 0]]
        near_each_other = np.linalg.norm(offsets[:, None] - offsets, axis=2) < _ROUGH * options.context.place_px
        pairs: IndexArray = found[near_each_other[int(np.argmax(near_each_other.sum(axis=1)))]]
        for _ in range(_ROUNDS):
            if len(pairs) < options.agreeing:
                return np.zeros((0, 2), dtype=np.int64)
            transform = _transform(here.centre_px[pairs[:, 0]], seen.centre_px[pairs[:, 1]])
            again = nearest_couples(transform, here, seen, near, options.context)
            if np.array_equal(again, pairs):
                break
            pairs = again
        return pairs


def _pairs_of_expected(pairs: IndexArray, expected: CraterTransfer, near: BoolArray) -> IndexArray:
    """Convert pairs of detections to pairs of expected crater and detection; keep those that the poses permit."""
    place = {int(row): p for p, row in enumerate(expected.rows)}
    known = [(place[int(i)], int(k)) for i, k in pairs if int(i) in place]
    return np.array([(p, k) for p, k in known if near[p, k]], dtype=np.int64).reshape(-1, 2)


def _merge_pairs(certain: IndexArray, others: IndexArray) -> IndexArray:
    """Add the pairs of ``others`` that share no crater with those of ``certain``."""
    free = ~np.isin(others[:, 0], certain[:, 0]) & ~np.isin(others[:, 1], certain[:, 1])
    return np.concatenate([certain, others[free]])


def _transform(here: FloatArray, there: FloatArray) -> FloatArray:
    """Return the (3, 3) linear transform between places, or a shift if they are too few or nearly collinear."""
    # A transform has six unknowns: with four pairs or fewer, or along a line, it would follow their noise.
    spread = np.linalg.svd(here - here.mean(axis=0), compute_uv=False)
    if len(here) > 4 and spread[-1] > 0.1 * spread[0]:
        return fitted_transform(here, there)
    transform = np.eye(3)
    transform[:2, 2] = (there - here).mean(axis=0)
    return transform
