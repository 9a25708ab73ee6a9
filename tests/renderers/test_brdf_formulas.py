"""The reflectance models of more than a line against their sources, worked again here in other ways."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from boresight.renderers.brdf import NUMPY, brdf_value
from boresight.renderers.brdf.laws import (
    h_function,
    hapke,
    henyey_greenstein,
    opposition_surge,
    oren_nayar,
)
from boresight.scenarios.spec.brdf import BrdfSpec, HapkeSpec, LambertSpec, OrenNayarSpec

HAPKES = [
    HapkeSpec(kind="hapke"),
    HapkeSpec(kind="hapke", theta_bar_deg=0.0),
    HapkeSpec(kind="hapke", theta_bar_deg=59.0, w=0.9, b=-0.8, c=0.3),
    HapkeSpec(kind="hapke", b=0.5, c=-1.0, B0=0.0, H_function="1981"),
]
MODELS: list[BrdfSpec] = [
    LambertSpec(albedo=0.7),
    OrenNayarSpec(kind="oren-nayar"),
    OrenNayarSpec(kind="oren-nayar", sigma_deg=60.0, albedo=0.9),
    OrenNayarSpec(kind="oren-nayar", sigma_deg=35.0, form="qualitative"),
    *HAPKES,
]
EXTREMES = [
    HapkeSpec(kind="hapke", b=1.0, w=0.999),
    HapkeSpec(kind="hapke", b=-1.0, c=-1.0),
    HapkeSpec(kind="hapke", h=1e-6, B0=50.0),
    OrenNayarSpec(kind="oren-nayar", sigma_deg=0.0, albedo=1.0),
]

angles = st.one_of(st.sampled_from([0.0, 1e-9, 1e-4, math.pi / 2 - 1e-9, math.pi / 2]), st.floats(0.0, math.pi / 2))
azimuths = st.one_of(st.sampled_from([0.0, 1e-7, math.pi / 2, math.pi]), st.floats(0.0, math.pi))


def phase(i: float, e: float, psi: float) -> float:
    cosine = math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(psi)
    return math.acos(max(-1.0, min(1.0, cosine)))


def value(spec: BrdfSpec, i: float, e: float, psi: float) -> float:
    return float(brdf_value(spec, np.cos(i), np.cos(e), np.array(phase(i, e, psi))))


def direction(polar: float, azimuth: float) -> np.ndarray:
    return np.array([math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)])


def hemispherical(spec: BrdfSpec, i: float) -> float:
    """Directional-hemispherical reflectance by Gauss-Legendre in cos(e) and the midpoint rule in azimuth."""
    nodes, weights = np.polynomial.legendre.leggauss(96)
    cos_e, psi = np.meshgrid(0.5 * (nodes + 1.0), (np.arange(180) + 0.5) / 180 * np.pi, indexing="ij")
    cos_g = math.cos(i) * cos_e + math.sin(i) * np.sqrt(1.0 - cos_e**2) * np.cos(psi)
    f = brdf_value(spec, np.full_like(cos_e, math.cos(i)), cos_e, np.arccos(np.clip(cos_g, -1.0, 1.0)))
    return float(np.sum(f * cos_e * 0.5 * weights[:, None]) * 2.0 * np.pi / 180)


@pytest.mark.parametrize("spec", [*MODELS, *EXTREMES], ids=repr)
@given(i=angles, e=angles, psi=azimuths)
def test_finite_never_negative_and_reciprocal(spec, i, e, psi):
    forward, backward = value(spec, i, e, psi), value(spec, e, i, psi)
    assert math.isfinite(forward)
    assert forward >= 0.0
    assert forward == pytest.approx(backward, rel=1e-9)


@pytest.mark.parametrize("spec", MODELS, ids=repr)
@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0, 80.0])
def test_reflects_no_more_than_it_receives(spec, incidence_deg):
    assert 0.0 < hemispherical(spec, math.radians(incidence_deg)) <= 1.0


def test_lambert_reflects_its_albedo():
    assert hemispherical(LambertSpec(albedo=0.42), 0.7) == pytest.approx(0.42, rel=1e-3)
    assert value(LambertSpec(albedo=0.42), 0.2, 0.3, 1.0) == 0.42 / math.pi


def oren_nayar_1994(rho: float, sigma: float, theta_i: float, theta_r: float, dphi: float) -> float:
    """The paper's L_r^1 + L_r^2 over E_0 cos(theta_i), in its own variables."""
    alpha, beta = max(theta_i, theta_r), min(theta_i, theta_r)
    s2 = sigma**2
    c1 = 1 - 0.5 * s2 / (s2 + 0.33)
    if math.cos(dphi) >= 0:
        c2 = 0.45 * s2 / (s2 + 0.09) * math.sin(alpha)
    else:
        c2 = 0.45 * s2 / (s2 + 0.09) * (math.sin(alpha) - (2 * beta / math.pi) ** 3)
    c3 = 0.125 * s2 / (s2 + 0.09) * (4 * alpha * beta / math.pi**2) ** 2
    bracket = c1 + math.cos(dphi) * c2 * math.tan(beta)
    bracket += (1 - abs(math.cos(dphi))) * c3 * math.tan((alpha + beta) / 2)
    second = 0.17 * rho**2 / math.pi * s2 / (s2 + 0.13) * (1 - math.cos(dphi) * (2 * beta / math.pi) ** 2)
    return rho / math.pi * bracket + second


