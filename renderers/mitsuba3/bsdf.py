"""Mitsuba BSDF plugins of reflectance models that Mitsuba lacks, for any Mitsuba scene.

``boresight_oren_nayar``, ``boresight_hapke``, ``boresight_lommel_seeliger`` and ``boresight_mcewen`` take the keys of a
scenario's ``brdf`` section as properties, with the same names, units, ranges and defaults, and a texture ``factor``
(1 by default) that multiplies the reflectance, such as the vertex attribute ``vertex_albedo`` of a mesh. They are
one-sided and importance-sampled by the cosine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from boresight.renderers.brdf import MODELS, ReflectanceModel, phase_angle
from boresight.renderers.mitsuba3.variant import Variant, load_mitsuba
from boresight.renderers.mitsuba3.wavefront import drjit_math
from boresight.scenarios.errors import BoresightError


@dataclass(frozen=True, slots=True)
class _Plugin:
    """A reflectance model and the name of its plugin."""

    name: str
    model: ReflectanceModel

    def read(self, properties: Any) -> dict[str, Any]:
        """Return the values of all keys, validated by the schema of scenario files."""
        model = self.model
        given = {key: properties[key] for key in model.keys if key in properties}
        try:
            spec = model.spec.model_validate({"kind": model.kind, **given})
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            raise BoresightError(f"{self.name}: {key}: {first['input']!r}: {first['msg']}") from error
        return {key: getattr(spec, key) for key in model.keys}


# Lambert's law is Mitsuba's own plugin "diffuse".
PLUGINS = tuple(
    _Plugin(f"boresight_{kind.replace('-', '_')}", model) for kind, model in MODELS.items() if kind != "lambert"
)


def register_bsdfs(variant: Variant) -> Any:
    """Register the plugins with a variant, make it active, and return the library ``mitsuba``.

    In the LLVM and CUDA variants the numbers are parameters of the scene, which can be changed and differentiated; in
    the scalar variant they are constants.
    """
    mi = load_mitsuba(variant)
    for plugin in PLUGINS:
        mi.register_bsdf(plugin.name, _plugin_class(mi, plugin))
    return mi


def _plugin_class(mi: Any, plugin: _Plugin) -> Any:
    """Define the plugin's class, whose base class depends on the variant."""
    import drjit as dr

    math = drjit_math(dr)
    jit = dr.is_jit_v(mi.Float)

    class ReflectanceBsdf(mi.BSDF):  # type: ignore[misc]
        """Diffuse lobe, sampled by the cosine of the outgoing direction."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            # Strings (a model's form) and the numbers of the scalar variant stay Python values.
            self.values = {
                key: mi.Float(value) if jit and isinstance(value, float) else value
                for key, value in plugin.read(properties).items()
            }
            self.factor = properties.get_texture("factor", 1.0)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]

        def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            # The density is cos(theta) / pi, so that the weight of a sample is pi f_r.
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            sample = mi.BSDFSample3f(wo)
            sample.pdf = self.pdf(context, si, wo, active)
            sample.eta = 1.0
            sample.sampled_type = +mi.BSDFFlags.DiffuseReflection
            sample.sampled_component = 0
            # Where the density is 0 the value is 0 too: dividing by 1 avoids 0 / 0.
            return sample, self.eval(context, si, wo, active) / dr.select(sample.pdf > 0.0, sample.pdf, 1.0)

        def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            # Rays are traced from the camera: wi points to the viewer and wo to the light. The formulas are reciprocal.
            cos_i, cos_e = mi.Frame3f.cos_theta(wo), mi.Frame3f.cos_theta(si.wi)
            # phase_angle takes the negative direction to the viewer.
            phase_rad = phase_angle(dr.squared_norm(wo - si.wi), dr.squared_norm(wo + si.wi), math)
            # Mitsuba's BSDF values include the cosine of the outgoing direction.
            value = plugin.model.formula(self.values, cos_i, cos_e, phase_rad, math) * cos_i
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
            return "\n".join([f"{plugin.name}[", *lines, "]"])

    return ReflectanceBsdf
