"""Least-squares ellipses through curves in an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.geometry import Ellipses

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_CONSTRAINT = np.array([[0.0, 0.0, 2.0], [0.0, -1.0, 0.0], [2.0, 0.0, 0.0]])


def fit_ellipses(uv_px: FloatArray, used: BoolArray) -> tuple[Ellipses, BoolArray]:
    """Fit an ellipse to each of n curves (n, K, 2) by what is used of it, (n, K): Halir and Flusser (1998).

    Algebraic distances with the constraint 4 a c - b^2 = 1, of points brought to the origin and to unit size.

    Returns
    -------
    Ellipses, and (n,) whether there is one: else its place holds a circle of a pixel.
    """
    weight = used.astype(np.float64)[..., None]
    total = weight.sum(axis=1)
    centre = (uv_px * weight).sum(axis=1) / total
    offset = (uv_px - centre[:, None]) * weight
    size = np.sqrt((offset**2).sum(axis=(1, 2)) / total[:, 0])
    x, y = np.moveaxis((uv_px - centre[:, None]) / size[:, None, None], -1, 0)
    quadratic = np.stack([x * x, x * y, y * y], axis=-1) * weight
    linear = np.stack([x, y, np.ones_like(x)], axis=-1) * weight
    s1, s2, s3 = (
        np.einsum("nki,nkj->nij", a, b) for a, b in ((quadratic, quadratic), (quadratic, linear), (linear, linear))
    )
    conics = np.broadcast_to(np.diag([1.0, 1.0, -1.0]), (len(x), 3, 3)).copy()
    found = np.zeros(len(x), dtype=bool)
    for k in range(len(x)):
        conic = _direct(s1[k], s2[k], s3[k])
        if conic is not None:
            conics[k], found[k] = conic, True
    scaled = Ellipses.from_conics(conics) if len(conics) else Ellipses.none()
    one = size[:, None]
    return Ellipses(scaled.centre_px * one + centre, scaled.semi_axes_px * one, scaled.angle_rad), found


def _direct(s1: FloatArray, s2: FloatArray, s3: FloatArray) -> FloatArray | None:
    """Conic (3, 3) from the scatter matrices of quadratic and linear terms; None where there is no real ellipse."""
    try:
        to_linear = -np.linalg.solve(s3, s2.T)
        values, vectors = np.linalg.eig(np.linalg.solve(_CONSTRAINT, s1 + s2 @ to_linear))
    except np.linalg.LinAlgError:
        return None
    real = np.real(vectors)
    constraint = 4.0 * real[0] * real[2] - real[1] ** 2
    good = np.flatnonzero((constraint > 0.0) & np.isfinite(np.real(values)))
    if not len(good):
        return None
    a, b, c = real[:, good[0]]
    d, e, f = to_linear @ real[:, good[0]]
    conic = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]])
    if a + c < 0.0:
        conic = -conic
    # A real ellipse: positive definite about its centre, where the conic is negative.
    return conic if np.linalg.det(conic[:2, :2]) > 0.0 and np.linalg.det(conic) < 0.0 else None


def rim_deviation(ellipses: Ellipses, uv_px: FloatArray, used: BoolArray) -> FloatArray:
    """(n,) RMS distance of the used points of curves (n, K, 2) from their ellipses, in radii (Sampson's distance)."""
    points = np.concatenate([uv_px, np.ones((*uv_px.shape[:2], 1))], axis=-1)
    gradient = np.einsum("nij,nkj->nki", ellipses.conics(), points)
    value = np.einsum("nki,nki->nk", points, gradient)
    distance = value / (2.0 * np.maximum(np.linalg.norm(gradient[..., :2], axis=-1), 1e-12))
    mean_square = (distance**2 * used).sum(axis=1) / np.maximum(used.sum(axis=1), 1)
    return np.asarray(np.sqrt(mean_square) / ellipses.radius_px, dtype=np.float64)
