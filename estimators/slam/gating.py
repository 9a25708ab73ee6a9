"""Which associations a filter believes: gates on its innovation, whose covariance it knows.

One by one a gate misses what is common to all: where the predicted position is wrong, all pixels move together, and
the gate of each must be as wide as that. One-point RANSAC (Civera et al. 2010) takes that out: once one landmark is
taken for right, the others are expected much more closely.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

Gate = Literal["none", "individual", "one-point"]

_MOST_HYPOTHESES = 64


def believed(residual_px: FloatArray, covariance_px2: FloatArray, gate: Gate, false_alarm: float) -> BoolArray:
    """(n,) pixels that fit the prediction.

    Parameters
    ----------
    residual_px, covariance_px2
        (n, 2) innovation and its joint covariance (2 n, 2 n).
    false_alarm
        Probability to refuse a right one.
    """
    n = len(residual_px)
    if gate == "none" or n == 0:
        return np.ones(n, dtype=np.bool_)
    limit = float(chdtri(2, false_alarm))
    joint = covariance_px2.reshape(n, 2, n, 2).transpose(0, 2, 1, 3)  # (n, n, 2, 2) blocks
    alone = mahalanobis_squares(residual_px, joint[np.arange(n), np.arange(n)]) <= limit
    if gate == "individual" or not alone.any():
        return alone
    together = np.ones(n, dtype=np.bool_)
    if _contradictions(residual_px, covariance_px2, together).max() <= limit:
        return together
    core = _consensus(residual_px, joint, alone, limit)
    return _rescued(residual_px, covariance_px2, _cleared(residual_px, covariance_px2, core, limit), limit)


def _consensus(residual_px: FloatArray, joint: FloatArray, alone: BoolArray, limit: float) -> BoolArray:
    """(n,) the largest set that fits one of its own taken for right; of equal ones that with the least squares."""
    own = joint[np.arange(len(joint)), np.arange(len(joint))]
    candidates = np.flatnonzero(alone)
    some = candidates[np.linspace(0, len(candidates) - 1, min(len(candidates), _MOST_HYPOTHESES)).astype(np.int64)]
    best, best_key = alone, (-1, -np.inf)
    for one in some.tolist():
        gain = joint[:, one] @ np.linalg.inv(own[one])
        left = np.asarray(residual_px - gain @ residual_px[one], dtype=np.float64)
        squares = mahalanobis_squares(left, np.asarray(own - gain @ joint[one], dtype=np.float64))
        squares[one] = 0.0
        fit = squares <= limit
        key = (int(fit.sum()), -float(squares[fit].sum()))
        if key > best_key:
            best, best_key = fit, key
    return best


def _cleared(residual_px: FloatArray, covariance_px2: FloatArray, core: BoolArray, limit: float) -> BoolArray:
    """(n,) the core without those that the rest of it contradicts, the worst first (Baarda's data snooping)."""
    left = core.copy()
    while np.count_nonzero(left) > 2:
        squares = _contradictions(residual_px, covariance_px2, left)
        if squares.max() <= limit:
            break
        left[np.flatnonzero(left)[squares.argmax()]] = False
    return left


def _contradictions(residual_px: FloatArray, covariance_px2: FloatArray, among: BoolArray) -> FloatArray:
    """(k,) squared distance of each of those marked from what all the others of them predict.

    With L the inverse of their covariance, what the others leave of pixel j is ``L_jj^-1 (L r)_j``, of covariance
    ``L_jj^-1``.
    """
    inside = np.repeat(among, 2)
    inverse = np.asarray(np.linalg.inv(covariance_px2[np.ix_(inside, inside)]), dtype=np.float64)
    pull = (inverse @ residual_px[among].ravel()).reshape(-1, 2)
    k = np.arange(len(pull))
    return mahalanobis_squares(pull, inverse.reshape(len(k), 2, len(k), 2)[k, :, k])


def _rescued(residual_px: FloatArray, covariance_px2: FloatArray, core: BoolArray, limit: float) -> BoolArray:
    """(n,) the core, and those that fit what all of it together predicts."""
    inside = np.repeat(core, 2)
    gain = np.linalg.solve(covariance_px2[np.ix_(inside, inside)], covariance_px2[inside]).T
    left = residual_px - (gain @ residual_px[core].ravel()).reshape(-1, 2)
    covariance = covariance_px2 - gain @ covariance_px2[inside]
    n = np.arange(len(residual_px))
    blocks = covariance.reshape(len(n), 2, len(n), 2)[n, :, n]
    outside = ~core
    rescued = core.copy()
    rescued[outside] = mahalanobis_squares(left[outside], blocks[outside]) <= limit
    return rescued


def mahalanobis_squares(residual_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """(n,) squared Mahalanobis distances of (n, 2) by (n, 2, 2), in closed form."""
    a, b, c = covariance_px2[:, 0, 0], covariance_px2[:, 0, 1], covariance_px2[:, 1, 1]
    x, y = residual_px[:, 0], residual_px[:, 1]
    determinant = np.maximum(a * c - b**2, 1e-18)  # of a pixel taken for right, nothing is left
    return np.asarray((c * x**2 - 2.0 * b * x * y + a * y**2) / determinant, dtype=np.float64)
