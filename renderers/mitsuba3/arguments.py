"""Numbers that enter a kernel as data."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def opaque(mi: Any, vector: NDArray[np.float64]) -> Any:
    """Turn a 3-vector into data of a kernel rather than literals, which would compile a kernel for every pose."""
    import drjit as dr

    return mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in vector))
