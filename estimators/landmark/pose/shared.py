"""Which observations rest on the same pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def shared_pixels(first_px: FloatArray, last_px: FloatArray) -> FloatArray:
    """Share (N, N) of the pixels that each two windows have in common, over the geometric mean of their areas.

    If what disturbs an observation is white noise in the pixels of its window, this is the correlation of the
    disturbances of two; as the Gram matrix of the windows it is never indefinite.

    Parameters
    ----------
    first_px, last_px
        (N, 2) columns and rows of the windows' first corners and of their opposite corners.
    """
    low = np.maximum(first_px[:, None], first_px[None])
    high = np.minimum(last_px[:, None], last_px[None])
    common = np.clip(high - low, 0.0, None).prod(axis=2)
    root = np.sqrt(np.diag(common))
    share: FloatArray = common / np.outer(root, root)
    return share
