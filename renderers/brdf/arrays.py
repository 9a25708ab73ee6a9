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


def cos_azimuth(cos_i: Array, cos_e: Array, cos_g: Array, xp: ArrayMath) -> Array:
    """Cosine of the azimuth between the planes of incidence and emission.

    It follows from the spherical law of cosines ``cos g = cos i cos e + sin i sin e cos psi``. Where one of
    the directions is the normal the azimuth is undefined; any value in [-1, 1] then gives the same reflectance.
    """
    sines = xp.maximum(sine(cos_i, xp) * sine(cos_e, xp), 1e-9)
    return xp.minimum(xp.maximum((cos_g - cos_i * cos_e) / sines, -1.0), 1.0)
