"""How an image moves about a point: the affine flow of the matches nearest to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]

_NEIGHBOURS = 16
_TRIMS = 2
_KEPT_SHARE = 0.75


def local_flow(before_px: FloatArray, after_px: FloatArray, at_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit an affine map to the matches nearest to each point; the worst fitting ones are left out.

    Parameters
    ----------
    before_px, after_px
        (K, 2) matches, K at least 3.
    at_px
        (n, 2) points of the image before.

    Returns
    -------
    ndarray
        (n, 2) where the points are in the image after.
    ndarray
        (n, 2, 2) derivative of the map there.
    """
    count = min(_NEIGHBOURS, len(before_px))
    _, rows = cKDTree(before_px).query(at_px, k=count)
    offset = before_px[rows] - at_px[:, None]
    target = after_px[rows]
    design = np.concatenate([offset, np.ones((*offset.shape[:2], 1))], axis=2)
    weight = np.ones(offset.shape[:2])
    for _ in range(_TRIMS + 1):
        weighted = design * weight[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, design) + 1e-9 * np.eye(3)
        found = np.linalg.solve(normal, np.einsum("nki,nkj->nij", weighted, target))
        misfit = np.linalg.norm(np.einsum("nki,nij->nkj", design, found) - target, axis=2)
        weight = (misfit <= np.quantile(misfit, _KEPT_SHARE, axis=1, keepdims=True)).astype(np.float64)
    return found[:, 2], np.swapaxes(found[:, :2], 1, 2)


def growth(change: FloatArray) -> FloatArray:
    """(n,) factor by which an area grows or shrinks, at least 1, under maps of derivative (n, 2, 2)."""
    area = np.maximum(np.abs(np.linalg.det(change)), 1e-12)
    return np.asarray(np.maximum(area, 1.0 / area), dtype=np.float64)
