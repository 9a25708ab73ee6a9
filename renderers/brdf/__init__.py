"""Reflectance models, each formula written once for both NumPy and Dr.Jit arrays."""

from boresight.renderers.brdf.arrays import NUMPY, ArrayMath, phase_angle, phase_of_rays
from boresight.renderers.brdf.models import MODELS, ReflectanceModel, brdf_value

__all__ = [
    "MODELS",
    "NUMPY",
    "ArrayMath",
    "ReflectanceModel",
    "brdf_value",
    "phase_angle",
    "phase_of_rays",
]
