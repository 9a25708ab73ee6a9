"""Weights that keep wrong craters from deciding: detections have heavier tails than any Gaussian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# A Gaussian pair of offsets exceeds it in 14 % of cases.
_LIMIT_SIGMA = 2.0


def huber_weights(sigmas: FloatArray) -> FloatArray:
    """Weights of Huber's loss for offsets in units of their standard deviation, any shape.

    Huber (1964, Ann. Math. Stat. 35, 73): 1 up to a limit, beyond it the limit over the offset.
    """
    return np.asarray(_LIMIT_SIGMA / np.maximum(sigmas, _LIMIT_SIGMA), dtype=np.float64)