@pytest.mark.parametrize("sigma_deg", [0.0, 5.0, 20.0, 40.0])
@given(i=st.floats(0.01, 1.57), e=st.floats(0.01, 1.57), psi=azimuths)
def test_oren_nayar_is_the_papers_full_model(sigma_deg, i, e, psi):
    spec = OrenNayarSpec(kind="oren-nayar", albedo=0.8, sigma_deg=sigma_deg)
    expected = oren_nayar_1994(0.8, math.radians(sigma_deg), i, e, psi)
    assert value(spec, i, e, psi) == pytest.approx(max(expected, 0.0), rel=1e-5, abs=1e-6)


def facet_integral(sigma: float, i: float, e: float, psi: float) -> float:
    """Single scattering of V-cavities with Gaussian slopes, integrated facet by facet (the paper's section 4.1)."""
    polar, azimuth = np.meshgrid((np.arange(200) + 0.5) / 200 * np.pi / 2, (np.arange(360) + 0.5) / 180 * np.pi)
    normal = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    s, v = direction(i, 0.0), direction(e, psi)
    s_a, v_a, a_n = normal @ s, normal @ v, np.cos(polar)
    seen = (s_a > 1e-12) & (v_a > 1e-12)
    s_a, v_a = np.where(seen, s_a, 1.0), np.where(seen, v_a, 1.0)
    attenuation = np.minimum(1.0, np.minimum(2.0 * s[2] * a_n / s_a, 2.0 * v[2] * a_n / v_a))
    radiance = np.where(seen, s_a * v_a * attenuation / (a_n * s[2] * v[2]) / np.pi, 0.0)
    weight = np.exp(-(polar**2) / (2.0 * sigma**2)) * np.sin(polar)
    return float((radiance * weight).sum() / weight.sum())


@pytest.mark.parametrize("sigma_deg", [10.0, 20.0, 30.0, 40.0])
@pytest.mark.parametrize(
    "geometry",
    [(0, 0, 0), (30, 30, 0), (30, 30, 180), (60, 30, 0), (60, 60, 0), (60, 60, 90), (60, 60, 180), (75, 45, 0)],
)
def test_oren_nayar_fits_the_integral_over_facets(sigma_deg, geometry):
    """The model is the authors' fit of this integral; it follows it within 7 %, Lambert only within a factor of 3."""
    i, e, psi = (math.radians(x) for x in geometry)
    vanishing = 1e-9  # without interreflection
    p = OrenNayarSpec(kind="oren-nayar", albedo=vanishing, sigma_deg=sigma_deg)
    single = float(oren_nayar(p, np.cos(i), np.cos(e), np.array(phase(i, e, psi)), NUMPY)) / vanishing
    assert single == pytest.approx(facet_integral(math.radians(sigma_deg), i, e, psi), rel=0.07)


def test_oren_nayar_qualitative_form_by_hand():
    """At sigma = 0.5 rad A = 1 - 0.125/0.58 and B = 0.1125/0.34; at i = e = 45 deg sin(alpha) tan(beta) = 1/sqrt(2)."""
    spec = OrenNayarSpec(kind="oren-nayar", albedo=0.3, sigma_deg=math.degrees(0.5), form="qualitative")
    expected = 0.3 / math.pi * (0.784482759 + 0.330882353 * 0.707106781)
    assert value(spec, math.pi / 4, math.pi / 4, 0.0) == pytest.approx(expected, rel=1e-8)
    assert value(spec, math.pi / 4, math.pi / 4, math.pi) == pytest.approx(0.3 / math.pi * 0.784482759, rel=1e-8)


