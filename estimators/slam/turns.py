"""Rotation vectors: small rotations perturb on the left, ``R_true = exp(turn) R``.

In closed form, with ``[t]`` the matrix of the cross product: scipy's take some hundred microseconds a call, which a
filter has dozens of in a frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenarios.geometry import cross_matrix

FloatArray = NDArray[np.float64]

_SMALL_RAD = 1e-4


def rotation_of(turns_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) rotation matrices of rotation vectors (..., 3).

    ``exp(t) = I + sin(a) / a [t] + (1 - cos a) / a^2 [t]^2`` with the angle ``a`` (Rodrigues).
    """
    sine, cosine, _ = _series(turns_rad)
    cross = cross_matrix(turns_rad)
    return np.asarray(np.eye(3) + sine * cross + cosine * (cross @ cross), dtype=np.float64)


def left_jacobian(turns_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) J with ``exp(t + d) = exp(J d) exp(t)`` to first order, of rotation vectors (..., 3).

    ``J = I + (1 - cos a) / a^2 [t] + (a - sin a) / a^3 [t]^2``.
    """
    _, cosine, rest = _series(turns_rad)
    cross = cross_matrix(turns_rad)
    return np.asarray(np.eye(3) + cosine * cross + rest * (cross @ cross), dtype=np.float64)


def turn_of(rotation: FloatArray) -> FloatArray:
    """(3,) rotation vector of a rotation (3, 3), at most half a turn long."""
    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), dtype=np.float64)


def _series(turns_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(..., 1, 1) sin(a) / a, (1 - cos a) / a^2 and (a - sin a) / a^3; of a small angle two terms of each series."""
    squares = (turns_rad**2).sum(axis=-1)[..., None, None]
    if squares.max(initial=0.0) < _SMALL_RAD**2:
        return 1.0 - squares / 6.0, 0.5 - squares / 24.0, 1.0 / 6.0 - squares / 120.0
    angle = np.sqrt(np.maximum(squares, _SMALL_RAD**2))
    sine = np.sin(angle)
    large = squares >= _SMALL_RAD**2
    return (
        np.where(large, sine / angle, 1.0 - squares / 6.0),
        np.where(large, (1.0 - np.cos(angle)) / angle**2, 0.5 - squares / 24.0),
        np.where(large, (angle - sine) / angle**3, 1.0 / 6.0 - squares / 120.0),
    )
