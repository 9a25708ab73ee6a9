"""Descriptors of two images matched."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.slam.vision.features import Features

IndexArray = NDArray[np.int64]


def matched(before: Features, after: Features, ratio_max: float) -> IndexArray:
    """Match features that are each other's nearest and clearly nearer than the second nearest (Lowe 2004).

    Returns
    -------
    ndarray
        (K, 2) rows of ``before``, ascending, and of ``after``.
    """
    if len(before) == 0 or len(after) < 2:
        return np.empty((0, 2), dtype=np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if before.descriptors.dtype == np.uint8 else cv2.NORM_L2)
    nearest = {back.queryIdx: back.trainIdx for back in matcher.match(after.descriptors, before.descriptors)}
    pairs = matcher.knnMatch(before.descriptors, after.descriptors, k=2)
    clear = [
        (first.queryIdx, first.trainIdx)
        for first, second in pairs
        if first.distance < ratio_max * second.distance and nearest[first.trainIdx] == first.queryIdx
    ]
    return np.array(clear, dtype=np.int64).reshape(-1, 2)
