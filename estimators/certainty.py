"""What a prior that is sure of something comes to as a matrix that can be inverted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Far below what any image tells, and far above the rounding of a pose in double precision.
_LEAST_SIGMAS = np.array([1e-9] * 3 + [1e-6] * 3)


def floor_variances(covariance: FloatArray) -> FloatArray:
    """Return a prior's covariance (6, 6) of [rotation_rad, translation_m] so that it has an inverse.

    A scenario may leave a component without error: its variance is 0. It becomes that of 1e-9 rad or 1e-6 m, which
    holds the component where it is. Any other covariance is returned as it is.
    """
    variances = np.diag(covariance)
    if (variances >= _LEAST_SIGMAS**2).all():
        return covariance
    return np.asarray(covariance + np.diag(np.where(variances < _LEAST_SIGMAS**2, _LEAST_SIGMAS**2, 0.0)))
