"""The Mitsuba plugins against the formulas, and as members of any Mitsuba scene."""

import math

import numpy as np
import pytest

from boresight.renderers.brdf import brdf_value
from boresight.renderers.mitsuba3 import register_bsdfs
from boresight.renderers.mitsuba3.bsdf import PLUGINS as NAMED
from boresight.scenarios.spec.brdf import HapkeSpec, LommelSeeligerSpec, McEwenSpec, OrenNayarSpec

PLUGINS = [
    ({"type": "boresight_oren_nayar"}, OrenNayarSpec(kind="oren-nayar")),
    (
        {"type": "boresight_oren_nayar", "albedo": 0.8, "sigma_deg": 35.0, "form": "qualitative"},
        OrenNayarSpec(kind="oren-nayar", albedo=0.8, sigma_deg=35.0, form="qualitative"),
    ),
    ({"type": "boresight_lommel_seeliger"}, LommelSeeligerSpec(kind="lommel-seeliger")),
    ({"type": "boresight_lommel_seeliger", "b": 0.5}, LommelSeeligerSpec(kind="lommel-seeliger", b=0.5)),
    ({"type": "boresight_mcewen", "albedo": 0.5}, McEwenSpec(kind="mcewen", albedo=0.5)),
    ({"type": "boresight_hapke"}, HapkeSpec(kind="hapke")),
    (
        {"type": "boresight_hapke", "w": 0.7, "b": -0.2, "c": 0.1, "B0": 0.3, "h": 0.1, "theta_bar_deg": 12.0}
        | {"H_function": "1981"},
        HapkeSpec(kind="hapke", w=0.7, b=-0.2, c=0.1, B0=0.3, h=0.1, theta_bar_deg=12.0, H_function="1981"),
    ),
]


def directions(rng: np.random.Generator, n: int) -> np.ndarray:
    """Unit vectors (n, 3) over the upper hemisphere, uniform."""
    z, azimuth = rng.uniform(0.01, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def expected_value(spec, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """f cos(theta_o) from the formula; the phase angle from both sums, which is exact near 0."""
    phase = 2.0 * np.arctan2(np.linalg.norm(wi - wo, axis=1), np.linalg.norm(wi + wo, axis=1))
    return brdf_value(spec, wo[:, 2], wi[:, 2], phase) * wo[:, 2]


@pytest.mark.parametrize(("plugin", "spec"), PLUGINS, ids=lambda x: getattr(x, "kind", None))
def test_plugin_is_the_formula_with_llvm(llvm, plugin, spec):
    mi = register_bsdfs(llvm)
    rng = np.random.default_rng(3)
    wi, wo = directions(rng, 2000), directions(rng, 2000)
    wo[:50] = wi[:50]  # opposition
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(wi.T.astype(np.float32))
    value = mi.load_dict(plugin).eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)))
    np.testing.assert_allclose(np.array(value)[0], expected_value(spec, wi, wo), rtol=5e-4, atol=1e-6)


@pytest.mark.parametrize(("plugin", "spec"), PLUGINS, ids=lambda x: getattr(x, "kind", None))
def test_plugin_is_the_formula_without_llvm(scalar, plugin, spec):
    mi = register_bsdfs(scalar)
    rng = np.random.default_rng(4)
    wi, wo = directions(rng, 20), directions(rng, 20)
    bsdf, context, si = mi.load_dict(plugin), mi.BSDFContext(), mi.SurfaceInteraction3f()
    values = []
    for a, b in zip(wi, wo, strict=True):
        si.wi = list(a)
        values.append(bsdf.eval(context, si, list(b))[0])
    np.testing.assert_allclose(values, expected_value(spec, wi, wo), rtol=5e-4, atol=1e-6)


@pytest.mark.parametrize("name", [plugin.name for plugin in NAMED])
@pytest.mark.parametrize("wi", [[0.0, 0.0, 1.0], [0.6, -0.3, 0.74]])
def test_samples_follow_the_density(llvm, name, wi):
    """Chi-square at a significance of 0.01; the seed is fixed, so a pass stays a pass."""
    register_bsdfs(llvm)
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    unit = [x / math.sqrt(sum(y * y for y in wi)) for x in wi]
    sample, density = BSDFAdapter(name, {"type": name}, wi=unit)
    test = ChiSquareTest(SphericalDomain(), sample, density, sample_dim=3, sample_count=200_000, res=41)
    assert test.run(significance_level=0.01), test.messages


