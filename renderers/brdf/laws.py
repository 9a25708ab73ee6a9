"""Laws of reflectance: Lambert, Lommel and Seeliger, McEwen (lunar-Lambert), Oren and Nayar, and Hapke.

Sources:

- H. von Seeliger, Zur Theorie der Beleuchtung der grossen Planeten (1887), in the notation of Hapke's book.
- A. S. McEwen, Photometric functions for photoclinometry and other applications (Icarus 92, 1991), and A precise lunar
  photometric function (27th Lunar and Planetary Science Conference, 1996), whose weight for the Moon is the default.
- M. Oren and S. K. Nayar, Generalization of Lambert's reflectance model, SIGGRAPH 1994, section 4.4 (Gaussian slope
  distribution), divided by the irradiance ``E0 cos(theta_i)`` to turn the paper's radiance into a BRDF.
- B. Hapke, Bidirectional reflectance spectroscopy 1 (JGR 86, 1981: H function), 3 (Icarus 59, 1984: macroscopic
  roughness), 4 (Icarus 67, 1986: opposition effect) and 5 (Icarus 157, 2002: better H function). Equation numbers in
  the code are those of his book, Theory of reflectance and emittance spectroscopy (2nd ed. 2012). Coherent backscatter
  and the porosity factor of that edition are left out.
"""

from __future__ import annotations

from math import pi
from typing import Any

from boresight.renderers.brdf.arrays import (
    Array,
    ArrayMath,
    azimuth_squares,
    clipped_cosine,
    root,
    sine,
    smaller_and_larger_angle,
)

Section = Any
"""The values of a ``brdf`` section by name, as in its model (`HapkeSpec`); numbers may be Dr.Jit values."""

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


