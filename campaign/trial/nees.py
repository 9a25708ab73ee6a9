"""The normalised estimation error squared of an error by a covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def nees(error: FloatArray, covariance: FloatArray | None) -> float | None:
    """Return e^T P^-1 e, which has a chi-square distribution with as many degrees of freedom as e has components.

    Parameters
    ----------
    error
        (n,) in any units.
    covariance
        (n, n) in the same.

    Returns
    -------
    The number; None where the covariance is missing or not positive definite, as where something is known perfectly.
    """
    if covariance is None:
        return None
    # Scaled first: square radians and square metres are ten orders of magnitude apart.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    try:
        factor = np.linalg.cholesky(covariance * np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return None
    white = np.linalg.solve(factor, scale * error)
    return float(white @ white)
