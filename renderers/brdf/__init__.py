"""Reflectance models: each formula written once for both NumPy and Dr.Jit arrays, and the table of them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, get_args

from boresight.renderers.brdf.arrays import NUMPY, Array, ArrayMath, phase_angle, phase_of_rays
from boresight.renderers.brdf.laws import Section, hapke, lambert, lommel_seeliger, mcewen, oren_nayar
from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.brdf import (
    BrdfSpec,
    HapkeSpec,
    LambertSpec,
    LommelSeeligerSpec,
    McEwenSpec,
    OrenNayarSpec,
)

__all__ = ["MODELS", "NUMPY", "ArrayMath", "ReflectanceModel", "brdf_value", "phase_angle", "phase_of_rays"]

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReflectanceModel:
    """Reflectance model: its schema in scenarios, and its BRDF, 1/sr, of (section, cos_i, cos_e, phase_rad, math)."""

    spec: type[SpecModel]
    law: Callable[[Section, Array, Array, Array, ArrayMath], Array]

    def formula(self, values: Values, cos_i: Array, cos_e: Array, phase_rad: Array, xp: ArrayMath) -> Array:
        """Evaluate the BRDF, 1/sr, by the values of a ``brdf`` section in its units; they may be Dr.Jit values."""
        return self.law(SimpleNamespace(**values), cos_i, cos_e, phase_rad, xp)

    @property
    def kind(self) -> str:
        """Name of the model in a scenario."""
        name: str = get_args(self.spec.model_fields["kind"].annotation)[0]
        return name

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(key for key in self.spec.model_fields if key != "kind")


MODELS = {
    model.kind: model
    for model in (
        ReflectanceModel(LambertSpec, lambda section, *_: lambert(section.albedo)),
        ReflectanceModel(OrenNayarSpec, oren_nayar),
        ReflectanceModel(HapkeSpec, hapke),
        ReflectanceModel(LommelSeeligerSpec, lommel_seeliger),
        ReflectanceModel(McEwenSpec, mcewen),
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
