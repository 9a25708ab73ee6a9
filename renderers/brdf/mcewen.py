"""The lunar-Lambert law with a weight that depends on the phase angle.

Sources: A. S. McEwen, Photometric functions for photoclinometry and other applications (Icarus 92, 1991), and A precise
lunar photometric function (27th Lunar and Planetary Science Conference, 1996), whose weight for the Moon
is the default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

from renderers.brdf.arrays import Array, ArrayMath, grazing_safe


@dataclass(frozen=True, slots=True)
class McEwenParameters:
    """Parameters as the formula takes them; the numbers may be Dr.Jit values.

    Parameters
    ----------
    albedo
        A: the radiance factor at normal incidence and emission.
    L1_per_deg, L2_per_deg2, L3_per_deg3
        Coefficients of the weight of the lunar part, ``L = 1 + L1 g + L2 g^2 + L3 g^3`` with g in degrees.
    """

    albedo: Array
    L1_per_deg: Array
    L2_per_deg2: Array
    L3_per_deg3: Array

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> McEwenParameters:
        """From the values of a scenario's section, by key."""
        return cls(values["albedo"], values["L1_per_deg"], values["L2_per_deg2"], values["L3_per_deg3"])


def mcewen(p: McEwenParameters, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """McEwen's BRDF, 1/sr: ``I/F = A [2 L mu0 / (mu0 + mu) + (1 - L) mu0]``, divided by pi mu0.

    The factor 2 follows from what A means. At mu0 = mu = 1 Lommel and Seeliger's ``mu0 / (mu0 + mu)`` is 1/2 and
    Lambert's ``mu0`` is 1; A is the radiance factor there whatever L is only if the first is doubled:
    ``A [2 L / 2 + (1 - L)] = A``. Without it a change of L, and so of the phase angle, would change the reflectance
    of a surface that is lit and seen from the zenith. For L = 0 the law is Lambert's.

    The lunar part sends light to grazing directions, so that A is no hemispherical albedo: with the Moon's weight the
    hemisphere receives 1.09 A from normal incidence and 1.67 A from 89.5 deg. A conserves energy up to about 0.59.

    Parameters
    ----------
    p
        Albedo and coefficients of the weight.
    cos_i, cos_e
        Cosines of the angles of incidence (mu0) and emission (mu) from the normal.
    phase_rad
        Angle between the direction to the light and the direction to the viewer, 0 to pi.
    xp
        The array library of the angles.
    """
    weight = lunar_weight(p, phase_rad, xp)
    lunar = 2.0 / (grazing_safe(cos_i, xp) + grazing_safe(cos_e, xp))
    return p.albedo / pi * (weight * lunar + (1.0 - weight))


def lunar_weight(p: McEwenParameters, phase_rad: Array, xp: ArrayMath) -> Array:
    """L(g), clipped to [0, 1]: the Moon's polynomial is negative from 104 deg on."""
    g = phase_rad * (180.0 / pi)
    polynomial = 1.0 + g * (p.L1_per_deg + g * (p.L2_per_deg2 + g * p.L3_per_deg3))
    return xp.minimum(xp.maximum(polynomial, 0.0), 1.0)
