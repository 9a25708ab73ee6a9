"""The few array functions that a reflectance formula needs, from whichever array library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# A NumPy array or number, or a Dr.Jit array: neither library knows a type that covers both.
Array = Any


@dataclass(frozen=True, slots=True)
class ArrayMath:
    """Elementwise functions of one array library, by name."""

    sqrt: Callable[[Array], Array]
    exp: Callable[[Array], Array]
    log: Callable[[Array], Array]
    sin: Callable[[Array], Array]
    cos: Callable[[Array], Array]
    acos: Callable[[Array], Array]
    maximum: Callable[[Array, Array], Array]
    minimum: Callable[[Array, Array], Array]
    where: Callable[[Array, Array, Array], Array]


NUMPY = ArrayMath(
    sqrt=np.sqrt,
    exp=np.exp,
    log=np.log,
    sin=np.sin,
    cos=np.cos,
    acos=np.arccos,
    maximum=np.maximum,
    minimum=np.minimum,
    where=np.where,
)

# Cosines of incidence and emission are kept above this, so that every formula stays finite at grazing angles.
# It is half a hundredth of a degree from the horizon.
COS_MIN = 1e-4


def grazing_safe(cosine: Array, xp: ArrayMath) -> Array:
    """Clip a cosine of incidence or emission to [COS_MIN, 1]."""
    return xp.minimum(xp.maximum(cosine, COS_MIN), 1.0)


def sine(cosine: Array, xp: ArrayMath) -> Array:
    """Sine of an angle in [0, pi] from its cosine."""
    return xp.sqrt(xp.maximum(1.0 - cosine * cosine, 0.0))


def azimuth_haversine(cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """sin^2(psi / 2) of the azimuth psi between the planes of incidence and emission.

    It follows from the spherical law of haversines ``hav g = hav(i - e) + sin i sin e hav psi``, which keeps its
    digits in single precision towards opposition, where the law of cosines loses them. Where one of the
    directions is the normal the azimuth is undefined; any value in [0, 1] then gives the same reflectance.
    """
    half_g, half_difference = xp.sin(0.5 * phase_rad), xp.sin(0.5 * (xp.acos(cos_i) - xp.acos(cos_e)))
    sines = xp.maximum(sine(cos_i, xp) * sine(cos_e, xp), 1e-9)
    return xp.minimum(xp.maximum((half_g * half_g - half_difference * half_difference) / sines, 0.0), 1.0)
