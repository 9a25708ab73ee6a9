"""Table of the reflectance models, by which they are evaluated, rendered and tested."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from boresight.renderers.brdf.arrays import NUMPY, Array, ArrayMath
from boresight.renderers.brdf.hapke import HapkeParameters, hapke
from boresight.renderers.brdf.lunar_lambert import (
    LommelSeeligerParameters,
    McEwenParameters,
    lambert,
    lommel_seeliger,
    mcewen,
)
from boresight.renderers.brdf.oren_nayar import OrenNayarParameters, oren_nayar
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.brdf import (
    BrdfSpec,
    HapkeSpec,
    LambertSpec,
    LommelSeeligerSpec,
    McEwenSpec,
    OrenNayarSpec,
)

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReflectanceModel:
    """Reflectance model: its schema in scenarios, and its BRDF of (values, cos_i, cos_e, phase_rad, math).

    The values are those of the scenario's ``brdf`` section, in its units; they may be Dr.Jit values.
    """

    spec: type[SpecModel]
    formula: Callable[[Values, Array, Array, Array, ArrayMath], Array]

    @property
    def kind(self) -> str:
        """Name of the model in a scenario."""
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


def brdf_value(spec: BrdfSpec, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath = NUMPY) -> Array:
    """Evaluate the bidirectional reflectance distribution function (BRDF) of a scenario's surface, 1/sr.

    ``cos_i`` and ``cos_e`` are the cosines of the angles of incidence and emission from the normal, raised to at least
    COS_MIN; ``phase_rad`` is the angle between the directions to the light and to the viewer, 0 to pi. ``xp`` is the
    array library of the three. The result is finite and never negative; the radiance factor is ``I/F = pi f_r cos_i``.
    Lambert's law gives a single number.
    """
    return MODELS[spec.kind].formula(dict(spec), cos_i, cos_e, phase_rad, xp)
