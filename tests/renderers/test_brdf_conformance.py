"""One suite for every reflectance model of the table: a new one is in it as soon as it is in the table.

Each model must bring sums of its own in `HAND` and `GEOMETRIC`: `test_every_model_is_worked_by_hand` asks for them.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from boresight.renderers.brdf import MODELS, brdf_value
from boresight.renderers.mitsuba3 import MitsubaRenderer, register_bsdfs
from boresight.renderers.mitsuba3.wavefront import drjit_math
from boresight.scenarios.bodies.embedded import icosphere
from boresight.scenarios.geometry import Camera, View, look_at
from boresight.scenarios.spec.brdf import (
    BrdfSpec,
    HapkeSpec,
    LambertSpec,
    LommelSeeligerSpec,
    McEwenSpec,
    OrenNayarSpec,
)

DEFAULTS: list[BrdfSpec] = [model.spec.model_validate({"kind": kind}) for kind, model in MODELS.items()]
OTHERS: list[BrdfSpec] = [
    LambertSpec(albedo=1.0),
    OrenNayarSpec(kind="oren-nayar", sigma_deg=60.0, albedo=0.9),
    OrenNayarSpec(kind="oren-nayar", sigma_deg=35.0, form="qualitative"),
    HapkeSpec(kind="hapke", theta_bar_deg=0.0, w=0.9, b=-0.4, c=0.3),
    HapkeSpec(kind="hapke", theta_bar_deg=59.0, w=0.9, b=-0.8, c=0.3),
    HapkeSpec(kind="hapke", theta_bar_deg=55.0, b=0.5, c=-1.0, B0=0.0, H_function="1981"),
    LommelSeeligerSpec(kind="lommel-seeliger", w=1.0),
    LommelSeeligerSpec(kind="lommel-seeliger", w=1.0, b=0.6, c=0.4),
    McEwenSpec(kind="mcewen", albedo=0.59),
    McEwenSpec(kind="mcewen", albedo=0.2, L1_per_deg=0.0, L2_per_deg2=0.0, L3_per_deg3=0.0),
    McEwenSpec(kind="mcewen", albedo=1.0, L1_per_deg=-1000.0),
]
ALL = [*DEFAULTS, *OTHERS]
EXTREMES: list[BrdfSpec] = [
    HapkeSpec(kind="hapke", b=1.0, w=0.999),
    HapkeSpec(kind="hapke", b=-1.0, c=-1.0),
    HapkeSpec(kind="hapke", h=1e-6, B0=50.0),
    OrenNayarSpec(kind="oren-nayar", sigma_deg=0.0, albedo=1.0),
]
angles = st.one_of(st.sampled_from([0.0, 1e-9, 1e-4, math.pi / 2 - 1e-9, math.pi / 2]), st.floats(0.0, math.pi / 2))
azimuths = st.one_of(st.sampled_from([0.0, 1e-7, math.pi / 2, math.pi]), st.floats(0.0, math.pi))
every_model = pytest.mark.parametrize("spec", ALL, ids=repr)


@dataclass(frozen=True)
class Hand:
    """A radiance factor worked out on paper at incidence i, emission e and phase angle g, in degrees."""

    spec: BrdfSpec
    i: float
    e: float
    g: float
    expected: float


# Lunar weight of McEwen at 60 deg: 1 - 1.14 + 0.8712 - 0.31536 = 0.41584; at 90 deg:
# 1 - 1.71 + 1.9602 - 1.06434 = 0.18586.
# Hapke with theta_bar = 0, B0 = 0, b = 0 and H = (1 + 2x)/(1 + 2 x gamma), w = 0.75, gamma = 1/2: H(1) = 3/2,
# H(1/2) = 4/3, and I/F = w/4 mu0/(mu0+mu) H(mu0) H(mu).
_PLAIN_HAPKE = HapkeSpec(kind="hapke", w=0.75, b=0.0, c=0.0, B0=0.0, theta_bar_deg=0.0, H_function="1981")
_FLAT_OREN_NAYAR = OrenNayarSpec(kind="oren-nayar", albedo=0.4, sigma_deg=0.0)
_SEELIGER = LommelSeeligerSpec(kind="lommel-seeliger", w=0.8)
# P(0) = 0.84 / 0.6^3 = 35/9, P(60 deg) = 0.84 / 0.76^1.5.
_BACKWARD = LommelSeeligerSpec(kind="lommel-seeliger", w=0.8, b=0.4)
_MOON = McEwenSpec(kind="mcewen", albedo=0.3)
HAND = [
    Hand(LambertSpec(albedo=0.4), 0, 0, 0, 0.4),
    Hand(LambertSpec(albedo=0.4), 60, 30, 90, 0.2),
    Hand(_FLAT_OREN_NAYAR, 0, 0, 0, 0.4),
    Hand(_FLAT_OREN_NAYAR, 60, 60, 60, 0.2),
    Hand(_PLAIN_HAPKE, 0, 0, 0, 0.75 / 8 * 9 / 4),
    Hand(_PLAIN_HAPKE, 60, 0, 60, 0.75 / 12 * 2),
    Hand(_PLAIN_HAPKE, 0, 60, 60, 0.75 / 6 * 2),
    Hand(_SEELIGER, 0, 0, 0, 0.1),
    Hand(_SEELIGER, 60, 0, 60, 0.2 / 3),
    Hand(_SEELIGER, 0, 60, 60, 0.4 / 3),
    Hand(_SEELIGER, 60, 60, 120, 0.1),
    Hand(_BACKWARD, 0, 0, 0, 0.1 * 35 / 9),
    Hand(_BACKWARD, 60, 0, 60, 0.2 / 3 * 0.84 / 0.76**1.5),
    Hand(_MOON, 0, 0, 0, 0.3),
    Hand(_MOON, 60, 0, 60, 0.3 * (0.41584 * 2 / 3 + 0.58416 / 2)),
    Hand(_MOON, 0, 60, 60, 0.3 * (0.41584 * 4 / 3 + 0.58416)),
    Hand(_MOON, 45, 45, 90, 0.3 * (0.18586 + 0.81414 * math.sqrt(0.5))),
    Hand(_MOON, 60, 60, 120, 0.15),
]

# Geometric albedo of a sphere: 2/3 A, w/8 P(0), A. Of Hapke's above it is w/4 int_0^1 H(x)^2 x dx, with gamma = 1/2
# w/4 int (1 + 2x)^2/(1 + x)^2 x dx; by x = y - 1 this is w/4 int_1^2 (2y - 1)^2 (y - 1)/y^2 dy
# = w/4 [2 y^2 - 8 y + 5 ln y + 1/y] = w/4 (6 - 8 + 5 ln 2 - 1/2).
GEOMETRIC = [
    (LambertSpec(albedo=0.3), 0.2),
    (_FLAT_OREN_NAYAR, 0.8 / 3),
    (_PLAIN_HAPKE, 0.75 / 4 * (5 * math.log(2) - 2.5)),
    (_SEELIGER, 0.1),
    (_BACKWARD, 0.1 * 35 / 9),
    (_MOON, 0.3),
]
SEELIGER_BOND = 2 / 3 * (1 - math.log(2))  # A_B / w = p q / w = 1/8 x 16/3 (1 - ln 2)
BOND = [
    (LambertSpec(albedo=0.3), 0.3),
    (_FLAT_OREN_NAYAR, 0.4),
    (_SEELIGER, 0.8 * SEELIGER_BOND),
    (McEwenSpec(kind="mcewen", albedo=0.1, L1_per_deg=0.0, L2_per_deg2=0.0, L3_per_deg3=0.0), 0.8 * SEELIGER_BOND),
    (McEwenSpec(kind="mcewen", albedo=0.3, L1_per_deg=-1e9), 0.3),
]


def radiance_factor(spec: BrdfSpec, i: float, e: float, g: float) -> float:
    """I/F at angles in radians."""
    return math.pi * math.cos(i) * float(brdf_value(spec, np.cos(i), np.cos(e), np.array(g)))


def from_incidence(spec: BrdfSpec, cos_i: float) -> float:
    """Share of the light from one direction that the hemisphere receives, by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(160)
    cos_e, psi = np.meshgrid(0.5 * (nodes + 1.0), (np.arange(240) + 0.5) / 240 * np.pi, indexing="ij")
    cos_g = cos_i * cos_e + math.sqrt(1.0 - cos_i**2) * np.sqrt(1.0 - cos_e**2) * np.cos(psi)
    f = brdf_value(spec, np.full_like(cos_e, cos_i), cos_e, np.arccos(np.clip(cos_g, -1.0, 1.0)))
    return float(np.sum(f * cos_e * 0.5 * weights[:, None]) * 2.0 * np.pi / 240)


