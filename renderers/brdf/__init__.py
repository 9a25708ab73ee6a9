"""Reflectance models, each formula written once for both NumPy and Dr.Jit arrays."""

from boresight.renderers.brdf.arrays import NUMPY, ArrayMath, phase_angle, phase_of_rays
from boresight.renderers.brdf.laws import (
    HapkeParameters,
    LommelSeeligerParameters,
    McEwenParameters,
    OrenNayarParameters,
    hapke,
    lambert,
    lommel_seeliger,
    mcewen,
    oren_nayar,
)
from boresight.renderers.brdf.models import MODELS, ReflectanceModel, brdf_value

__all__ = [
    "MODELS",
    "NUMPY",
    "ArrayMath",
    "HapkeParameters",
    "LommelSeeligerParameters",
    "McEwenParameters",
    "OrenNayarParameters",
    "ReflectanceModel",
    "brdf_value",
    "hapke",
    "lambert",
    "lommel_seeliger",
    "mcewen",
    "oren_nayar",
    "phase_angle",
    "phase_of_rays",
]
