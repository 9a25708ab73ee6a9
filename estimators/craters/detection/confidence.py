"""Confidence (4), and the choice among ellipses that tell of the same crater."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.craters.detection.merit import side_merits
from estimators.craters.detection.refinement import Scales
from scenarios.geometry import Ellipses

FloatArray = NDArray[np.float64]


def confidence(ellipses: Ellipses, scales: Scales, sun_px: FloatArray, gap: float) -> FloatArray:
    """Mean over both sides' points of the gradient's direction along the signed normal, equation (4): (n,), at most 1.

    It is the smaller of both sides' means: a terminator or a ridge lights up one side as well as any rim.
    """
    values = np.zeros(len(ellipses))
    rows = scales.of(ellipses.radius_px)
    for i in np.unique(rows):
        chosen = rows == i
        values[chosen] = side_merits(ellipses[chosen], scales.pointing[i], sun_px, gap).min(axis=1)
    return values


def suppress(ellipses: Ellipses, score: FloatArray, least_apart: float, least_ratio: float) -> NDArray[np.int64]:
    """Keep the best of those that tell of one crater: rows, the highest score first.

    Parameters
    ----------
    least_apart
        Distance of centres, in units of the smaller mean radius, from which two are two craters.
    least_ratio
        Ratio of mean radii from which two are two craters, one in the other.
    """
    order = np.argsort(-score, kind="stable")
    radius = ellipses.radius_px
    kept: list[int] = []
    for i in order:
        near = np.array(kept, dtype=np.int64)
        apart = np.linalg.norm(ellipses.centre_px[near] - ellipses.centre_px[i], axis=1)
        smaller = np.minimum(radius[near], radius[i])
        ratio = np.maximum(radius[near], radius[i]) / smaller
        if not np.any((apart < least_apart * smaller) & (ratio < least_ratio)):
            kept.append(int(i))
    return np.array(kept, dtype=np.int64)
