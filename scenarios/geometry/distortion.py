"""Radial distortion of a lens, as instrument kernels state it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_NEWTON_STEPS = 50
_TOLERANCE = 1e-15


@dataclass(frozen=True, slots=True)
class RadialDistortion:
    """Where an ideal lens would have put what a real one shows.

    ``ideal = seen (1 + k1 r**2 + k2 r**4)``, r the length of ``seen``. Both are positions in the image plane at unit
    focal length, x / z and y / z, from the principal point. This is the direction of the kernels of AMICA
    (Ishiguro et al. 2010) and NEAR MSI, whose constants are in mm**-2 of the focal plane: times the square of the
    focal length in mm they are these. OpenCV's polynomial runs the other way, from ideal to seen.

    Parameters
    ----------
    k1, k2
        Coefficients; negative where the image is stretched towards its corners (a pincushion).
    """

    k1: float
    k2: float = 0.0

    def ideal(self, seen: FloatArray) -> FloatArray:
        """Take seen positions (..., 2) to ideal ones."""
        squared = np.sum(seen * seen, axis=-1, keepdims=True)
        corrected: FloatArray = seen * self._factor(squared)
        return corrected

    def seen(self, ideal: FloatArray) -> FloatArray:
        """Take ideal positions (..., 2) to seen ones, by Newton's method on the radius.

        NaN for positions beyond the largest radius at which the polynomial can be inverted.
        """
        radius = np.linalg.norm(ideal, axis=-1, keepdims=True)
        found = radius.copy()
        with np.errstate(all="ignore"):
            for _ in range(_NEWTON_STEPS):
                step = (found * self._factor(found**2) - radius) / self._slope(found**2)
                found = found - step
                if not (np.abs(step) > _TOLERANCE).any():
                    break
            rising = (self._slope(found**2) > 0.0) & (found >= 0.0)
            solved = rising & (np.abs(found * self._factor(found**2) - radius) <= 1e-12)
            scale = np.where(radius > 0.0, found / radius, 1.0)
        distorted: FloatArray = ideal * np.where(solved, scale, np.nan)
        return distorted

    def ideal_jacobian(self, seen: FloatArray) -> FloatArray:
        """Differentiate the ideal position by the seen one, (..., 2, 2)."""
        squared = np.sum(seen * seen, axis=-1)[..., None, None]
        outer = seen[..., :, None] * seen[..., None, :]
        jacobian: FloatArray = self._factor(squared) * np.eye(2) + 2.0 * (self.k1 + 2.0 * self.k2 * squared) * outer
        return jacobian

    def invertible_within(self, radius: float) -> bool:
        """Tell whether no two seen positions within ``radius`` have the same ideal one."""
        squared = [0.0, radius**2]
        if self.k2 != 0.0:
            squared.append(min(max(-0.3 * self.k1 / self.k2, 0.0), radius**2))  # where the slope is least or greatest
        return bool((self._slope(np.array(squared)) > 0.0).all())

    def _factor(self, squared: FloatArray) -> FloatArray:
        return 1.0 + squared * (self.k1 + squared * self.k2)

    def _slope(self, squared: FloatArray) -> FloatArray:
        """Differentiate the ideal radius by the seen one."""
        return 1.0 + squared * (3.0 * self.k1 + squared * 5.0 * self.k2)
