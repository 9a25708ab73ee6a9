"""Rotation vectors: small rotations perturb on the left, ``R_true = exp(turn) R``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

_SMALL_RAD = 1e-4


def rotation_of(turns_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) rotation matrices of rotation vectors (..., 3)."""
    shape = turns_rad.shape[:-1]
    return Rotation.from_rotvec(turns_rad.reshape(-1, 3)).as_matrix().reshape(*shape, 3, 3)


def turn_of(rotation: FloatArray) -> FloatArray:
    """(3,) rotation vector of a rotation (3, 3), at most half a turn long."""
    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), dtype=np.float64)


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices that take a vector to its cross product with (..., 3), that first."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def left_jacobian(turns_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) J with ``exp(turn + d) = exp(J d) exp(turn)`` to first order, of rotation vectors (..., 3).

    ``J = I + (1 - cos a) / a^2 [t] + (a - sin a) / a^3 [t]^2``, for a small angle ``a`` by the first two terms of the
    series.
    """
    squares = np.sum(turns_rad**2, axis=-1)[..., None, None]
    angle = np.sqrt(np.maximum(squares, _SMALL_RAD**2))
    small = squares < _SMALL_RAD**2
    first = np.where(small, 0.5 - squares / 24.0, (1.0 - np.cos(angle)) / angle**2)
    second = np.where(small, 1.0 / 6.0 - squares / 120.0, (angle - np.sin(angle)) / angle**3)
    cross = cross_matrix(turns_rad)
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross, dtype=np.float64)
