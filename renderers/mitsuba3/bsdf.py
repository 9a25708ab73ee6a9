"""Mitsuba BSDF plugins of the reflectance models that Mitsuba lacks, for use in any Mitsuba scene.

``boresight_oren_nayar`` and ``boresight_hapke`` take the keys of a scenario's ``brdf`` section as properties, with
the same names, units, ranges and defaults, and a texture ``factor`` (1 by default) that multiplies the reflectance,
such as the vertex attribute ``vertex_albedo`` of a body's mesh. They are one-sided and sampled by the cosine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

from pydantic import ValidationError

from renderers.brdf import ArrayMath, HapkeParameters, OrenNayarParameters, hapke, oren_nayar
from renderers.mitsuba3.variant import Variant, load_mitsuba
from renderers.mitsuba3.wavefront import drjit_math
from scenarios.errors import BoresightError
from scenarios.spec.base import SpecModel
from scenarios.spec.brdf import HapkeSpec, OrenNayarSpec

OREN_NAYAR, HAPKE = "boresight_oren_nayar", "boresight_hapke"

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class _Model:
    """A plugin: its name, its keys with their ranges, and its formula of (values, cos_i, cos_e, phase, math)."""

    plugin: str
    spec: type[SpecModel]
    kind: str
    formula: Callable[[Values, Any, Any, Any, ArrayMath], Any]

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(key for key in self.spec.model_fields if key != "kind")

    def read(self, properties: Any) -> dict[str, Any]:
        """Values of all keys, checked as those of a scenario file are."""
        given = {key: properties[key] for key in self.keys if key in properties}
        try:
            spec = self.spec.model_validate({"kind": self.kind, **given})
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            raise BoresightError(f"{self.plugin}: {key}: {first['input']!r}: {first['msg']}") from error
        return {key: getattr(spec, key) for key in self.keys}


_DEGREE = pi / 180.0


def _oren_nayar(values: Values, cos_i: Any, cos_e: Any, phase_rad: Any, xp: ArrayMath) -> Any:
    p = OrenNayarParameters(values["albedo"], values["sigma_deg"] * _DEGREE, values["form"])
    return oren_nayar(p, cos_i, cos_e, phase_rad, xp)


def _hapke(values: Values, cos_i: Any, cos_e: Any, phase_rad: Any, xp: ArrayMath) -> Any:
    v = values
    theta_bar_rad = v["theta_bar_deg"] * _DEGREE
    p = HapkeParameters(v["w"], v["b"], v["c"], v["B0"], v["h"], theta_bar_rad, v["H_function"])
    return hapke(p, cos_i, cos_e, phase_rad, xp)


_MODELS = (
    _Model(OREN_NAYAR, OrenNayarSpec, "oren-nayar", _oren_nayar),
    _Model(HAPKE, HapkeSpec, "hapke", _hapke),
)


def register_bsdfs(variant: Variant) -> Any:
    """Register both plugins with a variant, make it active, and return the library ``mitsuba``.

    In the LLVM and CUDA variants the numbers appear among the scene's parameters and can be changed and
    differentiated; in the scalar variant they are fixed.
    """
    mi = load_mitsuba(variant)
    for model in _MODELS:
        mi.register_bsdf(model.plugin, _plugin_class(mi, model))
    return mi


def _plugin_class(mi: Any, model: _Model) -> Any:
    """Make the plugin's class: its base class is another one in every variant."""
    import drjit as dr

    math = drjit_math(dr)
    jit = dr.is_jit_v(mi.Float)

    class ReflectanceBsdf(mi.BSDF):  # type: ignore[misc]
        """A diffuse-like lobe, sampled by the cosine of the outgoing direction."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.values = {
                key: mi.Float(value) if jit and isinstance(value, float) else value
                for key, value in model.read(properties).items()
            }
            self.factor = properties.get_texture("factor", 1.0)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]

        def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            sample = mi.BSDFSample3f(wo)
            sample.pdf = self.pdf(context, si, wo, active)
            sample.eta = 1.0
            sample.sampled_type = +mi.BSDFFlags.DiffuseReflection
            sample.sampled_component = 0
            # Where the density is 0 the value is 0 too, and so is the weight.
            return sample, self.eval(context, si, wo, active) / dr.select(sample.pdf > 0.0, sample.pdf, 1.0)

        def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_e = mi.Frame3f.cos_theta(wo), mi.Frame3f.cos_theta(si.wi)
            phase_rad = 2.0 * dr.atan2(dr.norm(si.wi - wo), dr.norm(si.wi + wo))
            value = model.formula(self.values, cos_i, cos_e, phase_rad, math) * cos_i
            lit = active & (cos_i > 0.0) & (cos_e > 0.0) & context.is_enabled(mi.BSDFFlags.DiffuseReflection)
            return mi.depolarizer(self.factor.eval(si, active) * dr.select(lit, value, 0.0))

        def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            above = active & (mi.Frame3f.cos_theta(wo) > 0.0) & (mi.Frame3f.cos_theta(si.wi) > 0.0)
            enabled = context.is_enabled(mi.BSDFFlags.DiffuseReflection)
            return dr.select(above & enabled, mi.warp.square_to_cosine_hemisphere_pdf(wo), 0.0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def traverse(self, callback: Any) -> None:
            callback.put("factor", self.factor, mi.ParamFlags.Differentiable)
            for key, value in self.values.items():
                if jit and not isinstance(value, str):
                    callback.put(key, value, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            lines = [f"  {key} = {value}" for key, value in {**self.values, "factor": self.factor}.items()]
            return "\n".join([f"{model.plugin}[", *lines, "]"])

    return ReflectanceBsdf
