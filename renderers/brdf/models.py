"""The table of reflectance models: what evaluates them, renders them and tests them goes by it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from renderers.brdf.arrays import Array, ArrayMath
from renderers.brdf.hapke import HapkeParameters, hapke
from renderers.brdf.lambert import lambert
from renderers.brdf.lommel_seeliger import LommelSeeligerParameters, lommel_seeliger
from renderers.brdf.mcewen import McEwenParameters, mcewen
from renderers.brdf.oren_nayar import OrenNayarParameters, oren_nayar
from scenarios.spec.base import SpecModel
from scenarios.spec.brdf import HapkeSpec, LambertSpec, LommelSeeligerSpec, McEwenSpec, OrenNayarSpec

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReflectanceModel:
    """A model: its section of a scenario, and its BRDF as a function of (values, cos_i, cos_e, phase_rad, math).

    The values are those of the section's keys, in the units of the section; they may be Dr.Jit values.
    """

    spec: type[SpecModel]
    formula: Callable[[Values, Array, Array, Array, ArrayMath], Array]

    @property
    def kind(self) -> str:
        """The name of the model in a scenario."""
        name: str = get_args(self.spec.model_fields["kind"].annotation)[0]
        return name

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(key for key in self.spec.model_fields if key != "kind")


def _lambert(values: Values, _i: Array, _e: Array, _g: Array, _xp: ArrayMath) -> Array:
    return lambert(values["albedo"])


def _oren_nayar(values: Values, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    return oren_nayar(OrenNayarParameters.from_values(values), cos_i, cos_e, phase_rad, xp)


def _hapke(values: Values, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    return hapke(HapkeParameters.from_values(values), cos_i, cos_e, phase_rad, xp)


def _lommel_seeliger(values: Values, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    return lommel_seeliger(LommelSeeligerParameters.from_values(values), cos_i, cos_e, phase_rad, xp)


def _mcewen(values: Values, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
    return mcewen(McEwenParameters.from_values(values), cos_i, cos_e, phase_rad, xp)


MODELS = {
    model.kind: model
    for model in (
        ReflectanceModel(LambertSpec, _lambert),
        ReflectanceModel(OrenNayarSpec, _oren_nayar),
        ReflectanceModel(HapkeSpec, _hapke),
        ReflectanceModel(LommelSeeligerSpec, _lommel_seeliger),
        ReflectanceModel(McEwenSpec, _mcewen),
    )
}
