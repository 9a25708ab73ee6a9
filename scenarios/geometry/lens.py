"""Distortion of a lens, in image positions at unit focal length, x / z and y / z, from the principal point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from boresight.scenarios.arrays import FloatArray

_NEWTON_STEPS = 50
_TOLERANCE = 1e-15  # of the radius at unit focal length: its rounding


@dataclass(frozen=True, slots=True)
class RadialDistortion:
    """Radial distortion from distorted (``seen``) to undistorted (``ideal``) image positions.

    ``ideal = seen (1 + k1 r**2 + k2 r**4)``, r the length of ``seen``. Both are positions in the image plane at unit
    focal length, x / z and y / z, from the principal point. This is the direction of the instrument kernels of AMICA
    (Ishiguro et al. 2010) and NEAR MSI; their constants in mm**-2 of the focal plane are to be multiplied by the square
    of the focal length in mm. OpenCV's polynomial has the other direction, from ideal to seen. Coefficients are
    negative where the image is stretched towards its corners (a pincushion).
    """

    k1: float
    k2: float = 0.0

    def ideal(self, seen: FloatArray) -> FloatArray:
        """Undistort positions (..., 2)."""
        squared = np.sum(seen * seen, axis=-1, keepdims=True)
        corrected: FloatArray = seen * self._factor(squared)
        return corrected

    def seen(self, ideal: FloatArray) -> FloatArray:
        """Distort positions (..., 2), by Newton's method on the radius.

        NaN for positions beyond the largest radius at which the polynomial can be inverted.
        """
        radius = np.linalg.norm(ideal, axis=-1, keepdims=True)
        found = radius.copy()
        with np.errstate(all="ignore"):
            for _ in range(_NEWTON_STEPS):
                # Solve found (1 + k1 found^2 + k2 found^4) = radius, starting without distortion.
                step = (found * self._factor(found**2) - radius) / self._slope(found**2)
                found = found - step
                if not (np.abs(step) > _TOLERANCE).any():
                    break
            # A root beyond the fold, where the radius falls again, is not the image of the lens.
            rising = (self._slope(found**2) > 0.0) & (found >= 0.0)
            solved = rising & (np.abs(found * self._factor(found**2) - radius) <= 1e-12)
            # On the axis the direction is undefined and nothing is displaced.
            scale = np.where(radius > 0.0, found / radius, 1.0)
        distorted: FloatArray = ideal * np.where(solved, scale, np.nan)
        return distorted

    def ideal_jacobian(self, seen: FloatArray) -> FloatArray:
        """Differentiate the ideal position by the seen one, (..., 2, 2)."""
        squared = np.sum(seen * seen, axis=-1)[..., None, None]
        outer = seen[..., :, None] * seen[..., None, :]
        # d(s f(r^2))/ds = f I + 2 f' s s^T, with f' = k1 + 2 k2 r^2.
        jacobian: FloatArray = self._factor(squared) * np.eye(2) + 2.0 * (self.k1 + 2.0 * self.k2 * squared) * outer
        return jacobian

    def invertible_within(self, radius: float) -> bool:
        """Return whether the distortion is invertible for all distorted positions within ``radius``."""
        # The slope is a quadratic in r^2: its extremes are at the ends of the range and at its vertex.
        squared = [0.0, radius**2]
        if self.k2 != 0.0:
            squared.append(min(max(-0.3 * self.k1 / self.k2, 0.0), radius**2))  # where the slope is least or greatest
        return bool((self._slope(np.array(squared)) > 0.0).all())

    def _factor(self, squared: FloatArray) -> FloatArray:
        return 1.0 + squared * (self.k1 + squared * self.k2)

    def _slope(self, squared: FloatArray) -> FloatArray:
        """Differentiate the ideal radius by the seen one."""
        return 1.0 + squared * (3.0 * self.k1 + squared * 5.0 * self.k2)


@dataclass(frozen=True, slots=True)
class OpenCVDistortion:
    """Distortion from undistorted (``ideal``) to distorted (``seen``) image positions, as OpenCV's calibration has it.

    ``seen = ideal f + [2 p1 x y + p2 (r2 + 2 x2), p1 (r2 + 2 y2) + 2 p2 x y]`` with ideal = (x, y), r2 = x2 + y2 and
    ``f = (1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6)``: Brown (1966), and the rational model.
    """

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    def seen(self, ideal: FloatArray) -> FloatArray:
        """Distort positions (..., 2); NaN where the polynomial has folded over."""
        x, y = ideal[..., 0], ideal[..., 1]
        with np.errstate(all="ignore"):
            u, v, *derivatives = self._distort(x, y)
            return np.where(self._unfolded(x, y, *derivatives)[..., None], np.stack([u, v], axis=-1), np.nan)

    def ideal(self, seen: FloatArray) -> FloatArray:
        """Undistort positions (..., 2); NaN where no position within the fold is seen there."""
        u, v = seen[..., 0], seen[..., 1]
        with np.errstate(all="ignore"):
            x, y = self.newton(u, v, _NEWTON_STEPS)
            again_u, again_v, *derivatives = self._distort(x, y)
            solved = np.hypot(again_u - u, again_v - v) <= 1e-12
            found = solved & self._unfolded(x, y, *derivatives)
        return np.where(found[..., None], np.stack([x, y], axis=-1), np.nan)

    def newton(self, u: Any, v: Any, steps: int) -> tuple[Any, Any]:
        """Solve for the ideal x and y that are seen at u and v; arrays of NumPy or of Dr.Jit."""
        x, y = u, v
        for _ in range(steps):
            at_u, at_v, u_x, u_y, v_y = self._distort(x, y)
            off_u, off_v, determinant = u - at_u, v - at_v, u_x * v_y - u_y * u_y
            x, y = x + (v_y * off_u - u_y * off_v) / determinant, y + (u_x * off_v - u_y * off_u) / determinant
        return x, y

    def ideal_jacobian(self, seen: FloatArray) -> FloatArray:
        """Differentiate the ideal position by the seen one, (..., 2, 2)."""
        ideal = self.ideal(seen)
        _, _, u_x, u_y, v_y = self._distort(ideal[..., 0], ideal[..., 1])
        inverse = np.stack([v_y, -u_y, -u_y, u_x], axis=-1).reshape(*ideal.shape, 2)
        return np.asarray(inverse / (u_x * v_y - u_y * u_y)[..., None, None], dtype=np.float64)

    def invertible_within(self, radius: float) -> bool:
        """Return whether the distortion is invertible for all distorted positions within ``radius``."""
        turns, radii = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 73), np.linspace(0.0, radius, 33))
        return bool(np.isfinite(self.ideal(radii[..., None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1))).all())

    def _distort(self, x: Any, y: Any) -> tuple[Any, ...]:
        """Return u, v, du/dx, du/dy = dv/dx and dv/dy; arithmetic alone, so that it is for Dr.Jit as well."""
        r2 = x * x + y * y
        above, below = (
            (1.0 + r2 * (a + r2 * (b + r2 * c)), a + r2 * (2.0 * b + r2 * 3.0 * c))
            for a, b, c in ((self.k1, self.k2, self.k3), (self.k4, self.k5, self.k6))
        )
        factor = above[0] / below[0]
        by_r2 = (above[1] - factor * below[1]) / below[0]
        p1, p2 = self.p1, self.p2
        return (
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            factor + 2.0 * x * x * by_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
            2.0 * x * y * by_r2 + 2.0 * p1 * x + 2.0 * p2 * y,
            factor + 2.0 * y * y * by_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
        )

    def _unfolded(self, x: FloatArray, y: FloatArray, u_x: FloatArray, u_y: FloatArray, v_y: FloatArray) -> Any:
        """Return whether positions are within the radius where the image begins to fold."""
        return (x * x + y * y < _fold_squared(self)) & (u_x * v_y > u_y * u_y)


@cache
def _fold_squared(lens: OpenCVDistortion) -> float:
    """Return the square of the least radius r at which r f(r) has no slope; infinite where there is none."""
    above, below = (np.polynomial.Polynomial([1.0, *part]) for part in (
        (lens.k1, lens.k2, lens.k3), (lens.k4, lens.k5, lens.k6),
    ))  # fmt: skip
    r2 = np.polynomial.Polynomial([0.0, 1.0])
    slope = (above + 2.0 * r2 * above.deriv()) * below - 2.0 * r2 * above * below.deriv()
    roots = np.concatenate([slope.trim().roots(), below.trim().roots()])
    real = roots[np.abs(roots.imag) <= 1e-12 * np.abs(roots)].real
    return float(min(real[real > 0.0], default=np.inf))


Lens = RadialDistortion | OpenCVDistortion