def test_every_model_is_worked_by_hand():
    assert {case.spec.kind for case in HAND} == set(MODELS)
    assert {spec.kind for spec, _ in GEOMETRIC} == set(MODELS)
    assert {spec.kind for spec in OTHERS} == set(MODELS)


@pytest.mark.parametrize("case", HAND, ids=repr)
def test_closed_form(case):
    angles = (math.radians(x) for x in (case.i, case.e, case.g))
    assert radiance_factor(case.spec, *angles) == pytest.approx(case.expected, rel=2e-5)


@pytest.mark.parametrize("spec", [*ALL, *EXTREMES], ids=repr)
@given(i=angles, e=angles, psi=azimuths)
def test_reciprocal_finite_and_never_negative(spec, i, e, psi):
    cosine = math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(psi)
    g = np.array(math.acos(max(-1.0, min(1.0, cosine))))
    forward = float(brdf_value(spec, np.cos(i), np.cos(e), g))
    assert math.isfinite(forward)
    assert forward >= 0.0
    assert float(brdf_value(spec, np.cos(e), np.cos(i), g)) == pytest.approx(forward, rel=1e-9)


@pytest.mark.parametrize("incidence_deg", [0.0, 45.0, 75.0, 88.0])
@pytest.mark.parametrize("spec", [s for s in ALL if not (s.kind == "mcewen" and s.L1_per_deg == 0.0)], ids=repr)
def test_no_more_is_reflected_than_received(spec, incidence_deg):
    """With a weight of 1 at every phase angle McEwen's law has no such bound below A = 1/4: it is tested apart."""
    assert 0.0 < from_incidence(spec, math.cos(math.radians(incidence_deg))) <= 1.0


