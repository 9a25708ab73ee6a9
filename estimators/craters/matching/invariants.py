"""Matching by projective conic invariants, after Cheng et al. (2003) and Forsyth et al. (1991)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from boresight.estimators.craters.contract import CraterImage, CraterMatches, GroundModel, too_few_craters
from boresight.estimators.options import Configured
from boresight.scenarios.arrays import FloatArray, IndexArray
from boresight.scenarios.geometry import Ellipses
from boresight.scenarios.spec.base import SpecModel


class InvariantOptions(SpecModel):
    """Options of matching by invariants; the paper prints none but the threshold of 4 votes."""

    tolerance: float = Field(0.02, gt=0.0, description="Largest difference of the logarithms of both invariants")
    votes: int = Field(4, ge=1, description="A pair of craters needs more votes than this")
    couples: int = Field(2, ge=1, description="An image pair needs more such pairs of craters than this")
    margin: float | None = Field(
        None, ge=1.0, description="Ratio of a pair's votes to those of each rival; null rejects rivals, as in the paper"
    )


class InvariantMatcher(Configured[InvariantOptions]):
    """Compares the conic invariants of all pairs of craters: needs no pose, but rims in one plane.

    On a body with relief no two rims are coplanar: from 200 km around Eros the invariants of exact rims differ by 3 %
    between two images (median), so that a tolerance wide enough for them gives chance pairs more votes than any fixed
    threshold, and the paper's rule then rejects the right pair with its rivals. With a ``margin`` the pair that
    outvotes its rivals is kept.

    Use it when
    -----------
    No relative pose is known, and the ground is flat.

    It fails when
    -------------
    An image has fewer than two craters, or no more than ``couples`` pairs have enough votes: relief and errors of the
    rims scatter the invariants.

    Cost
    ----
    0.003 s a pair of ``eros-crater-pairs``, about 20 detections an image.

    Source
    ------
    Cheng et al. (2003), equation (10); Forsyth et al. (1991).
    """

    name: ClassVar[str] = "invariants"
    version: ClassVar[int] = 1
    options_model = InvariantOptions

    def match(self, first: CraterImage, second: CraterImage, ground: GroundModel) -> CraterMatches:
        """Match by invariants alone; ``ground`` is not used."""
        del ground
        if reason := too_few_craters(first, second, needed=2):
            return CraterMatches.none(reason)
        votes = vote_matrix(first.detections.ellipses, second.detections.ellipses, self.options.tolerance)
        pairs = unambiguous_pairs(votes, self.options.votes, self.options.margin)
        if len(pairs) <= self.options.couples:
            return CraterMatches.none(f"{len(pairs)} couples of craters have enough votes of conic invariants")
        return CraterMatches(pairs, votes[pairs[:, 0], pairs[:, 1]].astype(np.float64))


def conic_invariants(conics: FloatArray) -> FloatArray:
    """Return (n, n) of equation (10): entry (i, j) is tr(C_i^-1 C_j) with each conic scaled to unit determinant.

    Entry (j, i) is the second invariant of the pair. They are unchanged under C -> T^-T C T^-1: the product C_i^-1 C_j
    undergoes a similarity, which keeps the trace, and the determinants are scaled alike.
    """
    # A conic has no scale of its own; a real cube root exists for either sign of the determinant.
    unit = conics / np.cbrt(np.linalg.det(conics))[:, None, None]
    return np.asarray(np.einsum("iab,jba->ij", np.linalg.inv(unit), unit), dtype=np.float64)  # eq. (10)


def hash_table(ellipses: Ellipses) -> tuple[IndexArray, FloatArray]:
    """List all ordered pairs (i, j) of craters, (n (n - 1), 2), with the logarithms of their two invariants.

    Rims outside each other have negative invariants, those inside each other positive ones: the sign is applied after
    the logarithm, shifted by 1000, so that the two kinds never match.
    """
    invariants = conic_invariants(ellipses.conics())
    i, j = np.nonzero(~np.eye(len(ellipses), dtype=np.bool_))
    both = np.stack([invariants[i, j], invariants[j, i]], axis=1)
    with np.errstate(divide="ignore"):
        logs = np.sign(both) * (np.log(np.maximum(np.abs(both), 1e-300)) + 1e3)
    return np.stack([i, j], axis=1), logs


def vote_matrix(first: Ellipses, second: Ellipses, tolerance: float) -> IndexArray:
    """Return (n, m) votes: each pair of close rows of the two hash tables votes for the pairs of its craters."""
    votes = np.zeros((len(first), len(second)), dtype=np.int64)
    if len(first) < 2 or len(second) < 2:
        return votes
    (pairs, here), (others, there) = hash_table(first), hash_table(second)
    # Both invariants have to be within the tolerance: the maximum norm.
    close = cKDTree(here).query_ball_tree(cKDTree(there), tolerance, p=np.inf)
    for (i, j), found in zip(pairs, close, strict=True):
        for k, m in others[found]:
            votes[i, k] += 1
            votes[j, m] += 1
    return votes


def unambiguous_pairs(votes: IndexArray, threshold: int, margin: float | None = None) -> IndexArray:
    """List the pairs (k, 2) with more votes than the threshold that have no rival in their row and column.

    A rival is a pair that exceeds the threshold as well; with a ``margin``, any pair whose votes times ``margin`` are
    not fewer. Each ordered pair of craters is in a table twice, (i, j) and (j, i), so that each agreement counts twice.
    """
    # Doubled, because the table lists each pair of craters in both orders.
    strong = votes > 2 * threshold
    if margin is None:
        alone = strong & (strong.sum(axis=1, keepdims=True) == 1) & (strong.sum(axis=0, keepdims=True) == 1)
        return np.argwhere(alone).astype(np.int64)
    kept = []
    for i, k in np.argwhere(strong):
        rivals = np.concatenate([np.delete(votes[i], k), np.delete(votes[:, k], i)])
        if votes[i, k] > margin * int(rivals.max(initial=0)):
            kept.append((i, k))
    return np.array(kept, dtype=np.int64).reshape(-1, 2)
