"""The types of arrays that all code shares, and a factor of robust statistics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
SingleArray = NDArray[np.float32]
Image = NDArray[np.float32]
"""(H, W) pixels."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of normal values over their median absolute deviation."""
