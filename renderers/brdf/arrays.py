"""Elementwise functions of NumPy or Dr.Jit, and the angles that reflectance formulas share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# A NumPy array or number, or a Dr.Jit array: neither library has a type that covers both.
Array = Any


@dataclass(frozen=True, slots=True)
class ArrayMath:
    """Elementwise functions of one array library, by name."""

    sqrt: Callable[[Array], Array]
    exp: Callable[[Array], Array]
    log: Callable[[Array], Array]
    sin: Callable[[Array], Array]
    cos: Callable[[Array], Array]
    atan2: Callable[[Array, Array], Array]
    maximum: Callable[[Array, Array], Array]
    minimum: Callable[[Array, Array], Array]
    where: Callable[[Array, Array, Array], Array]


NUMPY = ArrayMath(
    sqrt=np.sqrt,
    exp=np.exp,
    log=np.log,
    sin=np.sin,
    cos=np.cos,
    atan2=np.arctan2,
    maximum=np.maximum,
    minimum=np.minimum,
    where=np.where,
)

# Lower bound of the cosines of incidence and emission, so that every formula stays finite at grazing angles:
# 0.006 deg above the horizon.
COS_MIN = 1e-4


def clipped_cosine(cosine: Array, xp: ArrayMath) -> Array:
    """Clip a cosine of incidence or emission to [COS_MIN, 1]."""
    return xp.minimum(xp.maximum(cosine, COS_MIN), 1.0)


# Lower bound of the argument of a square root, the square of 1e-6 rad. It is below single precision, in which the
# smallest angle whose cosine differs from 1 has a sine of 3.5e-4.
_SQUARE_MIN = 1e-12
# Directions closer to the normal than this have no azimuth.
_SINE_MIN = 1e-5


def root(square: Array, xp: ArrayMath) -> Array:
    """Square root with a finite derivative everywhere.

    The derivative of sqrt is infinite at zero; multiplied by the zero derivative of a clipped argument it gives NaN.
    With the argument clipped the derivative is 0, the mean slope of the kink that |sin| has at zero.
    """
    return xp.sqrt(xp.maximum(square, _SQUARE_MIN))


def sine(cosine: Array, xp: ArrayMath) -> Array:
    """Sine, at least 1e-6, of an angle in [0, pi] given its cosine."""
    return root((1.0 - cosine) * (1.0 + cosine), xp)


def phase_angle(sum_squared: Array, difference_squared: Array, xp: ArrayMath) -> Array:
    """Phase angle, rad, from the squared norms of the sum and of the difference of two unit vectors.

    The vectors are the direction to the light and the *negative* direction to the viewer, so that the sum vanishes at
    opposition. Half angles keep their digits near 0 and pi, where arc cosines lose them.
    """
    # With unit vectors a and b, |a + b| = 2 sin(g/2) and |a - b| = 2 cos(g/2).
    return 2.0 * xp.atan2(root(sum_squared, xp), root(difference_squared, xp))


def phase_of_rays(sun: Array, directions: Array) -> Array:
    """Phase angles (N,), rad, of the unit direction to the Sun (3,) and unit rays (N, 3) from the viewer (NumPy)."""
    return phase_angle(((sun + directions) ** 2).sum(axis=1), ((sun - directions) ** 2).sum(axis=1), NUMPY)


def smaller_and_larger_angle(cos_i: Array, cos_e: Array, xp: ArrayMath) -> tuple[Array, Array]:
    """Cosines of the smaller and of the larger of two angles; equal angles give the mean of both derivatives.

    Formulas in these angles have a kink where they are equal; maximum and minimum would return the derivative of one.
    """
    # The smaller angle has the larger cosine.
    mean = 0.5 * (cos_i + cos_e)
    smaller = xp.where(cos_i > cos_e, cos_i, xp.where(cos_i < cos_e, cos_e, mean))
    return smaller, xp.where(cos_i > cos_e, cos_e, xp.where(cos_i < cos_e, cos_i, mean))


def azimuth_squares(cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> tuple[Array, Array]:
    """Return sin^2(psi / 2) and cos^2(psi / 2) of the azimuth psi between the planes of incidence and emission.

    They follow from the spherical law of haversines, ``sin^2(g/2) = sin^2((i - e)/2) + sin i sin e sin^2(psi/2)`` and
    ``cos^2(g/2) = cos^2((i + e)/2) + sin i sin e cos^2(psi/2)``. The smaller of the two squares is computed and the
    other is 1 minus it, which is accurate in single precision; the law of cosines is not. Where one of the directions
    is the normal, the azimuth is undefined and any value gives the same reflectance: 1/2 is returned for both.
    """
    sin_i, sin_e = sine(cos_i, xp), sine(cos_e, xp)
    i, e = xp.atan2(sin_i, cos_i), xp.atan2(sin_e, cos_e)
    defined, sines = xp.minimum(sin_i, sin_e) > _SINE_MIN, sin_i * sin_e
    sin_g, sin_apart = xp.sin(0.5 * phase_rad), xp.sin(0.5 * (i - e))
    cos_g, cos_mean = xp.cos(0.5 * phase_rad), xp.cos(0.5 * (i + e))
    # sin i sin e sin^2(psi/2) and sin i sin e cos^2(psi/2), by the two laws above.
    sine_square, cosine_square = sin_g * sin_g - sin_apart * sin_apart, cos_g * cos_g - cos_mean * cos_mean
    # Their sum is sin i sin e, so the smaller one is at most half of it; 1 minus a small number keeps its digits.
    near = sine_square < cosine_square
    smaller = xp.where(near, sine_square, cosine_square) / sines
    # Rounding can put the quotient outside [0, 1/2]. The sines are floored, so it is finite where it is discarded.
    smaller = xp.where(defined, xp.minimum(xp.maximum(smaller, 0.0), 0.5), 0.5)
    return xp.where(near, smaller, 1.0 - smaller), xp.where(near, 1.0 - smaller, smaller)
