"""Ellipse fit (1): weighted direct fits, reweighted until the weights are those of geometric distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry.ellipse import fit_conics, sampson_distances

FloatArray = NDArray[np.float64]
RIDGE = 1e-9
"""Of fits to arcs, which leave the middle of an ellipse poorly known."""
_CUTOFF = 2.5  # residuals of so many standard deviations count a quarter


def fit_reweighted(points: FloatArray, weights: FloatArray, rounds: int = 6) -> FloatArray:
    """Fit ellipses whose weights are renewed from the last fit: (m, 3, 3) conics, NaN where there is none.

    A point's weight is its own over the square of the conic's slope there, so that the sum that the direct fit
    minimises becomes that of squared distances, less what the weights of Geman and McClure take from points farther off
    than the others.
    """
    conics = fit_conics(points, weights, RIDGE)
    for _ in range(rounds):
        far = sampson_distances(points, conics)
        far = np.where(np.isfinite(far), far, 0.0)
        spread = np.maximum(1.4826 * _median(np.abs(far), weights), 0.1)
        robust = (1.0 + (far / (_CUTOFF * spread[:, None])) ** 2) ** -2.0
        homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
        slope = np.linalg.norm(np.einsum("mij,mkj->mki", conics[:, :2], homogeneous), axis=-1)
        mean = np.sqrt(np.sum(weights * slope**2, axis=1) / np.maximum(weights.sum(axis=1), 1e-12))
        flat = np.maximum(slope / np.maximum(mean, 1e-30)[:, None], 0.2)
        renewed = weights * robust / flat**2
        good = np.isfinite(renewed).all(axis=1)
        conics = np.where(
            good[:, None, None], fit_conics(points, np.where(good[:, None], renewed, weights), RIDGE), np.nan
        )
    return conics


def _median(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Medians (m,) of the rows' values that have a weight."""
    kept = np.where(weights > 0.0, values, np.nan)
    kept[np.isnan(kept).all(axis=1)] = 0.0
    return np.asarray(np.nanmedian(kept, axis=1), dtype=np.float64)