@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0, 80.0])
def test_lunar_hemisphere_in_closed_form(incidence_deg):
    """w/2 (1 - mu0 ln((1 + mu0)/mu0)), and 8 times that with A for w where McEwen's weight is 1."""
    mu0 = math.cos(math.radians(incidence_deg))
    shape = 1.0 - mu0 * math.log((1.0 + mu0) / mu0)
    assert from_incidence(_SEELIGER, mu0) == pytest.approx(0.4 * shape, rel=1e-4)
    lunar = McEwenSpec(kind="mcewen", albedo=0.2, L1_per_deg=0.0, L2_per_deg2=0.0, L3_per_deg3=0.0)
    assert from_incidence(lunar, mu0) == pytest.approx(0.8 * shape, rel=1e-4)


def test_mcewen_reflects_too_much_above_its_bound():
    """The docstring's figures: 1.09 A and 1.67 A."""
    moon = McEwenSpec(kind="mcewen", albedo=1.0)
    assert from_incidence(moon, 1.0) == pytest.approx(1.0925, abs=5e-4)
    assert from_incidence(moon, math.cos(math.radians(89.5))) == pytest.approx(1.6657, abs=2e-3)


@pytest.mark.parametrize(("spec", "expected"), GEOMETRIC, ids=repr)
def test_geometric_albedo_of_a_sphere(spec, expected):
    """At opposition i = e all over the disc: p = 2 int_0^1 I/F(mu, mu, 0) mu dmu."""
    albedo, _ = quad(lambda mu: 2.0 * mu * radiance_factor(spec, math.acos(mu), math.acos(mu), 0.0), 0.0, 1.0)
    assert albedo == pytest.approx(expected, rel=1e-5)