@pytest.mark.parametrize(("plugin", "spec"), PLUGINS, ids=lambda x: getattr(x, "kind", None))
def test_sample_weights_average_to_the_reflectance(llvm, plugin, spec):
    """The mean weight is the directional-hemispherical reflectance; 5 standard errors: 6e-7 to fail by chance."""
    mi = register_bsdfs(llvm)
    wi = np.array([[math.sin(0.8), 0.0, math.cos(0.8)]])
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(wi.T)
    uniform = np.random.default_rng(5).random((3, 100_000)).astype(np.float32)
    _, weight = mi.load_dict(plugin).sample(mi.BSDFContext(), si, mi.Float(uniform[0]), mi.Point2f(uniform[1:]))
    weights = np.array(weight)[0].astype(float)
    nodes, node_weights = np.polynomial.legendre.leggauss(96)
    z, azimuth = np.meshgrid(0.5 * (nodes + 1.0), (np.arange(180) + 0.5) / 90 * np.pi, indexing="ij")
    radius = np.sqrt(1.0 - z * z)
    wo = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
    value = expected_value(spec, np.repeat(wi, len(wo), axis=0), wo).reshape(z.shape)
    reflectance = float((value * 0.5 * node_weights[:, None]).sum() * 2.0 * np.pi / 180)
    assert weights.mean() == pytest.approx(reflectance, abs=5.0 * float(weights.std()) / math.sqrt(len(weights)))
    assert weights.max() < 50.0


@pytest.mark.parametrize("name", [plugin.name for plugin in NAMED])
def test_nothing_is_reflected_below_the_horizon(llvm, name):
    mi = register_bsdfs(llvm)
    bsdf, si = mi.load_dict({"type": name}), mi.SurfaceInteraction3f()
    up, down = mi.Vector3f(0.0, 0.6, 0.8), mi.Vector3f(0.0, 0.6, -0.8)
    for wi, wo in [(up, down), (down, up), (down, down)]:
        si.wi = wi
        assert np.array(bsdf.eval(mi.BSDFContext(), si, wo)).max() == 0.0
        assert np.array(bsdf.pdf(mi.BSDFContext(), si, wo)).max() == 0.0


def test_factor_texture_multiplies(llvm):
    mi = register_bsdfs(llvm)
    si, wo = mi.SurfaceInteraction3f(), mi.Vector3f(0.0, 0.6, 0.8)
    si.wi = mi.Vector3f(0.3, 0.0, 0.954)
    full = mi.load_dict({"type": "boresight_hapke"}).eval(mi.BSDFContext(), si, wo)
    half = mi.load_dict({"type": "boresight_hapke", "factor": 0.5}).eval(mi.BSDFContext(), si, wo)
    np.testing.assert_allclose(np.array(half), 0.5 * np.array(full), rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "key", "start", "step"),
    [
        ("boresight_hapke", "w", 0.4, 0.01),
        ("boresight_hapke", "theta_bar_deg", 20.0, 0.5),
        ("boresight_oren_nayar", "sigma_deg", 20.0, 0.5),
        ("boresight_oren_nayar", "albedo", 0.4, 0.01),
        ("boresight_lommel_seeliger", "w", 0.4, 0.01),
        ("boresight_mcewen", "L1_per_deg", -0.015, 0.0005),
    ],
)
def test_parameters_can_be_changed_and_differentiated(llvm, name, key, start, step):
    mi = register_bsdfs(llvm)
    import drjit as dr

    si, wo = mi.SurfaceInteraction3f(), mi.Vector3f(0.0, 0.6, 0.8)
    si.wi = mi.Vector3f(0.5, 0.0, 0.866)

    def at(value: float) -> float:
        return float(mi.load_dict({"type": name, key: value}).eval(mi.BSDFContext(), si, wo)[0][0])

    bsdf = mi.load_dict({"type": name})
    parameters = mi.traverse(bsdf)
    parameters[key] = mi.Float(start)
    dr.enable_grad(parameters[key])
    parameters.update()
    result = bsdf.eval(mi.BSDFContext(), si, wo)[0]
    assert float(result[0]) == pytest.approx(at(start), rel=1e-5)
    dr.backward(result)
    slope = (at(start + step) - at(start - step)) / (2.0 * step)
    assert float(dr.grad(parameters[key])[0]) == pytest.approx(slope, rel=0.02)


@pytest.mark.parametrize(
    ("wrong", "named"), [({"w": 1.5}, "w"), ({"H_function": "1999"}, "H_function"), ({"albedoo": 0.5}, "albedoo")]
)
def test_wrong_properties_are_refused_by_name(scalar, wrong, named):
    mi = register_bsdfs(scalar)
    with pytest.raises(RuntimeError, match=named):
        mi.load_dict({"type": "boresight_hapke", **wrong})


def test_a_scene_in_xml_can_use_the_plugin(scalar):
    """A white-lit sphere in a plain scene file: its brightness lies between 0 and the reflectance."""
    mi = register_bsdfs(scalar)
    scene = mi.load_string(
        """<scene version="3.0.0">
        <integrator type="direct"/><emitter type="constant"/>
        <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>
        <integer name="height" value="8"/><string name="pixel_format" value="luminance"/></film>
        <transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
        <shape type="sphere"><bsdf type="boresight_oren_nayar"><float name="albedo" value="0.5"/></bsdf></shape>
        </scene>"""
    )
    centre = np.array(mi.render(scene, spp=16))[3:5, 3:5]
    assert np.all((centre > 0.2) & (centre < 0.55))
