"""Ellipses fitted to points, and the distances of points from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def fit_conics(points: FloatArray, weights: FloatArray, ridge: float = 1e-12) -> FloatArray:
    """Fit one ellipse to each set of points by direct least squares (Halir and Flusser 1998).

    Algebraic distances under 4 a c - b^2 = 1, of points brought to the origin and to unit size.

    Parameters
    ----------
    points
        (m, k, 2).
    weights
        (m, k), zero for what is no point.
    ridge
        Share of its trace that is added to the scatter of the linear terms, which points on a line leave singular.

    Returns
    -------
    conics
        (m, 3, 3), NaN where there is no ellipse.
    """
    total = np.maximum(weights.sum(axis=1), 1e-12)
    shift = np.einsum("mk,mki->mi", weights, points) / total[:, None]
    moved = points - shift[:, None]
    scale = np.sqrt(np.einsum("mk,mki->m", weights, moved**2) / total)
    moved = moved / np.maximum(scale, 1e-9)[:, None, None]
    x, y = moved[..., 0], moved[..., 1]
    quadratic = np.stack([x * x, x * y, y * y], axis=-1)
    linear = np.stack([x, y, np.ones_like(x)], axis=-1)
    s1 = np.einsum("mk,mki,mkj->mij", weights, quadratic, quadratic)
    s2 = np.einsum("mk,mki,mkj->mij", weights, quadratic, linear)
    s3 = np.einsum("mk,mki,mkj->mij", weights, linear, linear)
    best, tail = _constrained(s1, s2, s3, ridge)
    conics = _matrix(best, tail)
    frame = np.zeros((len(points), 3, 3))
    frame[:, 0, 0] = frame[:, 1, 1] = 1.0 / np.maximum(scale, 1e-9)
    frame[:, :2, 2] = -shift / np.maximum(scale, 1e-9)[:, None]
    frame[:, 2, 2] = 1.0
    return np.asarray(np.swapaxes(frame, 1, 2) @ conics @ frame, dtype=np.float64)


def _constrained(s1: FloatArray, s2: FloatArray, s3: FloatArray, ridge: float) -> tuple[FloatArray, FloatArray]:
    """Minimise over conics with 4 a c - b^2 = 1: the quadratic and the linear coefficients."""
    added = ridge * np.trace(s3, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
    to_linear = -np.linalg.solve(s3 + added, np.swapaxes(s2, 1, 2))
    reduced = s1 + s2 @ to_linear
    turned = np.stack([reduced[:, 2] / 2.0, -reduced[:, 1], reduced[:, 0] / 2.0], axis=1)
    values, vectors = np.linalg.eig(turned)
    real = vectors.real
    definite = 4.0 * real[:, 0] * real[:, 2] - real[:, 1] ** 2
    usable = (definite > 0.0) & (np.abs(values.imag) < 1e-8)
    choice = np.argmin(np.where(usable, np.abs(values.real), np.inf), axis=1)
    best = np.take_along_axis(real, choice[:, None, None], axis=2)[:, :, 0]
    best[~usable.any(axis=1)] = np.nan
    return best, np.einsum("mij,mj->mi", to_linear, best)


def _matrix(quadratic: FloatArray, linear: FloatArray) -> FloatArray:
    """Lay a x^2 + b x y + c y^2 + d x + e y + f out as a symmetric matrix."""
    a, b, c = quadratic.T
    d, e, f = linear.T
    rows = [[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def sampson_distances(points: FloatArray, conics: FloatArray) -> FloatArray:
    """Distances (m, k) of points from conics to first order (Sampson 1982), px; positive outside."""
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    pulled = np.einsum("mij,mkj->mki", conics, homogeneous)
    value = np.einsum("mki,mki->mk", pulled, homogeneous)
    slope = 2.0 * np.linalg.norm(pulled[..., :2], axis=-1)
    sign = np.where(np.trace(conics[:, :2, :2], axis1=1, axis2=2) < 0.0, -1.0, 1.0)
    return np.asarray(sign[:, None] * value / np.maximum(slope, 1e-12), dtype=np.float64)