def lommel_seeliger(p: Section, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
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


def mcewen(p: Section, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
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


def lunar_weight(p: Section, phase_rad: Array, xp: ArrayMath) -> Array:
    """Weight L(g) of the lunar part, clipped to [0, 1]: the Moon's polynomial is negative beyond 104 deg."""
    g = phase_rad * (180.0 / pi)  # the published coefficients are per degree
    polynomial = 1.0 + g * (p.L1_per_deg + g * (p.L2_per_deg2 + g * p.L3_per_deg3))
    return xp.minimum(xp.maximum(polynomial, 0.0), 1.0)


def oren_nayar(p: Section, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """Oren and Nayar's BRDF of rough Lambertian V-cavities, 1/sr; the angles are given as in `brdf_value`.

    At slopes above about 45 deg the paper's fit becomes slightly negative for grazing forward scattering; it is
    clipped to 0 there. For an albedo of 1 the fit reflects up to 103 % of the light.
    """
    cos_i, cos_e = clipped_cosine(cos_i, xp), clipped_cosine(cos_e, xp)
    # The paper's alpha is the larger angle, whose cosine is the smaller one.
    cos_beta, cos_alpha = smaller_and_larger_angle(cos_i, cos_e, xp)
    model = _oren_nayar_full if p.form == "full" else _oren_nayar_qualitative
    return xp.maximum(model(p, cos_alpha, cos_beta, azimuth_squares(cos_i, cos_e, phase_rad, xp), xp), 0.0)


def _oren_nayar_full(
    p: Section, cos_alpha: Array, cos_beta: Array, azimuth: tuple[Array, Array], xp: ArrayMath
) -> Array:
    """Single scattering plus one interreflection; alpha is the larger of the two angles, beta the smaller.

    ``azimuth`` is sin^2 and cos^2 of half the azimuth phi.
    """
    cos_phi = azimuth[1] - azimuth[0]
    sin_alpha, sin_beta = sine(cos_alpha, xp), sine(cos_beta, xp)
    alpha, beta = xp.atan2(sin_alpha, cos_alpha), xp.atan2(sin_beta, cos_beta)
    sigma_rad = p.sigma_deg * (pi / 180.0)
    s2 = sigma_rad * sigma_rad
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


def _oren_nayar_qualitative(
    p: Section, cos_alpha: Array, cos_beta: Array, azimuth: tuple[Array, Array], xp: ArrayMath
) -> Array:
    """Evaluate the qualitative model: the paper's A and B, without C3 and interreflection."""
    sigma_rad = p.sigma_deg * (pi / 180.0)
    s2 = sigma_rad * sigma_rad
    a = 1.0 - 0.5 * s2 / (s2 + 0.33)
    b = 0.45 * s2 / (s2 + 0.09)
    tan_beta = sine(cos_beta, xp) / cos_beta
    return p.albedo / pi * (a + b * xp.maximum(azimuth[1] - azimuth[0], 0.0) * sine(cos_alpha, xp) * tan_beta)


def hapke(p: Section, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    """Hapke's BRDF, 1/sr: the bidirectional reflectance r divided by the cosine of incidence.

    The angles are given as in `brdf_value`; ``phase_rad`` is the paper's g. The two cases of the roughness correction
    (i <= e and e <= i) become one when written in the smaller angle a and the larger angle b, and the cosine of
    incidence cancels, so that the function is reciprocal by construction. The opposition surge violates energy
    conservation: with w near 1 and B0 = 1 up to 106 % of the light is reflected.
    """
    cos_i, cos_e = clipped_cosine(cos_i, xp), clipped_cosine(cos_e, xp)
    cos_a, cos_b = smaller_and_larger_angle(cos_i, cos_e, xp)
    azimuth = azimuth_squares(cos_i, cos_e, phase_rad, xp)
    # Roughness enters as effective cosines, at which the formula of the smooth surface is evaluated, and as the factor
    # S. eq. (12.55)
    mu_a, mu_b, shadowing = _rough_surface(p.theta_bar_deg * (pi / 180.0), cos_a, cos_b, azimuth, xp)
    single = (1.0 + opposition_surge(p, phase_rad, xp)) * henyey_greenstein(p.b, p.c, xp.cos(phase_rad), xp)
    # Multiple scattering as if isotropic: H H - 1, without the light that is scattered once.
    multiple = h_function(p, mu_a, xp) * h_function(p, mu_b, xp) - 1.0
    # The numerator mu_0e of r is in `shadowing`, with the 1 / cos i that makes a BRDF of r.
    return p.w / (4.0 * pi) / (mu_a + mu_b) * (single + multiple) * shadowing


def opposition_surge(p: Section, phase_rad: Array, xp: ArrayMath) -> Array:
    """Opposition surge B(g) = B0 / (1 + tan(g/2) / h), written without the pole of the tangent at g = pi."""
    # eq. (9.22) times cos(g/2) above and below; at g = pi rounding can make that cosine negative.
    cosine = xp.maximum(xp.cos(0.5 * phase_rad), 0.0)
    return p.B0 * p.h * cosine / (p.h * cosine + xp.sin(0.5 * phase_rad))


def h_function(p: Section, x: Array, xp: ArrayMath) -> Array:
    """Chandrasekhar's H function for isotropic scatterers, in Hapke's approximation of 2002 or 1981.

    Up to w = 0.95 the former is within 1 % of the exact function and the latter within 4.5 %.
    """
    gamma = xp.sqrt(1.0 - p.w)  # albedo factor
    if p.H_function == "1981":
        return (1.0 + 2.0 * x) / (1.0 + 2.0 * x * gamma)
    r0 = (1.0 - gamma) / (1.0 + gamma)  # diffusive reflectance
    return 1.0 / (1.0 - p.w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * xp.log((1.0 + x) / x)))


def _rough_surface(
    theta_bar_rad: Array, cos_a: Array, cos_b: Array, azimuth: tuple[Array, Array], xp: ArrayMath
) -> tuple[Array, Array, Array]:
    """Effective cosines of the angles a <= b, and the shadowing S mu_a mu_b / (mu_a0 mu_b0) of the BRDF.

    ``azimuth`` is sin^2 and cos^2 of half the azimuth psi. The tangent of the mean slope is at least 1e-5, so that its
    cotangent stays finite for a smooth surface.

    The book has one set of equations for i <= e, (12.46) to (12.50), and another for e <= i, (12.52) to (12.54). The
    second is the first with the angles exchanged.
    """
    tan_t = xp.maximum(xp.sin(theta_bar_rad) / xp.cos(theta_bar_rad), 1e-5)
    chi = 1.0 / xp.sqrt(1.0 + pi * tan_t * tan_t)  # eq. (12.45a)
    sin_a, sin_b = sine(cos_a, xp), sine(cos_b, xp)
    e1_a, e2_a = _roughness_exponentials(cos_a, sin_a, tan_t, xp)
    e1_b, e2_b = _roughness_exponentials(cos_b, sin_b, tan_t, xp)
    half, cos_psi = azimuth[0], azimuth[1] - azimuth[0]
    sin_half_psi, cos_half_psi = root(azimuth[0], xp), root(azimuth[1], xp)
    psi = 2.0 * xp.atan2(sin_half_psi, cos_half_psi)
    tilt = tan_t / (2.0 - e1_b - psi / pi * e1_a)  # denominator of eqs. (12.46), (12.47)
    mu_a = chi * (cos_a + sin_a * tilt * (cos_psi * e2_b + half * e2_a))  # eq. (12.46)
    mu_b = chi * (cos_b + sin_b * tilt * (e2_b - half * e2_a))  # eq. (12.47)
    # The effective cosines without the other direction: eqs. (12.48), (12.49).
    mu_a0 = chi * (cos_a + sin_a * tan_t * e2_a / (2.0 - e1_a))
    mu_b0 = chi * (cos_b + sin_b * tan_t * e2_b / (2.0 - e1_b))
    # A guard alone: with cosines of at least COS_MIN neither comes near the floor.
    mu_a, mu_b = xp.maximum(mu_a, 1e-6), xp.maximum(mu_b, 1e-6)
    # f(psi) = exp(-2 tan(psi/2)) is the share of the ground in shadow that is hidden from the viewer too. At psi = pi
    # the floored cosine makes it exp(-2e6) = 0.
    f = xp.exp(-2.0 * sin_half_psi / cos_half_psi)
    visible = chi / (1.0 - f + f * chi * cos_a / mu_a0)  # last factor of eq. (12.50)
    # S = (mu_e / mu_e0) (cos i / mu_0e0) chi / (...), times mu_0e / cos i: symmetric in the two angles.
    return mu_a, mu_b, mu_a / mu_a0 * mu_b / mu_b0 * visible


def _roughness_exponentials(cosine: Array, sin: Array, tan_t: Array, xp: ArrayMath) -> tuple[Array, Array]:
    """E1 and E2 of Hapke (1984) for one angle."""
    k = cosine / (sin * tan_t)  # cot(theta_bar) cot(x)
    return xp.exp(-2.0 / pi * k), xp.exp(-1.0 / pi * k * k)  # eqs. (12.45b), (12.45c)