def spherical_albedo(spec: BrdfSpec) -> float:
    """Light from all over the sphere's disc: A_B = 2 int_0^1 (share reflected) mu0 dmu0."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    mu0 = 0.5 * (nodes + 1.0)
    shares = np.array([from_incidence(spec, float(mu)) for mu in mu0])
    return float((shares * mu0 * weights).sum())


@pytest.mark.parametrize(("spec", "expected"), BOND, ids=repr)
def test_spherical_albedo(spec, expected):
    assert spherical_albedo(spec) == pytest.approx(expected, rel=2e-3)


def test_spherical_albedo_follows_from_the_phase_curve_of_a_seeliger_sphere():
    """A_B = 2 int w/8 P(g) (1 - sin(g/2) tan(g/2) ln cot(g/4)) sin(g) dg: the disc of the sphere in closed form."""

    def light(g: float) -> float:
        lobe = 0.84 / (1.16 - 0.8 * math.cos(g)) ** 1.5
        disc = 1.0 - math.sin(g / 2) * math.tan(g / 2) * math.log(1.0 / math.tan(g / 4))
        return 2.0 * 0.1 * lobe * disc * math.sin(g)

    assert spherical_albedo(_BACKWARD) == pytest.approx(quad(light, 1e-9, math.pi - 1e-9)[0], rel=2e-3)


def test_mcewen_is_isis():
    """LunarLambertMcEwen of ISIS, by McEwen himself, as its unit test prints it: R(30, 0, 30) / R(i, e, g)."""
    reference = radiance_factor(_MOON, math.radians(30.0), 0.0, math.radians(30.0))
    for (i, e, g), printed in {(0.0, 0.0, 0.0): 0.903853, (45.0, 30.0, 60.0): 1.14863}.items():
        value = radiance_factor(_MOON, math.radians(i), math.radians(e), math.radians(g))
        assert reference / value == pytest.approx(printed, rel=5e-6)


def test_mcewen_without_lunar_part_is_lambert_and_at_the_zenith_always():
    none = McEwenSpec(kind="mcewen", albedo=0.3, L1_per_deg=-1e9)
    for i, e, g in ((0.2, 0.3, 0.4), (1.0, 1.1, 2.0)):
        assert radiance_factor(none, i, e, g) == pytest.approx(radiance_factor(LambertSpec(albedo=0.3), i, e, g))
    for coefficient in (0.0, -0.019, -0.5):
        spec = McEwenSpec(kind="mcewen", albedo=0.3, L1_per_deg=coefficient)
        for g in (0.0, 0.5, 1.5):  # mu0 = mu = 1 on paper, whatever the weight
            assert radiance_factor(spec, 0.0, 0.0, g) == pytest.approx(0.3)


@every_model
def test_numpy_and_drjit_agree(llvm, spec):
    register_bsdfs(llvm)
    import drjit as dr
    from mitsuba import Float

    rng = np.random.default_rng(11)
    cos_i, cos_e = rng.uniform(0.02, 1.0, (2, 4000)).astype(np.float32)
    cos_psi = np.cos(rng.uniform(0.0, np.pi, 4000))
    cos_g = cos_i * cos_e + np.sqrt(1.0 - cos_i**2) * np.sqrt(1.0 - cos_e**2) * cos_psi
    phase = np.arccos(np.clip(cos_g, -1.0, 1.0)).astype(np.float32)
    wide = [array.astype(np.float64) for array in (cos_i, cos_e, phase)]
    expected = np.broadcast_to(brdf_value(spec, *wide), 4000)
    value = brdf_value(spec, Float(cos_i), Float(cos_e), Float(phase), drjit_math(dr))
    np.testing.assert_allclose(np.broadcast_to(np.array(value), 4000), expected, rtol=2e-3, atol=1e-6)


@pytest.fixture(scope="module")
def ball():
    """A sphere of 250 m in 20,480 facets."""
    return icosphere(5, 250.0)


@pytest.mark.parametrize("name", ["llvm", "scalar"])
@pytest.mark.parametrize("spec", DEFAULTS, ids=repr)
def test_rendered_sphere_is_the_formula(request, ball, name, spec):
    """Every pixel well inside the lit disc of an image of a sphere, from the formula at the sphere's own normal."""
    camera = Camera.from_fov(64, 64, np.radians(18.0))
    view = View(camera, look_at(np.array([2000.0, 0.0, 0.0])), np.array([1.0, 0.8, 0.3]))
    image = MitsubaRenderer(ball, spec, 4, "smooth", request.getfixturevalue(name)).render(view)
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(64) + 0.5)
    # The camera stands on the x axis at 2000 m: the rays of the pixel centres, cut with the sphere of 250 m.
    rays = np.stack([(columns - camera.cx_px) / camera.fx_px, (rows - camera.cy_px) / camera.fy_px], axis=-1)
    rays = np.concatenate([rays, np.ones((64, 64, 1))], axis=-1) @ view.T_cam_body.rotation
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -rays @ np.array([2000.0, 0.0, 0.0])
    root = along**2 - (2000.0**2 - 250.0**2)
    hit = root > 0.0
    distance = along - np.sqrt(np.where(hit, root, 0.0))
    normals = (np.array([2000.0, 0.0, 0.0]) + distance[..., None] * rays) / 250.0
    cos_e, cos_i = -(normals * rays).sum(axis=-1), normals @ view.sun_dir_body
    phase = np.arccos(np.clip(-rays @ view.sun_dir_body, -1.0, 1.0))
    clear = hit & (cos_e > 0.4) & (cos_i > 0.1)
    assert clear.sum() > 350
    expected = np.pi * np.broadcast_to(brdf_value(spec, cos_i, cos_e, phase), cos_i.shape) * cos_i
    np.testing.assert_allclose(image[clear], expected[clear], rtol=0.02, atol=2e-3 * expected[clear].max())