def hapke_1984(p: HapkeSpec, i: float, e: float, psi: float) -> float:
    """r(i, e, g) S(i, e, psi) / cos i, with the two cases of the 1984 paper apart."""
    t = math.tan(math.radians(p.theta_bar_deg))
    chi = 1 / math.sqrt(1 + math.pi * t * t)

    def e1(x: float) -> float:
        return math.exp(-2 / math.pi / t / math.tan(x))

    def e2(x: float) -> float:
        return math.exp(-1 / math.pi / t**2 / math.tan(x) ** 2)

    def eta(x: float) -> float:
        return chi * (math.cos(x) + math.sin(x) * t * e2(x) / (2 - e1(x)))

    half = math.sin(psi / 2) ** 2
    f = math.exp(-2 * math.tan(psi / 2)) if psi < math.pi else 0.0
    if i <= e:
        d = 2 - e1(e) - psi / math.pi * e1(i)
        mu0e = chi * (math.cos(i) + math.sin(i) * t * (math.cos(psi) * e2(e) + half * e2(i)) / d)
        mue = chi * (math.cos(e) + math.sin(e) * t * (e2(e) - half * e2(i)) / d)
        s = mue / eta(e) * math.cos(i) / eta(i) * chi / (1 - f + f * chi * math.cos(i) / eta(i))
    else:
        d = 2 - e1(i) - psi / math.pi * e1(e)
        mu0e = chi * (math.cos(i) + math.sin(i) * t * (e2(i) - half * e2(e)) / d)
        mue = chi * (math.cos(e) + math.sin(e) * t * (math.cos(psi) * e2(i) + half * e2(e)) / d)
        s = mue / eta(e) * math.cos(i) / eta(i) * chi / (1 - f + f * chi * math.cos(e) / eta(e))
    return smooth_hapke(p, mu0e, mue, phase(i, e, psi)) * s / math.cos(i)


def smooth_hapke(p: HapkeSpec, mu0: float, mu: float, g: float) -> float:
    """r(i, e, g) of a smooth surface."""
    gamma = math.sqrt(1 - p.w)

    def big_h(x: float) -> float:
        if p.H_function == "1981":
            return (1 + 2 * x) / (1 + 2 * x * gamma)
        r0 = (1 - gamma) / (1 + gamma)
        return 1 / (1 - p.w * x * (r0 + (1 - 2 * r0 * x) / 2 * math.log((1 + x) / x)))

    surge = p.B0 / (1 + math.tan(g / 2) / p.h)
    lobes = (1 + p.c) / 2 * (1 - p.b**2) / (1 - 2 * p.b * math.cos(g) + p.b**2) ** 1.5
    lobes += (1 - p.c) / 2 * (1 - p.b**2) / (1 + 2 * p.b * math.cos(g) + p.b**2) ** 1.5
    return p.w / (4 * math.pi) * mu0 / (mu0 + mu) * ((1 + surge) * lobes + big_h(mu0) * big_h(mu) - 1)


@pytest.mark.parametrize("spec", [spec for spec in HAPKES if spec.theta_bar_deg > 0], ids=repr)
@given(i=st.floats(0.01, 1.57), e=st.floats(0.01, 1.57), psi=st.floats(0.001, 3.1))
def test_hapke_is_the_papers_two_cases(spec, i, e, psi):
    expected = hapke_1984(spec, i, e, psi)
    assert value(spec, i, e, psi) == pytest.approx(expected, rel=2e-6)


@pytest.mark.parametrize(
    ("spec", "zenith", "oblique"),
    [
        (
            HapkeSpec(kind="hapke", w=0.5, b=0.0, c=0.0, B0=0.0, theta_bar_deg=0.0, H_function="1981"),
            0.0965097,
            0.0832883,
        ),
        (
            HapkeSpec(kind="hapke", w=0.52, b=0.0, c=0.0, B0=1.0, h=1.0, theta_bar_deg=30.0, H_function="1981"),
            0.16145,
            0.111525,
        ),
        (
            HapkeSpec(kind="hapke", w=0.52, b=0.213, c=1.0, B0=1.0, h=1.0, theta_bar_deg=30.0, H_function="1981"),
            0.286048,
            0.1342,
        ),
    ],
    ids=["smooth", "rough", "rough-backward"],
)
def test_hapke_gives_the_radiance_factors_that_isis_publishes(spec, zenith, oblique):
    """Six digits from the unit test of the photometric model Hapke of USGS ISIS (Hapke.truth, CC0-1.0).

    Its cases are g = i = e = 0, and g = 60, i = 45, e = 30 deg; its weight Hg2 = 1 of the backward lobe is c = 1.
    """
    for (g, i, e), expected in (((0, 0, 0), zenith), ((60, 45, 30), oblique)):
        cos_i, cos_e = math.cos(math.radians(i)), math.cos(math.radians(e))
        f = float(brdf_value(spec, np.array(cos_i), np.array(cos_e), np.array(math.radians(g))))
        assert math.pi * f * cos_i == pytest.approx(expected, rel=5e-6)


