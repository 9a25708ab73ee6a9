"""Small operations on vectors that several parts need."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices that take a vector to its cross product with (..., 3), that first."""
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 2, 1] = vectors[..., 0]
    cross[..., 0, 2] = vectors[..., 1]
    cross[..., 1, 0] = vectors[..., 2]
    return np.asarray(cross - np.swapaxes(cross, -1, -2), dtype=np.float64)


def plane_axes(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (n, 3) across each unit vector (n, 3): first, second and normal are right-handed."""
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
