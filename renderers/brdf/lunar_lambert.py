"""Laws of Lambert, of Lommel and Seeliger, and their combination by McEwen (lunar-Lambert).

Sources: H. von Seeliger, Zur Theorie der Beleuchtung der grossen Planeten (1887), in the notation of B. Hapke, Theory
of reflectance and emittance spectroscopy (2nd ed. 2012); A. S. McEwen, Photometric functions for photoclinometry and
other applications (Icarus 92, 1991), and A precise lunar photometric function (27th Lunar and Planetary Science
Conference, 1996), whose weight for the Moon is the default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

from boresight.renderers.brdf.arrays import Array, ArrayMath, clipped_cosine

# Lower bound of 1 + b^2 -+ 2 b cos g, which is 0 at |b| = 1 in the centre of a lobe.
_TINY = 1e-12


def henyey_greenstein(b: Array, c: Array, cos_g: Array, xp: ArrayMath) -> Array:
    """Two-lobe Henyey-Greenstein phase function of single particles; its mean over the sphere is 1.

    ``b`` is the asymmetry of the two lobes, 0 if isotropic; ``c`` is their balance: 1 is all backward (towards the
    light), -1 all forward. ``cos_g`` is the cosine of the phase angle.
    """
    one, square = 1.0 - b * b, 1.0 + b * b
    # P = (1 - b^2) [(1 + c) / 2 (1 - 2 b cos g + b^2)^-3/2 + (1 - c) / 2 (1 + 2 b cos g + b^2)^-3/2]: g = 0 is
    # backward.
    back = xp.maximum(square - 2.0 * b * cos_g, _TINY)
    forth = xp.maximum(square + 2.0 * b * cos_g, _TINY)
    return 0.5 * one * ((1.0 + c) / (back * xp.sqrt(back)) + (1.0 - c) / (forth * xp.sqrt(forth)))


def lambert(albedo: Array) -> Array:
    """Lambert's BRDF, 1/sr, for a hemispherical albedo: constant over all directions."""
    return albedo / pi


@dataclass(frozen=True, slots=True)
class LommelSeeligerParameters:
    """Parameters of the formula; the numbers may be Dr.Jit values.

    ``w`` is the single scattering albedo of the particles, not the reflectance of the surface. ``b`` and ``c`` are the
    lobes of the particles' phase function P (`henyey_greenstein`).
    """

    w: Array
    b: Array
    c: Array

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> LommelSeeligerParameters:
        """Convert the values of a scenario's ``brdf`` section, by key."""
        return cls(values["w"], values["b"], values["c"])


def lommel_seeliger(p: LommelSeeligerParameters, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """Lommel and Seeliger's BRDF, 1/sr: ``I/F = w/4 P(g) mu0 / (mu0 + mu)``, divided by pi mu0.

    The angles are given as in `brdf_value`. Single scattering in a dark medium: light is attenuated by exp(-tau / mu0)
    down to the optical depth tau and by exp(-tau / mu) on its way up, which integrates to
    ``w/4 P(g) int_0^inf exp(-tau (1/mu0 + 1/mu)) dtau / mu``.
    At normal incidence and emission I/F = w/8 P(0), which is also the geometric albedo of a sphere, whose disc at
    opposition is uniform. Isotropic particles reflect ``w/2 (1 - mu0 ln((1 + mu0) / mu0))`` into the hemisphere.
    """
    # The radiance factor is pi f_r mu0, so that f_r = w / (4 pi) P(g) / (mu0 + mu).
    scattered = p.w / (4.0 * pi) * henyey_greenstein(p.b, p.c, xp.cos(phase_rad), xp)
    return scattered / (clipped_cosine(cos_i, xp) + clipped_cosine(cos_e, xp))


@dataclass(frozen=True, slots=True)
class McEwenParameters:
    """Parameters of the formula; the numbers may be Dr.Jit values.

    ``albedo`` is the radiance factor A at normal incidence and emission. The others are the coefficients of the weight
    of the lunar part, ``L = 1 + L1 g + L2 g^2 + L3 g^3`` with g in degrees.
    """

    albedo: Array
    L1_per_deg: Array
    L2_per_deg2: Array
    L3_per_deg3: Array

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> McEwenParameters:
        """Convert the values of a scenario's ``brdf`` section, by key."""
        return cls(values["albedo"], values["L1_per_deg"], values["L2_per_deg2"], values["L3_per_deg3"])


def mcewen(p: McEwenParameters, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """McEwen's BRDF, 1/sr: ``I/F = A [2 L mu0 / (mu0 + mu) + (1 - L) mu0]``, divided by pi mu0.

    The angles are given as in `brdf_value`. The factor 2 makes A the radiance factor at mu0 = mu = 1 for every weight
    L: there ``mu0 / (mu0 + mu)`` is 1/2 and ``mu0`` is 1, so that ``A [2 L / 2 + (1 - L)] = A``. For L = 0 the law is
    Lambert's.

    A is not the hemispherical albedo: with the Moon's weight the hemisphere receives 1.09 A at normal incidence and
    1.67 A at an incidence of 89.5 deg. Energy is conserved up to A of about 0.59.
    """
    weight = lunar_weight(p, phase_rad, xp)
    # mu0 cancels in f_r, so that the law is reciprocal although the radiance factor is not.
    lunar = 2.0 / (clipped_cosine(cos_i, xp) + clipped_cosine(cos_e, xp))
    return p.albedo / pi * (weight * lunar + (1.0 - weight))


def lunar_weight(p: McEwenParameters, phase_rad: Array, xp: ArrayMath) -> Array:
    """Weight L(g) of the lunar part, clipped to [0, 1]: the Moon's polynomial is negative beyond 104 deg."""
    g = phase_rad * (180.0 / pi)  # the published coefficients are per degree
    polynomial = 1.0 + g * (p.L1_per_deg + g * (p.L2_per_deg2 + g * p.L3_per_deg3))
    return xp.minimum(xp.maximum(polynomial, 0.0), 1.0)