@pytest.mark.parametrize("H_function", ["2002", "1981"])
@given(i=st.floats(0.0, 1.57), e=st.floats(0.0, 1.57), psi=st.floats(0.0, 3.1))
def test_hapke_without_roughness_is_the_smooth_model(H_function, i, e, psi):
    spec = HapkeSpec(kind="hapke", theta_bar_deg=0.0, H_function=H_function)
    expected = smooth_hapke(spec, math.cos(i), math.cos(e), phase(i, e, psi)) / math.cos(i)
    assert value(spec, i, e, psi) == pytest.approx(expected, rel=2e-4)


def chandrasekhar(w: float, x: np.ndarray) -> np.ndarray:
    """H by iterating its integral equation 1/H(x) = sqrt(1-w) + w/2 int_0^1 y H(y) / (x + y) dy."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    y, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    values = np.ones_like(y)
    for _ in range(300):
        values = 1.0 / (math.sqrt(1 - w) + 0.5 * w * (weights * y * values / (y[:, None] + y)).sum(axis=1))
    return 1.0 / (math.sqrt(1 - w) + 0.5 * w * (weights * y * values / (x[:, None] + y)).sum(axis=1))


@pytest.mark.parametrize(("kind", "tolerance"), [("2002", 0.01), ("1981", 0.045)])
@pytest.mark.parametrize("w", [0.2, 0.42, 0.8, 0.95])
def test_h_function_follows_the_exact_one(kind, tolerance, w):
    x = np.linspace(0.02, 1.0, 30)
    p = HapkeSpec(kind="hapke", w=w, H_function=kind)
    np.testing.assert_allclose(h_function(p, x, NUMPY), chandrasekhar(w, x), rtol=tolerance)


@pytest.mark.parametrize(("b", "c"), [(0.35, 1.0), (-0.5, 0.2), (0.7, -1.0), (0.0, 0.0)])
def test_phase_function_is_normalised(b, c):
    mean, _ = quad(lambda g: 0.5 * math.sin(g) * float(henyey_greenstein(b, c, math.cos(g), NUMPY)), 0.0, math.pi)
    assert mean == pytest.approx(1.0, rel=1e-9)


def test_c_of_one_is_all_backward():
    """Backward means towards the light: phase angle 0. P(0) = (1 - b^2) / (1 - b)^3 by hand."""
    assert float(henyey_greenstein(0.4, 1.0, 1.0, NUMPY)) == pytest.approx(0.84 / 0.6**3)
    assert float(henyey_greenstein(0.4, 1.0, -1.0, NUMPY)) == pytest.approx(0.84 / 1.4**3)


def test_opposition_surge_by_hand():
    p = HapkeSpec(kind="hapke", B0=0.8, h=0.05)
    assert float(opposition_surge(p, 0.0, NUMPY)) == pytest.approx(0.8)
    assert float(opposition_surge(p, 2.0 * math.atan(0.05), NUMPY)) == pytest.approx(0.4)
    assert float(opposition_surge(p, math.pi, NUMPY)) == pytest.approx(0.0, abs=1e-15)


def test_roughness_darkens_grazing_light_and_keeps_the_zenith():
    """At i = e = 0 the 1984 correction leaves the reflectance as it is, up to the tilt of the effective cosines."""
    p = HapkeSpec(kind="hapke", w=0.3, b=0.3, B0=0.5, h=0.05, theta_bar_deg=30.0)
    smooth = HapkeSpec(kind="hapke", w=0.3, b=0.3, B0=0.5, h=0.05, theta_bar_deg=0.0)
    grazing = (math.cos(1.4), math.cos(1.3), np.array(2.7))
    assert float(hapke(p, *grazing, NUMPY)) < 0.5 * float(hapke(smooth, *grazing, NUMPY))
    chi = 1.0 / math.sqrt(1.0 + math.pi * math.tan(math.radians(30.0)) ** 2)
    zenith = smooth_hapke(p, chi, chi, 0.0)  # S is 1 there, and the effective cosines are chi
    assert float(hapke(p, 1.0, 1.0, np.array(0.0), NUMPY)) == pytest.approx(zenith, rel=1e-6)
