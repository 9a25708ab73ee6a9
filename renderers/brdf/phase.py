"""Phase functions of single particles."""

from __future__ import annotations

from renderers.brdf.arrays import Array, ArrayMath

_TINY = 1e-12


def henyey_greenstein(b: Array, c: Array, cos_g: Array, xp: ArrayMath) -> Array:
    """Two-lobe Henyey-Greenstein function of the phase angle g; its mean over the sphere is 1.

    Parameters
    ----------
    b, c
        Asymmetry of the two lobes and their balance: c = 1 is all backward (towards the light), c = -1 all forward;
        b = 0 is isotropic.
    cos_g
        Cosine of the phase angle.
    xp
        The array library of the angles.
    """
    one, square = 1.0 - b * b, 1.0 + b * b
    back = xp.maximum(square - 2.0 * b * cos_g, _TINY)
    forth = xp.maximum(square + 2.0 * b * cos_g, _TINY)
    return 0.5 * one * ((1.0 + c) / (back * xp.sqrt(back)) + (1.0 - c) / (forth * xp.sqrt(forth)))
