"""Uniform rotation of a body about its z axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class UniformRotation:
    """A body that turns about its own z axis, which stands still in inertial space; as it is, or as it is believed.

    Parameters
    ----------
    R_body_inertial
        (3, 3) attitude at the epoch, time 0.
    rate_rad_s
        Angular velocity about body z.
    """

    R_body_inertial: FloatArray
    rate_rad_s: float

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n, 3, 3) R_body_inertial at (n,) seconds after the epoch."""
        angles = self.rate_rad_s * np.asarray(times_s, dtype=np.float64)
        turns = np.zeros((len(angles), 3, 3))
        turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles)
        turns[:, 0, 1] = np.sin(angles)
        turns[:, 1, 0] = -np.sin(angles)
        turns[:, 2, 2] = 1.0
        return np.asarray(turns @ self.R_body_inertial, dtype=np.float64)
