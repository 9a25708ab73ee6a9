"""Rough Lambertian V-cavities of M. Oren and S. K. Nayar, Generalization of Lambert's reflectance model, SIGGRAPH 1994.

The equations are those of section 4.4 of the paper (Gaussian slope distribution), divided by the irradiance
``E0 cos(theta_i)`` to turn the paper's radiance into a BRDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any, Literal

from boresight.renderers.brdf.arrays import (
    Array,
    ArrayMath,
    azimuth_squares,
    clipped_cosine,
    sine,
    smaller_and_larger_angle,
)


@dataclass(frozen=True, slots=True)
class OrenNayarParameters:
    """Parameters in the units of the formula; the numbers may be Dr.Jit values.

    ``albedo`` is the reflectance of a cavity's facets, rho in the paper, and ``sigma_rad`` the standard deviation of
    their slope angle. ``form`` chooses the full functional approximation with interreflection, or the qualitative one.
    """

    albedo: Array
    sigma_rad: Array
    form: Literal["full", "qualitative"] = "full"

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> OrenNayarParameters:
        """Convert the values of a scenario's ``brdf`` section, by key."""
        return cls(values["albedo"], values["sigma_deg"] * (pi / 180.0), values["form"])


def oren_nayar(p: OrenNayarParameters, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """Oren and Nayar's BRDF, 1/sr; the angles are given as in `brdf_value`.

    At slopes above about 45 deg the paper's fit becomes slightly negative for grazing forward scattering; it is
    clipped to 0 there. For an albedo of 1 the fit reflects up to 103 % of the light.
    """
    cos_i, cos_e = clipped_cosine(cos_i, xp), clipped_cosine(cos_e, xp)
    # The paper's alpha is the larger angle, whose cosine is the smaller one.
    cos_beta, cos_alpha = smaller_and_larger_angle(cos_i, cos_e, xp)
    model = _full if p.form == "full" else _qualitative
    return xp.maximum(model(p, cos_alpha, cos_beta, azimuth_squares(cos_i, cos_e, phase_rad, xp), xp), 0.0)


def _full(
    p: OrenNayarParameters, cos_alpha: Array, cos_beta: Array, azimuth: tuple[Array, Array], xp: ArrayMath
) -> Array:
    """Single scattering plus one interreflection; alpha is the larger of the two angles, beta the smaller.

    ``azimuth`` is sin^2 and cos^2 of half the azimuth phi.
    """
    cos_phi = azimuth[1] - azimuth[0]
    sin_alpha, sin_beta = sine(cos_alpha, xp), sine(cos_beta, xp)
    alpha, beta = xp.atan2(sin_alpha, cos_alpha), xp.atan2(sin_beta, cos_beta)
    s2 = p.sigma_rad * p.sigma_rad
    beta_cubed = (2.0 * beta / pi) * (2.0 * beta / pi) * (2.0 * beta / pi)
    product = 4.0 * alpha * beta / (pi * pi)
    # Coefficients C1, C2 and C3 of the functional approximation; C2 has another form for cos(phi) < 0.
    c1 = 1.0 - 0.5 * s2 / (s2 + 0.33)
    c2 = 0.45 * s2 / (s2 + 0.09) * (sin_alpha - xp.where(cos_phi >= 0.0, 0.0, beta_cubed))
    c3 = 0.125 * s2 / (s2 + 0.09) * product * product
    tan_mean = (sin_alpha + sin_beta) / (cos_alpha + cos_beta)  # tan((alpha + beta) / 2)
    # 1 - |cos phi| = 2 min(sin^2(phi/2), cos^2(phi/2)), without cancellation near phi = 0 and pi.
    first = c1 + cos_phi * c2 * sin_beta / cos_beta + 2.0 * xp.minimum(*azimuth) * c3 * tan_mean  # L_r^1
    second = 0.17 * s2 / (s2 + 0.13) * (1.0 - cos_phi * (2.0 * beta / pi) * (2.0 * beta / pi))  # L_r^2
    # Light reflected twice by facets is proportional to the square of the albedo.
    return p.albedo / pi * (first + p.albedo * second)


def _qualitative(
    p: OrenNayarParameters, cos_alpha: Array, cos_beta: Array, azimuth: tuple[Array, Array], xp: ArrayMath
) -> Array:
    """Evaluate the qualitative model: the paper's A and B, without C3 and interreflection."""
    s2 = p.sigma_rad * p.sigma_rad
    a = 1.0 - 0.5 * s2 / (s2 + 0.33)
    b = 0.45 * s2 / (s2 + 0.09)
    tan_beta = sine(cos_beta, xp) / cos_beta
    return p.albedo / pi * (a + b * xp.maximum(azimuth[1] - azimuth[0], 0.0) * sine(cos_alpha, xp) * tan_beta)
